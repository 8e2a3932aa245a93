"""Check of the deviation bounds of `simplify` by independent measurement.

    python benches/bounds.py DATA [--samples 1000000] [--method certified] [--mesh horse.ply ...]

DATA holds `meshes/`. Prints a Markdown table for each method. Distances are searched in both directions: at
random points (`--samples`), at every vertex, and at fixed points in every triangle (centroid and points on
edges). Nearest points come from Open3D in single precision. Colours are compared as vectors of three
channels.

`jia01` bounds sums that no proof relates to the distance; its ratio of measured deviation to bound is only
empirical. For `certified`, a ratio above 1 would disprove the bound, and a ratio far below 1 would make the
bound too loose to be useful.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from scanloom.stages.cleaning.clean import clean
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.raycasting import (
    ClosestPoints,
    Floats,
    RaycastingSurface,
    compute_bounding_box,
    interpolate_values,
)
from scanloom.stages.surface.topology import compute_areas

MESHES = (
    "camelhead.off",
    "colored_airplane.ply",
    "cow.obj",
    "face.obj",
    "fandisk.obj",
    "horse.ply",
    "igea.ply",
    "redkitchen_fused_vertexcolor.ply",
    "rocker-arm.obj",
    "sceaux_mvs_scene_mesh.ply",
    "spot/spot_triangulated.obj",
    "ycb_banana/textured_simple_reoriented.obj",
)
# Bounds on shape over the diagonal of the bounding box, and on colour. The colour sums of jia01 are large
# enough for the shape bound to decide; the colour levels of certified are not.
SUM_BOUNDS = ((2e-4, 20.0), (1e-3, 60.0), (5e-3, 400.0), (2e-2, 2000.0))
LEVEL_BOUNDS = ((2e-4, 8.0), (1e-3, 20.0), (5e-3, 60.0))
HEADS = {
    "jia01": "| mesh | bound / diagonal | removed | measured / bound |\n|---|---:|---:|---:|",
    "certified": "| mesh | bound / diagonal | colour levels | removed | measured / proven | proven / bound "
    "| colour: measured / proven | colour: proven / bound |\n|---|---:|---:|---:|---:|---:|---:|---:|",
}
# Barycentric coordinates checked in every triangle: the centroid, and 1/4, 1/2 and 3/4 of each edge.
BARYCENTRIC_SAMPLES = np.array(
    [[1 / 3, 1 / 3, 1 / 3]]
    + [list(np.roll([t, 1 - t, 0], turn)) for t in (0.25, 0.5, 0.75) for turn in range(3)]
)


def check_sum_bounds(mesh: Mesh, name: str, samples: int) -> Iterator[tuple[str, float]]:
    """Yield a table row and the ratio of measured to required distance.

    One pair for each bound in SUM_BOUNDS, for the method `jia01`.
    """
    for relative, texture in SUM_BOUNDS:
        size = compute_diagonal(mesh)
        bound = relative * size
        own = {"resolution": size}
        light = simplify(mesh, method="jia01", max_shape=bound, max_color=texture, jia01=own).mesh
        ratio = find_two_sided_maximum(mesh, light, samples)[0] / bound
        yield f"| {name} | {relative:g} | {format_removed_ratio(mesh, light)} | {ratio:.4f} |", ratio


def check_certified_bounds(mesh: Mesh, name: str, samples: int) -> Iterator[tuple[str, float]]:
    """Yield table row and measured / proven for each bound of `certified`."""
    for relative, levels in LEVEL_BOUNDS:
        bound = relative * compute_diagonal(mesh)
        color_bound = levels if mesh.colors is not None else None
        result = simplify(mesh, method="certified", max_shape=bound, max_color=color_bound)
        distance, difference = find_two_sided_maximum(mesh, result.mesh, samples)
        ratio = distance / result.details.shape_bound_m
        cells = f"{ratio:.3f} | {result.details.shape_bound_m / bound:.3f}"
        if result.details.color_bound_levels is None:
            cells += " |  | "
        else:
            color_ratio = difference / result.details.color_bound_levels
            cells += f" | {color_ratio:.3f} | {result.details.color_bound_levels / levels:.3f}"
            ratio = max(ratio, color_ratio)
        bound_cell = "" if color_bound is None else f"{levels:g}"
        yield (
            f"| {name} | {relative:g} | {bound_cell} | {format_removed_ratio(mesh, result.mesh)} | {cells} |",
            ratio,
        )


METHODS = {"jia01": check_sum_bounds, "certified": check_certified_bounds}


def find_two_sided_maximum(a: Mesh, b: Mesh, samples: int) -> tuple[float, float]:
    """Find the largest two-sided distance and colour difference between meshes.

    Distance in metres, colour difference in 8-bit levels.
    """
    box = compute_bounding_box(a, b)
    found = [
        find_one_sided_maximum(one, RaycastingSurface(other, box), samples) for one, other in ((a, b), (b, a))
    ]
    return max(distance for distance, _ in found), max(levels for _, levels in found)


def find_one_sided_maximum(mesh: Mesh, other: RaycastingSurface, samples: int) -> tuple[float, float]:
    """Find the largest distance and colour difference from `mesh` to `other`.

    Distance in metres, colour difference in 8-bit levels.
    """
    distance = levels = 0.0
    for at in sample_points(mesh, samples):
        nearest = other.find_closest_points(interpolate_values(mesh.vertices, mesh, at))
        distance = max(distance, float(nearest.distances.max()))
        if mesh.colors is not None and other.mesh.colors is not None:
            there = interpolate_values(other.mesh.colors, other.mesh, nearest)
            apart = np.linalg.norm(interpolate_values(mesh.colors, mesh, at) - there, axis=1)
            levels = max(levels, float(apart.max()))
    return distance, levels


def sample_points(mesh: Mesh, samples: int) -> Iterator[ClosestPoints]:
    """Yield batches of sample points on a surface.

    First all vertices, then the points of `BARYCENTRIC_SAMPLES` in every triangle, then random points by
    area.
    """
    every = np.arange(len(mesh.triangles))
    for weights in (*np.eye(3), *BARYCENTRIC_SAMPLES):
        yield make_locations(every, np.broadcast_to(weights, (len(every), 3)))
    random = np.random.default_rng(0)
    area: Floats = compute_areas(mesh.vertices, mesh.triangles)
    triangles = np.sort(random.choice(len(area), samples, p=area / area.sum()))
    yield make_locations(triangles, random.dirichlet(np.ones(3), samples))


def make_locations(triangles: np.ndarray, weights: Floats) -> ClosestPoints:
    """Make surface locations from triangle indices (n,) and barycentric coordinates (n, 3)."""
    return ClosestPoints(triangles, weights, np.zeros(len(triangles)))


def compute_diagonal(mesh: Mesh) -> float:
    """Compute the length of the bounding box's diagonal, metres."""
    low, high = compute_bounding_box(mesh)
    return float(np.linalg.norm(high - low))


def format_removed_ratio(mesh: Mesh, simplified: Mesh) -> str:
    """Format the ratio of removed triangles."""
    return f"{1 - len(simplified.triangles) / len(mesh.triangles):.1%}"


def main() -> None:
    """Print the tables."""
    assert __doc__ is not None
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--method", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--mesh", nargs="+", default=MESHES, help="files in DATA/meshes")
    options = parser.parse_args()
    for method in options.method:
        print(f"\n{method}:\n\n{HEADS[method]}")
        largest = 0.0
        for name in options.mesh:
            mesh = clean(read_mesh(options.data / "meshes" / name)).mesh
            for row, ratio in METHODS[method](mesh, name, options.samples):
                largest = max(largest, ratio)
                print(row, flush=True)
        print(f"\nLargest ratio: {largest:.4f}")


if __name__ == "__main__":
    main()
