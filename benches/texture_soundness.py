"""Damage of simplification to textured meshes: open seams and flipped texture triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from scanloom.stages.surface.edges import build_edges, label_components
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface, compute_bounding_box

# Relative to the bounding box's diagonal: distance below which vertices are welded, and distance within which
# a border counts as a simplified border of the original.
WELD_TOLERANCE = 1e-6
BORDER_TOLERANCE = 0.02
# Texture triangles with a smaller area, relative to the image, have no reliable orientation.
MIN_UV_AREA = 1e-12


@dataclass(frozen=True)
class Soundness:
    """Damage to a textured mesh.

    Attributes
    ----------
    new_border : length of borders that the original does not have, over the diagonal.
    uv_flips : triangles whose texture has the opposite orientation of the nearest original triangle.
    uv_triangles : triangles that were checked, because both have an area in the texture.
    """

    new_border: float
    uv_flips: int
    uv_triangles: int


def measure_soundness(original: Mesh, result: Mesh) -> Soundness:
    """Measure new borders and flips; meshes without texture coordinates have no flips."""
    low, high = compute_bounding_box(original)
    diagonal = float(np.linalg.norm(high - low))
    borders = [find_border(mesh, WELD_TOLERANCE * diagonal) for mesh in (original, result)]
    flips, looked_at = count_uv_flips(original, result)
    return Soundness(measure_new_length(*borders, BORDER_TOLERANCE * diagonal) / diagonal, flips, looked_at)


def find_border(mesh: Mesh, tolerance: float) -> np.ndarray:
    """Return border edges (k, 2, 3) after welding vertices within a tolerance.

    An edge that is traversed equally often in both directions is closed, whatever its number of triangles.
    """
    pairs = cKDTree(mesh.vertices).query_pairs(tolerance, output_type="ndarray")
    count, place = label_components(len(mesh.vertices), pairs[:, 0], pairs[:, 1])
    triangles = place[mesh.triangles].astype(np.int32)
    is_proper = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    edges = build_edges(triangles[is_proper], count)
    ends = edges.ends[edges.triangle_count % 2 == 1]
    position = np.zeros((count, 3))
    position[place] = mesh.vertices
    return position[ends]


def measure_new_length(before: np.ndarray, after: np.ndarray, reach: float) -> float:
    """Compute the length of edges `after` farther than `reach` from edges `before`."""
    lengths = np.linalg.norm(after[:, 1] - after[:, 0], axis=1)
    if not len(before) or not len(after):
        return float(lengths.sum())
    # Sample points along the edges, at most `reach` apart.
    steps = np.ceil(np.linalg.norm(before[:, 1] - before[:, 0], axis=1) / reach).astype(int) + 1
    along = np.concatenate([np.linspace(a, b, n) for (a, b), n in zip(before, steps, strict=True)])
    distances, _ = cKDTree(along).query(after.mean(axis=1))
    return float(lengths[distances > reach].sum())


def count_uv_flips(original: Mesh, result: Mesh) -> tuple[int, int]:
    """Count triangles with flipped texture, and all triangles checked."""
    if original.texture is None or result.texture is None:
        return 0, 0
    middles = result.vertices[result.triangles].mean(axis=1)
    nearest = (
        RaycastingSurface(original, compute_bounding_box(original, result))
        .find_closest_points(middles)
        .triangles
    )
    there, here = compute_uv_areas(original.texture.uvs)[nearest], compute_uv_areas(result.texture.uvs)
    looked_at = (np.abs(there) > MIN_UV_AREA) & (np.abs(here) > MIN_UV_AREA)
    return int(np.count_nonzero(looked_at & (there * here < 0))), int(np.count_nonzero(looked_at))


def compute_uv_areas(uvs: np.ndarray) -> np.ndarray:
    """Compute signed areas (m,) of texture triangles."""
    (u1, v1), (u2, v2) = ((uvs[:, i] - uvs[:, 0]).T for i in (1, 2))
    return (u1 * v2 - v1 * u2) / 2
