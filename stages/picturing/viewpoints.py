"""Viewpoints for rendering a mesh, comparable over all stages of a scan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.picturing.codes import RENDER_NOTHING_TO_DRAW
from scanloom.stages.printing import by_fields
from scanloom.stages.scans.model.scan import Camera, Frame, Pose
from scanloom.stages.surface.convert import MeshLike, as_mesh
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats, is_used
from scanloom.stages.surface.topology import require_measurable
from scanloom.stages.surface.upright import turn_along_y, up_of_held

# Quantile of the points on each side of each axis that framing ignores: stray components must not shrink the
# rest.
_STRAY = 0.001
# Maximum points used for framing; more are subsampled.
ENOUGH = 100_000
_ELEVATION = math.radians(30)
_FIRST_AZIMUTH = math.radians(-35)
# Horizontal field of view, for images with an aspect ratio of 4:3 or more.
_FIELD_OF_VIEW = math.radians(40)
# Ratio of the image's width or height that framed points fill.
FILLED = 0.92
# Up axis of glTF.
_Y = np.array((0.0, 1.0, 0.0))
# Sine of the angle below which two directions count as parallel.
_PARALLEL = 1e-9


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """Camera for rendering.

    Attributes
    ----------
    name : for file names and captions.
    camera : image size and pinhole intrinsics; distortion is not rendered.
    world_from_camera : (4, 4) float64, metres, OpenCV axes.
    cull : hide back faces, so that the interior of a room is visible from outside.
    focus : depth of the point of interest, metres; None if unknown.
    """

    name: str
    camera: Camera
    world_from_camera: Pose
    cull: bool = False
    focus: float | None = None

    __repr__ = by_fields


def viewpoints(
    mesh: MeshLike,
    count: int = 4,
    *,
    frames: Sequence[Frame] = (),
    width: int = 800,
    height: int | None = None,
    up: Sequence[float] | None = None,
) -> tuple[Viewpoint, ...]:
    """Choose viewpoints that show a mesh well.

    With the frames of a scan, the first viewpoint is an overview from behind and above the cameras, without
    back faces. The other `count` - 1 viewpoints are camera poses at regular intervals of the scan, which show
    the scene as the sensor saw it. The up direction is estimated from the frames' x and y axes.

    Without frames, `count` viewpoints are placed around the mesh at 30° elevation.

    Parameters
    ----------
    mesh : mesh to frame; use the same mesh for all stages to make images comparable.
    count : number of viewpoints, 1 or more.
    frames : frames of the scan; frames without a pose are ignored.
    width : image width, pixels.
    height : image height, pixels; 4:3 by default. Viewpoints of frames keep the aspect ratio of their camera.
    up : (3,) up direction without frames; by default the mesh's up direction, else y, as in glTF.

    Raises
    ------
    InputError
        If the mesh has no triangles.
    """
    mesh = as_mesh(mesh)
    require_measurable(mesh, "mesh")
    if len(mesh.triangles) == 0:
        raise InputError(RENDER_NOTHING_TO_DRAW, "the mesh has no triangles; there is nothing to show.")
    points = mesh.vertices[is_used(mesh)]
    points = points[:: 1 + len(points) // ENOUGH]
    upward = up_or_own(mesh, up)
    return viewpoints_around(points, count, frames=frames, width=width, height=height, upward=upward)


def viewpoints_around(
    points: Floats,
    count: int,
    *,
    frames: Sequence[Frame] = (),
    width: int = 800,
    height: int | None = None,
    upward: Floats = _Y,
) -> tuple[Viewpoint, ...]:
    """Choose viewpoints that show given points (k, 3), metres, as `viewpoints` does."""
    posed = [frame for frame in frames if frame.world_from_camera is not None]
    if not posed:
        headings = [
            around(upward, _FIRST_AZIMUTH + 2 * math.pi * i / count, _ELEVATION) for i in range(count)
        ]
        return tuple(
            _looking(f"view{i + 1}", points, heading, upward, width, height)
            for i, heading in enumerate(headings)
        )
    poses = np.array([frame.world_from_camera for frame in posed])
    upward = up_of_held(poses)
    overview = _looking("overview", points, _downward(poses, upward), upward, width, height, cull=True)
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
    """Return the viewing direction of the overview.

    It is the cameras' mean heading, tilted down by at least `_ELEVATION`.
    """
    forward = poses[:, :3, 2].mean(axis=0)
    heading = forward - (forward @ up) * up
    if np.linalg.norm(heading) < 0.2:  # cameras look in all directions or straight down: use the first camera
        heading = poses[0, :3, 1] - (poses[0, :3, 1] @ up) * up
        heading = heading if np.linalg.norm(heading) > 0.2 else poses[0, :3, 2]
    heading = heading / np.linalg.norm(heading)
    tilt = max(_ELEVATION, math.asin(np.clip(-forward @ up / np.linalg.norm(forward), -1, 0.9)))
    return np.asarray(math.cos(tilt) * heading - math.sin(tilt) * up)


def up_or_own(mesh: Mesh, up: Sequence[float] | None) -> Floats:
    """Return the unit up direction (3,): `up` if given, else the mesh's, else y."""
    known = up if up is not None else mesh.up if mesh.up is not None else _Y
    direction = np.asarray(known, np.float64)
    return np.asarray(direction / np.linalg.norm(direction))


def around(up: Floats, azimuth: float, elevation: float) -> Floats:
    """Return the viewing direction (3,) for an azimuth and elevation around the up axis, radians."""
    level = turn_along_y(up).T @ np.array((math.sin(azimuth), 0.0, -math.cos(azimuth)))
    return np.asarray(math.cos(elevation) * level - math.sin(elevation) * up)


def looking_at(
    eye: Sequence[float] | Floats,
    look: Sequence[float] | Floats,
    up: Sequence[float] | Floats,
    width: int,
    height: int,
    *,
    field: float = math.degrees(_FIELD_OF_VIEW),
    cull: bool = False,
    name: str = "free",
) -> Viewpoint:
    """Create a viewpoint that looks at a target point.

    Parameters
    ----------
    eye, look, up : (3,) camera centre and target, metres, and direction that is up in the image.
    width, height : image size, pixels.
    field : vertical field of view, degrees, above 0 and below 180.
    cull, name : see Viewpoint.

    Raises
    ------
    UsageError
        If the values do not define a view.
    """
    places = np.array([eye, look, up], np.float64)
    if places.shape != (3, 3) or not np.isfinite(places).all():
        raise UsageError(USAGE_ARGUMENT_INVALID, "eye, look and up must be three finite numbers each.")
    way = places[1] - places[0]
    if not way.any():
        raise UsageError(
            USAGE_ARGUMENT_INVALID,
            "eye and look are the same point",
            remedy="choose another point to look at.",
        )
    if not 0 < field < 180:
        raise UsageError(USAGE_ARGUMENT_INVALID, "the field of view must be above 0° and below 180°.")
    focal = 0.5 * height / math.tan(math.radians(0.5 * field))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = _rotation(way / np.linalg.norm(way), places[2]), places[0]
    camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    return Viewpoint(name, camera, pose, cull, float(np.linalg.norm(way)))


def framed(points: Floats) -> Floats:
    """Return the points that an image must contain: all but the outermost on each axis."""
    low, high = np.quantile(points, [_STRAY, 1 - _STRAY], axis=0)
    kept = points[((points >= low) & (points <= high)).all(axis=1)]
    return kept if len(kept) else points


def _rotation(forward: Floats, up: Floats) -> Floats:
    """Compute the axes (3, 3) of an OpenCV camera as columns.

    The right axis is arbitrary if the camera looks along the up direction.
    """
    right = np.cross(forward, up)
    if np.linalg.norm(right) < _PARALLEL * np.linalg.norm(up):
        right = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def _looking(
    name: str,
    points: Floats,
    forward: Floats,
    up: Floats,
    width: int,
    height: int | None = None,
    *,
    cull: bool = False,
) -> Viewpoint:
    """Create a viewpoint along `forward` that is filled by the points."""
    height = height or round(width * 3 / 4)
    rotation = _rotation(forward, up)
    seen = framed(points @ rotation)
    focal = 0.5 * width / math.tan(0.5 * _FIELD_OF_VIEW)
    slopes = FILLED * np.array((width, height)) / (2 * focal)
    # |x - eye_x| <= slope (z - eye_z) for all points: both sides of each axis bound the eye.
    lower = np.array([(seen[:, i] - slopes[i] * seen[:, 2]).max() for i in (0, 1)])
    upper = np.array([(seen[:, i] + slopes[i] * seen[:, 2]).min() for i in (0, 1)])
    eye = np.array([*((lower + upper) / 2), ((upper - lower) / (2 * slopes)).min()])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, rotation @ eye
    camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    return Viewpoint(name, camera, pose, cull)
