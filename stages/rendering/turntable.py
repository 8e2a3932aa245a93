"""Viewpoints on a circle around a mesh, as on a turntable."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from scanloom.stages.rendering.viewpoints import (
    FILL_RATIO,
    Viewpoint,
    compute_view_direction,
    look_at,
    resolve_up,
    select_framed_points,
)
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.raycasting import mask_used_vertices
from scanloom.stages.surface.topology import require_area

# Maximum vertices used to determine the distance of the eye.
_MAX_POINTS = 5_000
_FIELD_OF_VIEW_DEG = 40.0


def choose_turntable_viewpoints(
    mesh: MeshLike,
    count: int,
    *,
    width: int = 800,
    height: int | None = None,
    up: Sequence[float] | None = None,
    elevation: float = 25.0,
    cull: bool = False,
) -> tuple[Viewpoint, ...]:
    """Choose viewpoints in one circle around a mesh, all at the same distance.

    The distance is the smallest at which the mesh fits into every image.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh mesh, or (vertices, triangles), in metres.
    count : number of viewpoints, 1 or more, at equal angles.
    width, height : image size, pixels; 4:3 by default.
    up : (3,) rotation axis; by default the mesh's up direction, else y, as in glTF.
    elevation : of the eye, degrees above -90 and below 90.
    cull : hide back faces.

    Returns
    -------
    Viewpoints in the order of rotation.

    Raises
    ------
    MeshError
        If the mesh has no area.
    """
    mesh = as_mesh(mesh)
    require_area(mesh, "mesh")
    height = height or round(width * 3 / 4)
    up_axis, elevation_rad = resolve_up(mesh, up), math.radians(elevation)
    points = select_framed_points(mesh.vertices[mask_used_vertices(mesh)])
    points = points[:: 1 + len(points) // _MAX_POINTS]
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    headings = [
        compute_view_direction(up_axis, 2 * math.pi * number / count, elevation_rad)
        for number in range(count)
    ]
    views = [
        look_at(center - heading, center, up_axis, width, height, field=_FIELD_OF_VIEW_DEG)
        for heading in headings
    ]
    slopes = FILL_RATIO * np.array((width, height)) / (2 * views[0].camera.fx)
    distance = 0.0
    for view in views:
        camera_points = (points - center) @ view.world_from_camera[:3, :3]
        distance = max(distance, float((np.abs(camera_points[:, :2]) / slopes - camera_points[:, 2:]).max()))
    return tuple(
        look_at(
            center - distance * heading,
            center,
            up_axis,
            width,
            height,
            field=_FIELD_OF_VIEW_DEG,
            cull=cull,
            name=f"turn{number + 1}",
        )
        for number, heading in enumerate(headings)
    )
