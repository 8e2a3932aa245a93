"""Viewpoints around a mesh, as if it stood on a turntable."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from scanloom.stages.picturing.viewpoints import FILLED, Viewpoint, around, framed, looking_at, up_or_own
from scanloom.stages.surface.convert import MeshLike, as_mesh
from scanloom.stages.surface.raycasting import is_used
from scanloom.stages.surface.topology import require_area

# As many points tell how far away the eye has to be.
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
    """Return viewpoints once around a mesh, all as far away as it takes to see it from everywhere.

    Parameters
    ----------
    count : of viewpoints, 1 or more, in even steps; the last comes just before the first.
    width, height : of the pictures, pixels; 4:3 by default.
    up : (3,) what it turns around; by default what the mesh says is up, else y, as in glTF.
    elevation : of the eye, degrees above -90 and below 90.
    cull : leave out triangles seen from behind.

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
