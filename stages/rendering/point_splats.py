"""Point splats: point clouds as small triangles for the mesh renderer."""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.point_cloud import subsample_cloud

# Circumradius of a splat in distances to the nearest neighbour: closes the gaps between random points.
_SPLAT_RADIUS = 2.0
# Angles of the corners around the centre, radians.
_CORNER_ANGLES = np.radians((90.0, 210.0, 330.0))
_SPACING_SAMPLES = 20_000


def make_point_splats(cloud: Mesh, max_points: int) -> Mesh:
    """Convert a point cloud to one triangle per point, for at most `max_points` points.

    Each triangle has the colour of its point and faces along its normal.
    """
    from scipy.spatial import cKDTree

    chosen = subsample_cloud(cloud, max_points)
    points, normals = chosen.vertices, chosen.normals
    assert normals is not None
    neighbour_distances = cKDTree(points, balanced_tree=False).query(
        points[:: 1 + len(points) // _SPACING_SAMPLES], 2
    )[0][:, 1]
    radius = (
        _SPLAT_RADIUS * float(np.median(neighbour_distances[neighbour_distances > 0]))
        if neighbour_distances.any()
        else 0.0
    )
    # Two tangents of each normal, starting from the axis that is most perpendicular to it.
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    across = np.cross(normals, axis)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    along = np.cross(normals, across)
    around = (
        np.cos(_CORNER_ANGLES)[:, None] * across[:, None] + np.sin(_CORNER_ANGLES)[:, None] * along[:, None]
    )
    return Mesh(
        (points[:, None] + radius * around).reshape(-1, 3),
        np.arange(3 * len(points), dtype=np.int32).reshape(-1, 3),
        None if chosen.colors is None else np.repeat(chosen.colors, 3, axis=0),
        up=cloud.up,
    )
