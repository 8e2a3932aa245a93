"""Point splats: point clouds as small triangles for the mesh renderer."""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.cloud import some_of
from scanloom.stages.surface.mesh import Mesh

# Circumradius of a splat in distances to the nearest neighbour: closes the gaps between random points.
_REACH = 2.0
# Angles of the corners around the centre, radians.
_CORNERS = np.radians((90.0, 210.0, 330.0))
_SPACING_AT = 20_000


def spots(cloud: Mesh, most: int) -> Mesh:
    """Convert a point cloud to one triangle per point, for at most `most` points.

    Each triangle has the colour of its point and faces along its normal.
    """
    from scipy.spatial import cKDTree

    chosen = some_of(cloud, most)
    points, normals = chosen.vertices, chosen.normals
    assert normals is not None
    near = cKDTree(points, balanced_tree=False).query(points[:: 1 + len(points) // _SPACING_AT], 2)[0][:, 1]
    reach = _REACH * float(np.median(near[near > 0])) if near.any() else 0.0
    # Two tangents of each normal, starting from the axis that is most perpendicular to it.
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
