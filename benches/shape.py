"""Shape of scanned surfaces before and after refinement, next to Open3D's fusion and a fixed filter.

    python benches/shape.py SCAN [SCAN ...] [--truth MESH] [--similarity] [--regularised] [--bounds 0.001]

Prints Markdown. Each scan is adjusted, fused and cleaned with default parameters. All rows use the adjusted
poses, and Open3D's fusion uses the voxel size of the fused mesh.

- Open3D: `VoxelBlockGrid` with the constants of Open3D's documentation.
- clean: scanloom's mesh before refinement.
- normal filter: bilateral normal filtering of the clean mesh with fixed constants (peers/normal_filter.py).
- refine: scanloom's refined mesh.
- With --regularised, for scans with truth: fusion with a regularised distance field from the same samples
  (peers/regularised_fusion.py), cleaned; and the same, refined. Of several data weights λ, the row has the
  one whose mesh has the smallest mean distance to the truth. A user could not choose it.

The first table is for scans with truth: a made scan (samples/room.py) has `truth.ply` and `thin_parts.ply` in
its folder, and for other scans --truth names the true surface. With --similarity, each mesh is fitted to the
truth with a free scale first, as needed for warped depth. The second table is for scans without truth, on
places where the clean mesh is planar. Both end with the triangles that `simplify` needs at a proven bound.
Seconds are wall time of the last step of a row: fusion and cleaning, filter, or refinement; with the
given weight only. Measures are
defined in `shape_measures.py`.
"""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from fusion import RunTimes, fuse_voxel_block_grid
from markdown_tables import print_head, print_row
from peers.normal_filter import filter_mesh
from peers.regularised_fusion import REGULARISERS, Regulariser, fuse_regularised, measure_band
from peers.total_variation import VoxelOperators
from shape_measures import (
    MAX_SEEN_DISTANCE,
    PlanarPlaces,
    TruthSurface,
    count_folded_edges,
    estimate_similarity,
    find_planar_places,
    find_seen_points,
    measure_completeness,
    measure_planar_errors,
    measure_truth_errors,
    sample_surface,
    transform_mesh,
)

import scanloom
from scanloom import Mesh, Scan
from scanloom.stages.diagnostics.errors import MeshError

BOUNDS = (0.001, 0.005)
# Samples of a mesh for choosing the weight of its data.
_CHOICE_SAMPLES = 100_000
TRUTH_COLUMNS = (
    "mean / RMS / 95 % mm",
    "normals, median / 90 %",
    "RMS near edges mm",
    "complete, all / thin",
)
PLANAR_COLUMNS = (
    "normals, median / 90 %",
    "RMS within 6 cm, median / 90 % mm",
    "RMS within 20 cm, median / 90 % mm",
)


@dataclass(frozen=True, eq=False)
class ScannedSurface:
    """Mesh of a scan, and the seconds of its last step."""

    name: str
    mesh: Mesh
    seconds: float


@dataclass(frozen=True, eq=False)
class Truth:
    """True surface of a scan, with the points that frames see.

    Attributes
    ----------
    surface : the true surface.
    seen_points : (n, 3) seen points of all surfaces.
    thin_points : (n, 3) seen points of thin parts; empty if they are not known.
    """

    surface: TruthSurface
    seen_points: np.ndarray
    thin_points: np.ndarray

    @classmethod
    def read(cls, path: Path, scan: Scan, max_distance: float) -> Truth:
        """Read the true surface, and `thin_parts.ply` next to it."""
        mesh = scanloom.read_mesh(path)
        surface = TruthSurface(mesh)

        def sample_seen(part: Mesh) -> np.ndarray:
            samples = sample_surface(part)
            return samples.points[find_seen_points(samples, surface, scan.frames, max_distance)]

        thin = path.with_name("thin_parts.ply")
        thin_points = sample_seen(scanloom.read_mesh(thin)) if thin.exists() else np.zeros((0, 3))
        return cls(surface, sample_seen(mesh), thin_points)


def adjust_scan(scan: Scan) -> Scan:
    """Adjust poses and colour camera; scans that agree already stay as they are."""
    return replace(scan, frames=scanloom.adjust(scan).frames)


def make_surfaces(scan: Scan) -> Iterator[ScannedSurface]:
    """Yield the surfaces of a scan with adjusted poses; the clean mesh comes first."""
    start = time.perf_counter()
    fused = scanloom.fuse(scan)
    clean = scanloom.clean(fused.mesh).mesh
    yield ScannedSurface("clean", clean, time.perf_counter() - start)
    steps: dict[str, Callable[[], Mesh]] = {
        "Open3D": lambda: fuse_voxel_block_grid(scan, fused.voxel_size, RunTimes()),
        "normal filter": lambda: filter_mesh(clean),
        "refine": lambda: scanloom.refine(clean, scan).mesh,
    }
    for name, step in steps.items():
        start = time.perf_counter()
        mesh = step()
        yield ScannedSurface(name, mesh, time.perf_counter() - start)


def make_regularised_surfaces(scan: Scan, measure_error: Callable[[Mesh], float]) -> Iterator[ScannedSurface]:
    """Yield the best surfaces of regularised fusion, and the best ones of its refinement.

    Parameters
    ----------
    scan : scan with adjusted poses.
    measure_error : error of a mesh that chooses the weight of the data.
    """
    start = time.perf_counter()
    band = measure_band(scan)
    operators = VoxelOperators(band.positions)
    shared_seconds = time.perf_counter() - start

    def make_fused(regulariser: Regulariser, weight: float) -> ScannedSurface:
        start = time.perf_counter() - shared_seconds
        mesh = scanloom.clean(fuse_regularised(band, operators, regulariser, weight)).mesh
        return ScannedSurface(f"{regulariser.name}, λ {weight:g}", mesh, time.perf_counter() - start)

    def make_refined(fused: ScannedSurface) -> ScannedSurface:
        start = time.perf_counter()
        mesh = scanloom.refine(fused.mesh, scan).mesh
        return ScannedSurface(f"{fused.name}, refine", mesh, time.perf_counter() - start)

    def choose(surfaces: Iterable[ScannedSurface]) -> ScannedSurface:
        return min(surfaces, key=lambda surface: measure_error(surface.mesh))

    for regulariser in REGULARISERS:
        surfaces = []
        for weight in regulariser.data_weights:
            # A small weight may leave no surface at all.
            with contextlib.suppress(MeshError):
                surfaces.append(make_fused(regulariser, weight))
        yield choose(surfaces)
        if regulariser.order == 2:
            yield choose(map(make_refined, surfaces))


def make_all_surfaces(
    scan: Scan, truth: Truth | None, options: argparse.Namespace
) -> Iterator[ScannedSurface]:
    """Yield the surfaces that the options ask for."""
    yield from make_surfaces(scan)
    if options.regularised and truth is not None:

        def measure_error(mesh: Mesh) -> float:
            placed = fit_to_truth(mesh, truth, options)
            return measure_truth_errors(placed, truth.surface, _CHOICE_SAMPLES).mean_m

        yield from make_regularised_surfaces(scan, measure_error)


def fit_to_truth(mesh: Mesh, truth: Truth, options: argparse.Namespace) -> Mesh:
    """Fit a mesh to the truth with a free scale, if asked."""
    return transform_mesh(mesh, estimate_similarity(mesh, truth.surface)) if options.similarity else mesh


def format_truth_cells(mesh: Mesh, truth: Truth) -> list[str]:
    """Measure a mesh against the truth; return the cells of its row."""
    errors = measure_truth_errors(mesh, truth.surface)
    complete = [
        f"{100 * measure_completeness(points, mesh):.1f} %" if len(points) else "–"
        for points in (truth.seen_points, truth.thin_points)
    ]
    return [
        " / ".join(f"{1000 * value:.2f}" for value in (errors.mean_m, errors.rms_m, errors.p95_m)),
        f"{errors.normal_median_deg:.2f}° / {errors.normal_p90_deg:.1f}°",
        f"{1000 * errors.sharp_rms_m:.2f}",
        " / ".join(complete),
    ]


def format_planar_cells(mesh: Mesh, places: PlanarPlaces) -> list[str]:
    """Measure a mesh on planar places; return the cells of its row."""
    errors = measure_planar_errors(mesh, places)
    return [
        f"{errors.normal_median_deg:.1f}° / {errors.normal_p90_deg:.1f}°",
        f"{1000 * errors.near_median_m:.2f} / {1000 * errors.near_p90_m:.1f}",
        f"{1000 * errors.far_median_m:.2f} / {1000 * errors.far_p90_m:.1f}",
    ]


def count_triangles(mesh: Mesh, bound: float) -> str:
    """Simplify within a proven bound in metres; return the number of triangles."""
    result = scanloom.simplify(Mesh(mesh.vertices, mesh.triangles), max_shape=bound, method="certified")
    return f"{len(result.mesh.triangles):,}"


def print_scan(path: Path, truth_path: Path | None, options: argparse.Namespace) -> None:
    """Print the rows of a scan."""
    scan = adjust_scan(scanloom.read_scan(path))
    truth = None if truth_path is None else Truth.read(truth_path, scan, options.seen_distance)
    places = None
    for surface in make_all_surfaces(scan, truth, options):
        if truth is not None:
            cells = format_truth_cells(fit_to_truth(surface.mesh, truth, options), truth)
        else:
            places = find_planar_places(surface.mesh) if places is None else places
            cells = format_planar_cells(surface.mesh, places)
        counts = [count_triangles(surface.mesh, bound) for bound in options.bounds]
        folds = f"{count_folded_edges(surface.mesh):,}"
        print_row([path.resolve().name, surface.name, *cells, folds, *counts, f"{surface.seconds:.1f}"])
        if options.meshes is not None:
            file = options.meshes / f"{path.resolve().name}-{surface.name.replace(' ', '-')}.ply"
            scanloom.write_mesh(file, surface.mesh)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scans", nargs="+", type=Path, metavar="SCAN")
    parser.add_argument(
        "--truth", type=Path, metavar="MESH", help="the true surface of scans without truth.ply"
    )
    parser.add_argument("--similarity", action="store_true", help="fit meshes to the truth with a free scale")
    parser.add_argument(
        "--regularised", action="store_true", help="add fusion with a regularised distance field (slow)"
    )
    parser.add_argument(
        "--seen-distance",
        type=float,
        default=MAX_SEEN_DISTANCE,
        help="metres up to which a frame sees the truth, for completeness",
    )
    parser.add_argument("--bounds", type=float, nargs="+", default=BOUNDS, help="of simplification, metres")
    parser.add_argument("--meshes", type=Path, help="folder to write all meshes to")
    options = parser.parse_args()
    # Another checkout on the path would be measured without notice.
    print(f"Checkout: {Path(scanloom.__file__).resolve().parents[1].name}\n")
    truths = {path: find_truth(path, options.truth) for path in options.scans}
    counts = [f"triangles at {1000 * bound:g} mm" for bound in options.bounds]
    for has_truth, columns in ((True, TRUTH_COLUMNS), (False, PLANAR_COLUMNS)):
        paths = [path for path, truth in truths.items() if (truth is not None) == has_truth]
        if paths:
            print_head(["scan", "surface", *columns, "folded edges", *counts, "s"], words=2)
        for path in paths:
            print_scan(path, truths[path], options)
        if paths:
            print()


def find_truth(scan: Path, other: Path | None) -> Path | None:
    """Find the true surface of a scan: in its folder, or the other file."""
    own = scan / "truth.ply"
    return own if own.exists() else other


if __name__ == "__main__":
    main()
