"""Normal meshes: results of the papers, file sizes, colours by level.

    python benches/normal_mesh.py DATA [--only models folds rates colors growth] [--mesh cow horse]
                                       [--samples 200000] [--picture FOLDER]

DATA holds `meshes/`. `pip install '.[bench]'` installs the peers: PyMeshLab, which also measures distances
independently, and Draco. Prints Markdown.

"models": the models of Li et al. 2002 (cow, near-cube) and of Guskov et al. 2000 (horse), and scans, four of
them open, at a tolerance of 5e-8. Columns:

- "exceptions": new vertices that no scalar offset can represent. Boundary vertices are counted separately,
  because they always have vectors. The papers' counts are in the next column.
- Distances are over the diagonal of the original's bounding box: RMS from the original to the result and
  back, and the larger maximum. "check" is the same by PyMeshLab's own sampling.
- "distance": the largest distance of a vertex from the original, by PyMeshLab.
- "flipped": triangles that face more than 90° away from the original at the point nearest to their centroid.
  In parentheses: only where the original is consistent with the surface around it.
- "degenerate": triangles without area. "edge spread": standard deviation of edge lengths over their mean.
- "CPU s": CPU time from the input file to the result, including writing the `.snm` data. "bits": per vertex
  of the result.

"folds": two meshes with crumpled regions, a fused kitchen and a model of many components, with default
parameters. "flipped" counts the triangles of each level as in the parentheses above. "folded" is
`folded_by_level`.

"rates": see normal_mesh_rates.py.

"colors": the coloured kitchen scan. The colour error of each level is sampled on the original. "bytes" is the
size of the file that ends with the level.

"growth": synthetic coloured height fields with noise, from ten thousand to a million triangles, and the time
per input triangle.

With --picture: base mesh, levels, and the original coloured by its distance to the result (over the
diagonal), for four meshes.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from markdown_tables import print_head, print_row
from normal_mesh_pictures import draw_levels
from normal_mesh_rates import print_rates
from simplify import compute_edge_lengths, compute_min_angles, compute_unit_normals
from simplify_speed import make_hills

from scanloom.stages.cleaning.clean import clean
from scanloom.stages.comparing.compare import compare
from scanloom.stages.normal_meshes.normal_mesh import BOUNDARY, EXCEPTION, SCALAR, NormalMesh
from scanloom.stages.normal_meshes.remesh import remesh
from scanloom.stages.rendering.viewpoints import viewpoints
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.raycasting import RaycastingSurface, compute_bounding_box
from scanloom.stages.surface.topology import topology

TABLES = ("models", "folds", "rates", "colors", "growth")
SIZES = (10_000, 100_000, 1_000_000)
SHAPE_COLUMNS = ["min °", "5 % °", "mean °", "edge spread", "flipped", "degenerate"]
SIZE_COLUMNS = ["bytes", "bits"]
MODEL_COLUMNS = [
    *("model", "triangles", "exceptions", "ratio", "paper", "boundary"),
    *("RMS forward ×1e-5", "backward", "max", "check: RMS forward", "backward", "max"),
    *(*SHAPE_COLUMNS, *SIZE_COLUMNS, "CPU s"),
]
LEVEL_COLUMNS = [
    "model",
    "level",
    "triangles",
    "exceptions",
    "boundary",
    "distance",
    *SHAPE_COLUMNS,
    *SIZE_COLUMNS,
]
FOLD_COLUMNS = ["mesh", "triangles", "base", "finest", "flipped", "folded", "bytes", "CPU s"]
COLOR_COLUMNS = [
    *("level", "vertices", "triangles", "PSNR dB", "RMSE, levels", "RMS forward ×1e-5", "backward"),
    *SIZE_COLUMNS,
]


@dataclass(frozen=True)
class RemeshCase:
    """Input mesh and remeshing parameters.

    Attributes
    ----------
    read : reads the mesh from DATA.
    levels : number of refinements.
    base_triangles : triangles of the base mesh; None for a result about as large as the input.
    paper_exceptions : number of exceptions reported by the paper.
    """

    read: Callable[[Path], Mesh]
    levels: int
    base_triangles: int | None = None
    paper_exceptions: str = ""

    def run_remesh(self, mesh: Mesh) -> NormalMesh:
        """Remesh with these parameters and defaults for the others."""
        return remesh(mesh, levels=self.levels, base_triangles=self.base_triangles, tolerance=5e-8)


def make_reader(name: str) -> Callable[[Path], Mesh]:
    """Return a function that reads a mesh from DATA."""
    return lambda data: read_mesh(data / "meshes" / name)


def read_kitchen(data: Path) -> Mesh:
    """Load a coloured room scan, fused at 2 cm and cleaned to a manifold."""
    return clean(make_reader("redkitchen_fused_vertexcolor.ply")(data)).mesh


def read_upright_horse(data: Path) -> Mesh:
    """Read the horse for a picture.

    The file's horse is on its side and its triangles face inward; both are corrected.
    """
    mesh = make_reader("horse.ply")(data)
    return Mesh(mesh.vertices[:, [1, 2, 0]], mesh.triangles[:, ::-1].copy())


def make_near_cube() -> Mesh:
    """Make a unit cube of 396 triangles.

    Its edges are divided into 3, 6 and 9 parts along the three axes.
    """
    parts = np.array([3, 6, 9])
    corners = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        i, j = (a.ravel() for a in np.mgrid[0 : parts[u], 0 : parts[v]])
        for side in (0, 1):
            square = np.zeros((len(i), 4, 3), np.int64)
            square[..., axis] = side * parts[axis]
            square[..., u] = i[:, None] + [0, 1, 1, 0]
            square[..., v] = j[:, None] + [0, 0, 1, 1]
            # From outside, the turn from u to v is counterclockwise on the far side and clockwise on the near
            # side.
            square = square if side else square[:, ::-1]
            corners += [square[:, [0, 1, 2]], square[:, [0, 2, 3]]]
    lattice, triangles = np.unique(np.concatenate(corners).reshape(-1, 3), axis=0, return_inverse=True)
    return Mesh(lattice / parts, triangles.reshape(-1, 3).astype(np.int32))


MODELS = {
    "cow": RemeshCase(make_reader("cow.obj"), 2, 426, "43"),
    "near-cube": RemeshCase(lambda _: make_near_cube(), 2, 68, "6"),
    "face": RemeshCase(make_reader("face.obj"), 3),
    "camelhead": RemeshCase(make_reader("camelhead.off"), 3),
    "bunny": RemeshCase(make_reader("stanford-bunny.obj"), 3),
    "sceaux": RemeshCase(make_reader("sceaux_mvs_scene_mesh.ply"), 3),
    "igea": RemeshCase(make_reader("igea.ply"), 4),
    "rocker-arm": RemeshCase(make_reader("rocker-arm.obj"), 3),
    # A closed surface of genus 0 with 234 vertices has 464 triangles.
    "horse": RemeshCase(make_reader("horse.ply"), 4, 464, "644"),
}
KITCHEN = RemeshCase(read_kitchen, 3)
# The scan that the kitchen was fused from: its cameras give the viewpoint of the picture.
SCAN = "rgbd/7scenes_redkitchen"
PICTURE_CASES = {
    "horse": replace(MODELS["horse"], read=read_upright_horse),
    **{name: MODELS[name] for name in ("cow", "face")},
    "kitchen": KITCHEN,
}
# Width of one mesh in a picture, pixels.
WIDTH = 480


def main() -> None:
    """Print the tables and draw the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", nargs="*", choices=TABLES, default=list(TABLES))
    parser.add_argument("--mesh", nargs="+", choices=[*MODELS, "kitchen"], default=[*MODELS, "kitchen"])
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--picture", type=Path, metavar="FOLDER", help="folder for the pictures")
    options = parser.parse_args()
    if "models" in options.only:
        # Warm up: load libraries before anything is timed.
        MODELS["near-cube"].run_remesh(make_near_cube())
        print_models([name for name in MODELS if name in options.mesh], options.data, options.samples)
    if "folds" in options.only:
        print_folds(options.data)
    if "rates" in options.only:
        for name in ("horse", "cow", "face", "sceaux", "kitchen"):
            if name in options.mesh:
                whole = clean((MODELS | {"kitchen": KITCHEN})[name].read(options.data)).mesh
                print_rates(name, Mesh(whole.vertices, whole.triangles), options.samples)
    if "colors" in options.only and "kitchen" in options.mesh:
        print_colors(KITCHEN, options.data, options.samples)
    if "growth" in options.only:
        print_growth()
    if options.picture:
        options.picture.mkdir(parents=True, exist_ok=True)
        for name, model in PICTURE_CASES.items():
            if name in options.mesh:
                mesh = model.read(options.data)
                frames = read_scan(options.data / SCAN).frames if name == "kitchen" else ()
                viewpoint = viewpoints(mesh, 1, frames=frames, width=WIDTH)[0]
                draw_levels(
                    mesh, model.run_remesh(mesh), viewpoint, options.picture / f"normal_mesh_{name}.png"
                )


def print_models(names: list[str], data: Path, samples: int) -> None:
    """Print a row for each model, then a row for each level."""
    print_head(MODEL_COLUMNS, words=2)
    later = []
    for name in names:
        model = MODELS[name]
        start = time.process_time()
        mesh = model.read(data)
        result = model.run_remesh(mesh)
        seconds = time.process_time() - start
        cells = [
            name,
            *format_counts(mesh, result, model.paper_exceptions),
            *format_distances(mesh, result.mesh, samples),
        ]
        cells += [
            *format_quality(mesh, result.mesh),
            *format_size(result, len(result.level_ends) - 1),
            f"{seconds:.2f}",
        ]
        print_row(cells)
        later += [[name, *cells] for cells in by_level(mesh, result)]
    print()
    print_head(LEVEL_COLUMNS)
    for cells in later:
        print_row(cells)


def format_counts(mesh: Mesh, result: NormalMesh, paper: str) -> list[str]:
    """Format triangle counts of all levels and the kinds of new vertices."""
    stages = " → ".join(f"{len(one.triangles):,}" for one in (mesh, *result.levels))
    kinds = np.concatenate([offsets.kinds for offsets in result.offsets])
    scalars, exceptions, boundary = (np.count_nonzero(kinds == k) for k in (SCALAR, EXCEPTION, BOUNDARY))
    share = exceptions / (scalars + exceptions)
    return [stages, f"{exceptions:,}", f"{share:.2%}", paper, f"{boundary:,}"]


def format_distances(mesh: Mesh, result: Mesh, samples: int) -> list[str]:
    """Format distances by `compare` and by PyMeshLab: forward, backward, maximum."""
    found = compare(mesh, result, samples=samples)
    there, back = (measure_hausdorff(*pair, samples) for pair in ((mesh, result), (result, mesh)))
    lengths = (found.a_to_b.rms, found.b_to_a.rms, found.symmetric.maximum)
    checks = (there["RMS"], back["RMS"], max(there["max"], back["max"]))
    return [format_number(1e5 * length / found.diagonal, ".3f") for length in (*lengths, *checks)]


def format_quality(mesh: Mesh, result: Mesh) -> list[str]:
    """Format triangle quality."""
    angles, lengths = compute_min_angles(result), compute_edge_lengths(result)
    return [
        f"{angles.min():.2f}",
        f"{np.percentile(angles, 5):.1f}",
        f"{angles.mean():.1f}",
        f"{lengths.std() / lengths.mean():.2f}",
        "{} ({})".format(*count_flipped(mesh, result)),
        f"{topology(result).degenerate}",
    ]


def format_size(result: NormalMesh, level: int) -> list[str]:
    """Format the size of the file that ends with a level."""
    size = result.level_ends[level]
    return [f"{size:,}", f"{8 * size / len(result.levels[level].vertices):.2f}"]


def by_level(mesh: Mesh, result: NormalMesh) -> Iterator[list[str]]:
    """Yield the cells of each level: exceptions, distance, triangle quality, size."""
    diagonal = float(np.linalg.norm(np.diff(compute_bounding_box(mesh), axis=0)))
    for level, light in enumerate(result.levels):
        kinds = result.offsets[level - 1].kinds if level else np.zeros(0, np.uint8)
        yield [
            str(level),
            f"{len(light.triangles):,}",
            f"{np.count_nonzero(kinds == EXCEPTION):,}",
            f"{np.count_nonzero(kinds == BOUNDARY):,}",
            format_number(measure_hausdorff(light, mesh)["max"] / diagonal, ".1e"),
            *format_quality(mesh, light),
            *format_size(result, level),
        ]


def measure_hausdorff(mesh: Mesh, other: Mesh, samples: int = 0) -> dict[str, float]:
    """Measure one-sided distances with PyMeshLab.

    Parameters
    ----------
    samples : random points on `mesh`; 0 measures its vertices.

    Returns
    -------
    "RMS" and "max", NaN if PyMeshLab is not installed.
    """
    try:
        import pymeshlab
    except ImportError:
        return {"RMS": math.nan, "max": math.nan}

    pair = pymeshlab.MeshSet()
    for one in (mesh, other):
        pair.add_mesh(pymeshlab.Mesh(one.vertices, one.triangles))
    found: dict[str, float] = pair.get_hausdorff_distance(
        sampledmesh=0,
        targetmesh=1,
        samplevert=not samples,
        sampleface=bool(samples),
        samplenum=samples or len(mesh.vertices),
    )
    return found


def format_number(value: float, form: str) -> str:
    """Format a number; empty if NaN."""
    return "" if math.isnan(value) else f"{value:{form}}"


def count_flipped(mesh: Mesh, result: Mesh) -> tuple[int, int]:
    """Count triangles that face away from the original.

    A triangle is flipped if its normal is more than 90° from the normal of the original's triangle nearest to
    its centroid. The second count omits triangles where the original itself is flipped relative to the
    surface around it.
    """
    middles, facing = result.vertices[result.triangles].mean(axis=1), compute_unit_normals(mesh)
    nearest = (
        RaycastingSurface(mesh, compute_bounding_box(mesh, result)).find_closest_points(middles).triangles
    )
    is_flipped = (compute_unit_normals(result) * facing[nearest]).sum(axis=1) < 0
    around = np.zeros(mesh.vertices.shape)
    for corner in mesh.triangles.T:
        np.add.at(around, corner, facing)
    is_consistent = (around[mesh.triangles].sum(axis=1) * facing).sum(axis=1) > 0
    return int(np.count_nonzero(is_flipped)), int(np.count_nonzero(is_flipped & is_consistent[nearest]))


def print_folds(data: Path) -> None:
    """Print a row for each mesh with crumpled regions."""
    print("\n### Folds\n")
    print_head(FOLD_COLUMNS)
    for name, mesh in {"kitchen": read_kitchen(data), "pirate": make_reader("pirate.obj")(data)}.items():
        start = time.process_time()
        found = remesh(mesh)
        seconds = time.process_time() - start
        sizes = [len(one.triangles) for one in (mesh, found.base, found.mesh)]
        away = [count_flipped(mesh, level)[1] for level in found.levels]
        by_level = [", ".join(map(str, counts)) for counts in (away, found.folded_by_level)]
        print_row(
            [name, *(f"{size:,}" for size in sizes), *by_level, f"{len(found.data):,}", f"{seconds:.1f}"]
        )


def print_colors(model: RemeshCase, data: Path, samples: int) -> None:
    """Print colour errors for each level of a coloured mesh."""
    mesh = model.read(data)
    result = model.run_remesh(mesh)
    print(f"\n### Colours, {len(mesh.vertices):,} vertices, {len(mesh.triangles):,} triangles\n")
    print_head(COLOR_COLUMNS)
    for level, light in enumerate(result.levels):
        found = compare(mesh, light, samples=samples)
        assert found.color_a_to_b is not None
        cells = [str(level), f"{len(light.vertices):,}", f"{len(light.triangles):,}"]
        cells += [f"{found.color_a_to_b.psnr:.2f}", f"{found.color_a_to_b.rmse:.2f}"]
        lengths = (found.a_to_b.rms, found.b_to_a.rms)
        cells += [f"{1e5 * length / found.diagonal:.2f}" for length in lengths]
        print_row([*cells, *format_size(result, level)])


def print_growth() -> None:
    """Print time by size of a height field, with default parameters."""
    print("\n### Growth\n")
    print_head(["triangles", "result triangles", "exceptions", "CPU s", "µs per triangle"], words=0)
    for size in SIZES:
        mesh = make_hills(size)
        start = time.process_time()
        result = remesh(mesh)
        seconds = time.process_time() - start
        exceptions = sum(offsets.count(EXCEPTION) for offsets in result.offsets)
        cells = [f"{len(mesh.triangles):,}", f"{len(result.mesh.triangles):,}", f"{exceptions:,}"]
        print_row([*cells, f"{seconds:.1f}", f"{1e6 * seconds / len(mesh.triangles):.1f}"])


if __name__ == "__main__":
    main()
