"""Damage of simplification to textured meshes: open seams and flipped texture triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from scanloom.stages.surface.edges import components, edges_of
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Surface, bounding_box

# Relative to the bounding box's diagonal: distance below which vertices are welded, and distance within which
# a border counts as a simplified border of the original.
SAME_PLACE = 1e-6
SAME_BORDER = 0.02
# Texture triangles with a smaller area, relative to the image, have no reliable orientation.
NO_AREA = 1e-12


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


def soundness(original: Mesh, light: Mesh) -> Soundness:
    """Measure new borders and flips; meshes without texture coordinates have no flips."""
    low, high = bounding_box(original)
    diagonal = float(np.linalg.norm(high - low))
    borders = [border(mesh, SAME_PLACE * diagonal) for mesh in (original, light)]
    flips, looked_at = uv_flips(original, light)
    return Soundness(new_length(*borders, SAME_BORDER * diagonal) / diagonal, flips, looked_at)


def border(mesh: Mesh, tolerance: float) -> np.ndarray:
    """Return border edges (k, 2, 3) after welding vertices within a tolerance.

    An edge that is traversed equally often in both directions is closed, whatever its number of triangles.
    """
    pairs = cKDTree(mesh.vertices).query_pairs(tolerance, output_type="ndarray")
    count, place = components(len(mesh.vertices), pairs[:, 0], pairs[:, 1])
    triangles = place[mesh.triangles].astype(np.int32)
    is_proper = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    edges = edges_of(triangles[is_proper], count)
    ends = edges.ends[edges.count % 2 == 1]
    position = np.zeros((count, 3))
    position[place] = mesh.vertices
    return position[ends]


def new_length(before: np.ndarray, after: np.ndarray, reach: float) -> float:
    """Compute the length of edges `after` farther than `reach` from edges `before`."""
    lengths = np.linalg.norm(after[:, 1] - after[:, 0], axis=1)
    if not len(before) or not len(after):
        return float(lengths.sum())
    # Sample points along the edges, at most `reach` apart.
    steps = np.ceil(np.linalg.norm(before[:, 1] - before[:, 0], axis=1) / reach).astype(int) + 1
    along = np.concatenate([np.linspace(a, b, n) for (a, b), n in zip(before, steps, strict=True)])
    distances, _ = cKDTree(along).query(after.mean(axis=1))
    return float(lengths[distances > reach].sum())


def uv_flips(original: Mesh, light: Mesh) -> tuple[int, int]:
    """Count triangles with flipped texture, and all triangles checked."""
    if original.texture is None or light.texture is None:
        return 0, 0
    middles = light.vertices[light.triangles].mean(axis=1)
    nearest = Surface(original, bounding_box(original, light)).closest(middles).triangles
    there, here = uv_areas(original.texture.uvs)[nearest], uv_areas(light.texture.uvs)
    looked_at = (np.abs(there) > NO_AREA) & (np.abs(here) > NO_AREA)
    return int(np.count_nonzero(looked_at & (there * here < 0))), int(np.count_nonzero(looked_at))


def uv_areas(uvs: np.ndarray) -> np.ndarray:
    """Compute signed areas (m,) of texture triangles."""
    (u1, v1), (u2, v2) = ((uvs[:, i] - uvs[:, 0]).T for i in (1, 2))
    return (u1 * v2 - v1 * u2) / 2
