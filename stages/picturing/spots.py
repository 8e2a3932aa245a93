"""Clouds of points as small triangles, so that they are drawn as surfaces are."""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.cloud import some_of
from scanloom.stages.surface.mesh import Mesh

# From a spot's centre to its corners, in distances to the nearest neighbour: large enough to close the gaps
# between points that are spread at random.
_REACH = 2.0
# Corners around a centre.
_CORNERS = np.radians((90.0, 210.0, 330.0))
_SPACING_AT = 20_000


def spots(cloud: Mesh, most: int) -> Mesh:
    """Return a triangle for each of at most so many points of a cloud, of its colour, facing as it does."""
    from scipy.spatial import cKDTree

    chosen = some_of(cloud, most)
    points, normals = chosen.vertices, chosen.normals
    assert normals is not None
    near = cKDTree(points, balanced_tree=False).query(points[:: 1 + len(points) // _SPACING_AT], 2)[0][:, 1]
    reach = _REACH * float(np.median(near[near > 0])) if near.any() else 0.0
    # Two directions square to each normal, from the axis that it is farthest from.
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    across = np.cross(normals, axis)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    along = np.cross(normals, across)
    around = np.cos(_CORNERS)[:, None] * across[:, None] + np.sin(_CORNERS)[:, None] * along[:, None]
    return Mesh(
        (points[:, None] + reach * around).reshape(-1, 3),
        np.arange(3 * len(points), dtype=np.int32).reshape(-1, 3),
        None if chosen.colors is None else np.repeat(chosen.colors, 3, axis=0),
        up=cloud.up,
    )
