"""Viewpoints on a circle around a mesh, as on a turntable."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from scanloom.stages.picturing.viewpoints import FILLED, Viewpoint, around, framed, looking_at, up_or_own
from scanloom.stages.surface.convert import MeshLike, as_mesh
from scanloom.stages.surface.raycasting import is_used
from scanloom.stages.surface.topology import require_area

# Maximum vertices used to determine the distance of the eye.
_ENOUGH = 5_000
_FIELD = 40.0


def turntable(
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
    upward, rise = up_or_own(mesh, up), math.radians(elevation)
    points = framed(mesh.vertices[is_used(mesh)])
    points = points[:: 1 + len(points) // _ENOUGH]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    headings = [around(upward, 2 * math.pi * number / count, rise) for number in range(count)]
    views = [
        looking_at(middle - heading, middle, upward, width, height, field=_FIELD) for heading in headings
    ]
    slopes = FILLED * np.array((width, height)) / (2 * views[0].camera.fx)
    away = 0.0
    for view in views:
        seen = (points - middle) @ view.world_from_camera[:3, :3]
        away = max(away, float((np.abs(seen[:, :2]) / slopes - seen[:, 2:]).max()))
    return tuple(
        looking_at(
            middle - away * heading,
            middle,
            upward,
            width,
            height,
            field=_FIELD,
            cull=cull,
            name=f"turn{number + 1}",
        )
        for number, heading in enumerate(headings)
    )
