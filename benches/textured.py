"""Comparison of simplifiers on textured models: time, shape, colour, cracks and flips.

    python benches/textured.py DATA [--models FOLDER] [--ratios 0.1 0.03] [--mesh duck] [--only PyMeshLab]

DATA holds `meshes/` and `real/`. `--models` adds every textured GLB, glTF and OBJ file of a folder, at any
depth. A Markdown table is printed for each model and ratio. The summary compares scanloom with texture
coordinates kept to the best peer in each column, and names a peer that is better in both. A missing peer is
skipped with a line that gives the reason.

All simplifiers get the same mesh, cleaned, with texture coordinates per corner and a material per triangle.
Tools that support only one texture coordinate per vertex get duplicated vertices along seams.

"CPU s" is the CPU time of the call. Shape is two-sided, over the bounding box's diagonal. Colour is sampled
on both surfaces through their textures, against the nearest point of the other. "new border" is the length of
borders that the original does not have, over the diagonal, after welding coincident vertices. "UV flips" are
triangles whose texture is mirrored compared to the nearest original triangle. "MB" is the size of the result
as GLB.
"""

from __future__ import annotations

import argparse
import ctypes
import math
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from markdown_tables import print_head, print_row
from peers import native
from peers.tools import get_pointer
from texture_soundness import measure_soundness

from scanloom.stages.cleaning.clean import clean
from scanloom.stages.comparing.compare import compare
from scanloom.stages.diagnostics.errors import ScanloomError
from scanloom.stages.files.image_bytes import decode_image
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Image, Material, Mesh
from scanloom.stages.surface.mesh_conversion import as_mesh, bake_vertex_colors, to_open3d, to_open3d_legacy
from scanloom.stages.surface.mesh_files import read_mesh, write_mesh
from scanloom.stages.surface.surface_color import has_color
from scanloom.stages.texturing.bake import bake

Simplifier = Callable[[Mesh, int], tuple[Callable[[], Any], Callable[[Any], Mesh]]]

MODELS = {
    "spot": "meshes/spot/spot_triangulated.obj",
    "banana": "meshes/ycb_banana/*.obj",
    "bunny": "meshes/bunny10k_textured/*.obj",
    "fuze": "meshes/fuze/*.obj",
    "duck": "meshes/Duck.glb",
    "milk_truck": "meshes/CesiumMilkTruck.glb",
    "can": "meshes/textured_scans/can.glb",
    "foot": "meshes/textured_scans/foot_polycam.glb",
    "room_corner": "meshes/textured_scans/room_corner_polycam.glb",
    "meshroom": "real/mesh_meshroom_object/*.obj",
}
SUFFIXES = (".glb", ".gltf", ".obj")
COLUMNS = (
    "tool",
    "triangles",
    "CPU s",
    "RMS ×1e-5",
    "max ×1e-5",
    "PSNR dB",
    "new border",
    "UV flips",
    "MB",
)
SUMMARY = (
    "model",
    "ratio",
    "triangles",
    "RMS, ours",
    "RMS, best peer",
    "PSNR, ours",
    "PSNR, best peer",
    "at least as good",
    "better in both",
)
OURS = "scanloom --keep-uv"
# A result with more triangles than this multiple of the target cannot be compared.
MAX_COUNT_RATIO = 1.05

# Options of meshoptimizer's simplifier, and its flag for protected vertices.
PERMISSIVE, REGULARIZE_LIGHT = 1 << 5, 1 << 6
PROTECTED = 1 << 1


@dataclass(frozen=True)
class TexturedResult:
    """Measured result of one tool on one model."""

    tool: str
    triangles: int
    seconds: float
    rms: float
    maximum: float
    psnr: float | None
    new_border: float
    uv_flips: str
    megabytes: float

    def format_cells(self) -> list[str]:
        """Format the row for the table."""
        return [
            self.tool,
            f"{self.triangles:,}",
            f"{self.seconds:.2f}",
            f"{self.rms:.1f}",
            f"{self.maximum:.0f}",
            "dropped" if self.psnr is None else f"{self.psnr:.1f}",
            f"{self.new_border:.3f}",
            self.uv_flips,
            f"{self.megabytes:.2f}",
        ]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--models", type=Path, help="folder of further textured models")
    parser.add_argument("--ratios", type=float, nargs="+", default=[0.1, 0.03])
    parser.add_argument("--mesh", nargs="*", choices=MODELS, default=list(MODELS))
    parser.add_argument("--only", nargs="+", metavar="TOOL", help="tools whose names start with TOOL")
    parser.add_argument("--samples", type=int, default=200_000)
    options = parser.parse_args()
    prefixes = tuple(name.lower() for name in options.only or [""])
    tools = {name: tool for name, tool in TOOLS.items() if name.lower().startswith(prefixes)}
    summary = []
    for name, mesh in read_models(options.data, options.mesh, options.models):
        for ratio in options.ratios:
            target = math.floor(ratio * len(mesh.triangles))
            print(f"\n### {name}, {len(mesh.triangles):,} triangles to {ratio:.0%}\n")
            print_head(COLUMNS)
            rows = []
            for tool, prepare in tools.items():
                row = measure(tool, mesh, target, prepare, options.samples)
                if isinstance(row, TexturedResult):
                    rows.append(row)
                print_row(
                    row.format_cells()
                    if isinstance(row, TexturedResult)
                    else [tool, row, *[""] * (len(COLUMNS) - 2)]
                )
            summary.append((name, ratio, target, rows))
    print_summary(summary)


def read_models(data: Path, names: list[str], folder: Path | None) -> Iterator[tuple[str, Mesh]]:
    """Yield name and mesh of each textured model; report unusable files."""
    paths = [(name, path) for name in names for path in sorted(data.glob(MODELS[name]))[:1]]
    if folder is not None:
        found = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
        paths += [(path.relative_to(folder).with_suffix("").as_posix(), path) for path in found]
    for name, path in paths:
        try:
            mesh = read_model(path)
        except ScanloomError as error:
            print(f"\nskipped {name}: {error}", flush=True)
            continue
        if mesh.texture is None or not mesh.texture.images:
            print(f"\nskipped {name}: it has no texture image", flush=True)
            continue
        yield name, mesh


def read_model(path: Path) -> Mesh:
    """Read a model and clean it to a manifold; small components stay."""
    mesh = read_mesh(path)
    if mesh.texture is None:
        return mesh
    mesh = clean(mesh, min_island_area=0.0).mesh.with_(normals=None, corner_normals=None)
    images = sorted(path.parent.glob("*.png"))
    if mesh.texture is not None and not mesh.texture.images and images and path.suffix.lower() == ".obj":
        # An OBJ file without an MTL file, next to its image.
        pixels = decode_image(images[0].read_bytes())
        materials = (Material(image=Image(given=pixels)),)
        ids = np.zeros(len(mesh.triangles), np.int32)
        mesh = mesh.with_(texture=replace(mesh.texture, materials=materials, material_ids=ids))
    return mesh


def measure(tool: str, mesh: Mesh, triangles: int, prepare: Simplifier, samples: int) -> TexturedResult | str:
    """Run a tool and measure its result, or return the reason for its failure."""
    try:
        work, unpack = prepare(mesh, triangles)
        start = time.process_time()
        raw = work()
        seconds = time.process_time() - start
        simplified = unpack(raw)
    except Exception as error:  # a peer may fail in any way; the row gives the reason
        return f"skipped: {(str(error) or type(error).__name__).splitlines()[0][:90]}"
    if len(simplified.triangles) == 0:
        return "skipped: nothing is left"
    found = compare(mesh, simplified, samples=samples)
    damage = measure_soundness(mesh, simplified)
    is_colored = has_color(simplified) and found.color is not None
    return TexturedResult(
        tool=tool,
        triangles=len(simplified.triangles),
        seconds=seconds,
        rms=1e5 * found.symmetric.rms / found.diagonal,
        maximum=1e5 * found.symmetric.maximum / found.diagonal,
        psnr=found.color.psnr if is_colored and found.color else None,
        new_border=damage.new_border,
        uv_flips=f"{damage.uv_flips} of {damage.uv_triangles}" if has_same_images(mesh, simplified) else "",
        megabytes=measure_glb_bytes(simplified) / 1e6,
    )


def measure_glb_bytes(mesh: Mesh) -> int:
    """Return the size of a mesh as GLB file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "mesh.glb")
        write_mesh(path, mesh)
        return path.stat().st_size


def has_same_images(mesh: Mesh, simplified: Mesh) -> bool:
    """Check if the simplified mesh still has the original images.

    Newly baked images may contain mirrored charts.
    """
    if mesh.texture is None or simplified.texture is None:
        return False
    return [id(image) for image in simplified.texture.images] == [id(image) for image in mesh.texture.images]


def print_summary(summary: list[tuple[str, float, int, list[TexturedResult]]]) -> None:
    """Print our result with kept coordinates against the best peer."""
    print("\n### Summary: texture coordinates kept, against the best peer in each column\n")
    print_head(SUMMARY)
    good = {"RMS": 0, "PSNR": 0, "both": 0}
    compared = unbeaten = 0
    for name, ratio, target, rows in summary:
        ours = next((row for row in rows if row.tool == OURS), None)
        peers = [row for row in rows if not row.tool.startswith("scanloom") and is_comparable(row, target)]
        if ours is None or ours.psnr is None or not peers:
            continue
        best_rms = min(peers, key=lambda row: row.rms)
        best_psnr = max(peers, key=lambda row: row.psnr or 0.0)
        reached = is_comparable(ours, target)
        # Compared as printed: differences of less than half a unit of the last digit do not count.
        is_good = {
            "RMS": reached and round(ours.rms, 1) <= round(best_rms.rms, 1),
            "PSNR": reached and round(ours.psnr, 1) >= round(best_psnr.psnr or 0.0, 1),
        }
        is_good["both"] = all(is_good.values())
        compared += 1
        for key, value in is_good.items():
            good[key] += value
        better = [row.tool for row in peers if not reached or is_better_in_both(row, ours)]
        unbeaten += not better
        named = [key for key in ("RMS", "PSNR") if is_good[key]]
        verdict = "both" if is_good["both"] else ", ".join(named) or "–"
        print_row(
            [
                name,
                f"{ratio:.0%}",
                f"{ours.triangles:,}",
                f"{ours.rms:.1f}",
                f"{best_rms.rms:.1f} ({best_rms.tool})",
                f"{ours.psnr:.1f}",
                f"{best_psnr.psnr:.1f} ({best_psnr.tool})",
                verdict if reached else f"no: the target is {target:,} triangles",
                better[0] if better else "–",
            ]
        )
    print(
        f"\nOf {compared} cases, {OURS} is at least as good as the best peer in RMS in {good['RMS']}, "
        f"in PSNR in {good['PSNR']}, in both in {good['both']}. "
        f"In {unbeaten}, no single peer is better in both."
    )


def is_better_in_both(peer: TexturedResult, ours: TexturedResult) -> bool:
    """Check if a peer is better in shape and colour, as printed."""
    return round(peer.rms, 1) < round(ours.rms, 1) and round(peer.psnr or 0.0, 1) > round(ours.psnr or 0.0, 1)


def is_comparable(row: TexturedResult, target: int) -> bool:
    """Check if a tool reached the target and kept the texture."""
    return row.psnr is not None and row.triangles <= max(MAX_COUNT_RATIO * target, target + 2)


def run_default(mesh: Mesh, triangles: int) -> tuple[Callable[[], Any], Callable[[Any], Mesh]]:
    """Simplify as the command does by default.

    A new texture is baked if the method drops the images.
    """

    def work() -> Mesh:
        simplified = simplify(mesh, triangles=triangles).mesh
        is_textured = simplified.texture is not None and bool(simplified.texture.images)
        return simplified if is_textured else bake(simplified, mesh).mesh

    return work, lambda simplified: simplified


def run_keep_uv(mesh: Mesh, triangles: int) -> tuple[Callable[[], Any], Callable[[Any], Mesh]]:
    """Collapse with texture coordinates as attributes and seams kept."""
    return lambda: simplify(mesh, method="seams", triangles=triangles), lambda result: result.mesh


def run_baked(mesh: Mesh, triangles: int) -> tuple[Callable[[], Any], Callable[[Any], Mesh]]:
    """Collapse with vertex colours, then bake a new texture."""
    colored = bake_vertex_colors(mesh)
    return lambda: bake(simplify(colored, triangles=triangles).mesh, mesh), lambda result: result.mesh


def run_pymeshlab(mesh: Mesh, triangles: int) -> tuple[Callable[[], Any], Callable[[Any], Mesh]]:
    """Collapse with MeshLab's quadrics for position and texture."""
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    # The filter requires a mesh that was loaded with its images.
    with tempfile.TemporaryDirectory() as folder:
        write_mesh(Path(folder, "given.obj"), mesh)
        meshes.load_new_mesh(str(Path(folder, "given.obj")))
    # PyMeshLab does not return material indices: each triangle carries the index of its original.
    meshes.compute_scalar_by_function_per_face(q="fi")

    def unpack(_: Any) -> Mesh:
        simplified = meshes.current_mesh()
        corners = simplified.wedge_tex_coord_matrix().reshape(-1, 3, 2)
        ids = mesh.texture.material_ids[simplified.face_scalar_array().astype(int)]
        return add_texture(mesh, simplified.vertex_matrix(), simplified.face_matrix(), corners, ids)

    return (
        lambda: meshes.meshing_decimation_quadric_edge_collapse_with_texture(targetfacenum=triangles),
        unpack,
    )


def run_meshoptimizer(weight: float, options: int) -> Simplifier:
    """Return the simplifier that updates positions and texture coordinates.

    Vertices at equal positions are treated as one.

    Parameters
    ----------
    weight : of texture coordinates relative to positions.
    options : bits of `meshopt_Simplify…`. With PERMISSIVE, vertices between materials are protected.
    """

    def prepare(mesh: Mesh, triangles: int) -> tuple[Callable[[], Any], Callable[[Any], Mesh]]:
        library = native.load_meshoptimizer()
        corners = mesh.triangles.reshape(-1)
        # Wedges are split by material, so that triangles keep their material.
        rows = np.column_stack(
            [corners, mesh.texture.uvs.reshape(-1, 2), np.repeat(mesh.texture.material_ids, 3)]
        )
        wedges, indices = np.unique(rows, axis=0, return_inverse=True)
        indices = indices.reshape(-1, 3).astype(np.uint32)
        vertex, material = wedges[:, 0].astype(int), wedges[:, 3].astype(np.int32)
        positions = mesh.vertices[vertex].astype(np.float32)
        uvs = wedges[:, 1:3].astype(np.float32)
        weights = np.full(2, weight, np.float32)
        pairs = np.unique(np.column_stack([vertex, material]), axis=0)
        is_between = np.bincount(pairs[:, 0], minlength=len(mesh.vertices)) > 1
        flags = np.where(is_between[vertex] & bool(options & PERMISSIVE), PROTECTED, 0).astype(np.uint8)

        def call() -> int:
            return library.simplify_with_options(
                get_pointer(indices),
                ctypes.c_size_t(len(indices)),
                get_pointer(positions),
                get_pointer(uvs),
                ctypes.c_size_t(len(positions)),
                get_pointer(weights),
                ctypes.c_size_t(2),
                ctypes.c_size_t(triangles),
                get_pointer(flags),
                ctypes.c_uint(options),
            )

        def unpack(left: int) -> Mesh:
            chosen = indices[:left]
            return add_texture(mesh, positions, chosen, uvs[chosen], material[chosen[:, 0]])

        return call, unpack

    return prepare


def run_open3d_legacy(mesh: Mesh, triangles: int) -> tuple[Callable[[], Any], Callable[[Any], Mesh]]:
    """Collapse with Open3D's legacy quadric decimation."""
    given = to_open3d_legacy(mesh.with_(texture=None, part_ids=None, part_names=(), up=None))
    return lambda: given.simplify_quadric_decimation(triangles), as_mesh


def run_open3d_tensor(mesh: Mesh, triangles: int) -> tuple[Callable[[], Any], Callable[[Any], Mesh]]:
    """Collapse with Open3D's tensor decimation, which uses VTK."""
    given = to_open3d(mesh.with_(texture=None, part_ids=None, part_names=(), up=None))
    reduction = 1 - triangles / len(mesh.triangles)
    return lambda: given.simplify_quadric_decimation(reduction), as_mesh


def add_texture(
    mesh: Mesh, vertices: np.ndarray, triangles: np.ndarray, uvs: np.ndarray, ids: np.ndarray
) -> Mesh:
    """Add materials of the original to a peer's result."""
    texture = replace(mesh.texture, uvs=uvs.astype(np.float64), material_ids=ids.astype(np.int32))
    return Mesh(vertices.astype(np.float64), triangles.astype(np.int32), texture=texture)


TOOLS: Mapping[str, Simplifier] = {
    "scanloom": run_default,
    OURS: run_keep_uv,
    "scanloom, baked": run_baked,
    "PyMeshLab, with texture": run_pymeshlab,
    "meshoptimizer, weight 0.1": run_meshoptimizer(0.1, 0),
    "meshoptimizer, weight 1": run_meshoptimizer(1.0, 0),
    "meshoptimizer, light, weight 0.1": run_meshoptimizer(0.1, REGULARIZE_LIGHT),
    "meshoptimizer, light, weight 1": run_meshoptimizer(1.0, REGULARIZE_LIGHT),
    "meshoptimizer, permissive, weight 1": run_meshoptimizer(1.0, PERMISSIVE),
    "meshoptimizer, permissive, light, weight 1": run_meshoptimizer(1.0, PERMISSIVE | REGULARIZE_LIGHT),
    "Open3D legacy": run_open3d_legacy,
    "Open3D tensor": run_open3d_tensor,
}


if __name__ == "__main__":
    main()
