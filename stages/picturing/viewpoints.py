"""From where to look at a mesh, so that the same viewpoints serve every stage of a scan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stages.errors import InputError
from stages.printing import by_fields
from stages.scans.scan import Camera, Frame, Pose
from stages.surface.convert import MeshLike, as_mesh
from stages.surface.raycasting import Floats, is_used
from stages.surface.topology import require_measurable
from stages.surface.upright import up_of_cameras

# Share of the vertices on each side that framing ignores: a few stray islands must not shrink the rest.
_STRAY = 0.001
# Framing thins more vertices than this out.
_ENOUGH = 100_000
_ELEVATION = math.radians(30)
_FIELD_OF_VIEW = math.radians(40)


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """A camera that draws.

    Attributes
    ----------
    name : for file names and captions.
    camera : size of the picture and pinhole intrinsics; distortion is not drawn.
    world_from_camera : (4, 4) float64, metres, OpenCV axes.
    cull : leave out triangles seen from behind, so that one looks into a room from outside.
    """

    name: str
    camera: Camera
    world_from_camera: Pose
    cull: bool = False

    __repr__ = by_fields


def viewpoints(
    mesh: MeshLike, count: int = 4, *, frames: Sequence[Frame] = (), width: int = 800
) -> tuple[Viewpoint, ...]:
    """Choose viewpoints that show a mesh well.

    With the frames of a scan: an overview from behind and above the cameras, without the triangles that
    face away, and `count` - 1 camera poses spread evenly over the scan, which show the scene as the sensor
    saw it, from inside a room too. The frames' own x and y axes tell what is up.
    Without frames: `count` viewpoints around the mesh from 30° above, y up, as in glTF.

    Parameters
    ----------
    mesh : what the viewpoints are fitted to; use one mesh for all stages to make pictures comparable.
    count : number of viewpoints, 1 or more.
    frames : of the scan; those without a pose are ignored.
    width : of the pictures, pixels; they are 4:3, or have the shape of the frames' camera.

    Raises
    ------
    InputError
        If the mesh has no triangles.
    """
    mesh = as_mesh(mesh)
    require_measurable(mesh, "mesh")
    if len(mesh.triangles) == 0:
        raise InputError("the mesh has no triangles; there is nothing to look at.")
    points = mesh.vertices[is_used(mesh)]
    points = points[:: 1 + len(points) // _ENOUGH]
    posed = [frame for frame in frames if frame.world_from_camera is not None]
    if not posed:
        up = np.array((0.0, 1.0, 0.0))
        return tuple(
            _looking(
                f"view{i + 1}", points, _around(up, math.radians(-35) + 2 * math.pi * i / count), up, width
            )
            for i in range(count)
        )
    poses = np.array([frame.world_from_camera for frame in posed])
    up = up_of_cameras(poses)
    overview = _looking("overview", points, _downward(poses, up), up, width, cull=True)
    chosen = np.unique(np.linspace(0, len(posed) - 1, 2 * count - 1).round().astype(int)[1::2])
    return (overview, *(_as_seen(posed[i], width) for i in chosen))


def _as_seen(frame: Frame, width: int) -> Viewpoint:
    assert frame.world_from_camera is not None
    given, scale = frame.camera, width / frame.camera.width
    camera = Camera(
        width=width,
        height=max(1, round(given.height * scale)),
        fx=given.fx * scale,
        fy=given.fy * scale,
        cx=(given.cx + 0.5) * scale - 0.5,
        cy=(given.cy + 0.5) * scale - 0.5,
    )
    return Viewpoint(f"frame-{frame.name}", camera, frame.world_from_camera)


def _downward(poses: Floats, up: Floats) -> Floats:
    """Return the overview's direction: the cameras' mean heading, tilted down by at least the elevation."""
    forward = poses[:, :3, 2].mean(axis=0)
    heading = forward - (forward @ up) * up
    if np.linalg.norm(heading) < 0.2:  # they look all around, or straight down: any heading is as good
        heading = poses[0, :3, 1] - (poses[0, :3, 1] @ up) * up
        heading = heading if np.linalg.norm(heading) > 0.2 else poses[0, :3, 2]
    heading = heading / np.linalg.norm(heading)
    tilt = max(_ELEVATION, math.asin(np.clip(-forward @ up / np.linalg.norm(forward), -1, 0.9)))
    return np.asarray(math.cos(tilt) * heading - math.sin(tilt) * up)


def _around(up: Floats, azimuth: float) -> Floats:
    """Return a direction that looks down at the scene from an azimuth around y."""
    level = np.array((math.sin(azimuth), 0.0, -math.cos(azimuth)))
    return np.asarray(math.cos(_ELEVATION) * level - math.sin(_ELEVATION) * up)


def _looking(
    name: str, points: Floats, forward: Floats, up: Floats, width: int, *, cull: bool = False
) -> Viewpoint:
    """Look along `forward` from so far back that the points just fill the picture."""
    height = round(width * 3 / 4)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    seen = points @ rotation
    low, high = np.quantile(seen, [_STRAY, 1 - _STRAY], axis=0)
    kept = seen[((seen >= low) & (seen <= high)).all(axis=1)]
    seen = kept if len(kept) else seen
    focal = 0.5 * width / math.tan(0.5 * _FIELD_OF_VIEW)
    slopes = 0.92 * np.array((width, height)) / (2 * focal)
    # |x - eye_x| <= slope (z - eye_z) for all points: both sides of each axis bound the eye.
    lower = np.array([(seen[:, i] - slopes[i] * seen[:, 2]).max() for i in (0, 1)])
    upper = np.array([(seen[:, i] + slopes[i] * seen[:, 2]).min() for i in (0, 1)])
    eye = np.array([*((lower + upper) / 2), ((upper - lower) / (2 * slopes)).min()])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, rotation @ eye
    camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    return Viewpoint(name, camera, pose, cull)
