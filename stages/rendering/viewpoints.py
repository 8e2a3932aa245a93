"""Viewpoints for rendering a mesh, comparable over all stages of a scan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.printing import format_by_fields
from scanloom.stages.rendering.codes import RENDER_NOTHING_TO_DRAW
from scanloom.stages.scans.model.scan import Camera, Frame, Pose
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.raycasting import Floats, mask_used_vertices
from scanloom.stages.surface.topology import require_measurable
from scanloom.stages.surface.up_direction import estimate_up_from_cameras, rotate_to_y

# Quantile of the points on each side of each axis that framing ignores: stray components must not shrink the
# rest.
_STRAY_QUANTILE = 0.001
# Maximum points used for framing; more are subsampled.
MAX_FRAMED_POINTS = 100_000
_ELEVATION = math.radians(30)
_FIRST_AZIMUTH = math.radians(-35)
# Horizontal field of view, for images with an aspect ratio of 4:3 or more.
_FIELD_OF_VIEW_RAD = math.radians(40)
# Ratio of the image's width or height that framed points fill.
FILL_RATIO = 0.92
# Up axis of glTF.
_GLTF_UP = np.array((0.0, 1.0, 0.0))
# Sine of the angle below which two directions count as parallel.
_PARALLEL_SINE = 1e-9


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

    __repr__ = format_by_fields


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
    points = mesh.vertices[mask_used_vertices(mesh)]
    points = points[:: 1 + len(points) // MAX_FRAMED_POINTS]
    up_axis = resolve_up(mesh, up)
    return choose_viewpoints_around(points, count, frames=frames, width=width, height=height, up_axis=up_axis)


def choose_viewpoints_around(
    points: Floats,
    count: int,
    *,
    frames: Sequence[Frame] = (),
    width: int = 800,
    height: int | None = None,
    up_axis: Floats = _GLTF_UP,
) -> tuple[Viewpoint, ...]:
    """Choose viewpoints that show given points (k, 3), metres, as `viewpoints` does."""
    posed = [frame for frame in frames if frame.world_from_camera is not None]
    if not posed:
        headings = [
            compute_view_direction(up_axis, _FIRST_AZIMUTH + 2 * math.pi * i / count, _ELEVATION)
            for i in range(count)
        ]
        return tuple(
            _fit_viewpoint(f"view{i + 1}", points, heading, up_axis, width, height)
            for i, heading in enumerate(headings)
        )
    poses = np.array([frame.world_from_camera for frame in posed])
    up_axis = estimate_up_from_cameras(poses)
    overview = _fit_viewpoint(
        "overview", points, _compute_overview_direction(poses, up_axis), up_axis, width, height, cull=True
    )
    chosen = np.unique(np.linspace(0, len(posed) - 1, 2 * count - 1).round().astype(int)[1::2])
    return (overview, *(_from_frame(posed[i], width) for i in chosen))


def _from_frame(frame: Frame, width: int) -> Viewpoint:
    assert frame.world_from_camera is not None
    frame_camera, scale = frame.camera, width / frame.camera.width
    camera = Camera(
        width=width,
        height=max(1, round(frame_camera.height * scale)),
        fx=frame_camera.fx * scale,
        fy=frame_camera.fy * scale,
        cx=(frame_camera.cx + 0.5) * scale - 0.5,
        cy=(frame_camera.cy + 0.5) * scale - 0.5,
    )
    return Viewpoint(f"frame-{frame.name}", camera, frame.world_from_camera)


def _compute_overview_direction(poses: Floats, up: Floats) -> Floats:
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


def resolve_up(mesh: Mesh, up: Sequence[float] | None) -> Floats:
    """Return the unit up direction (3,): `up` if given, else the mesh's, else y."""
    known = up if up is not None else mesh.up if mesh.up is not None else _GLTF_UP
    direction = np.asarray(known, np.float64)
    return np.asarray(direction / np.linalg.norm(direction))


def compute_view_direction(up: Floats, azimuth: float, elevation: float) -> Floats:
    """Return the viewing direction (3,) for an azimuth and elevation around the up axis, radians."""
    level = rotate_to_y(up).T @ np.array((math.sin(azimuth), 0.0, -math.cos(azimuth)))
    return np.asarray(math.cos(elevation) * level - math.sin(elevation) * up)


def look_at(
    eye: Sequence[float] | Floats,
    target: Sequence[float] | Floats,
    up: Sequence[float] | Floats,
    width: int,
    height: int,
    *,
    field: float = math.degrees(_FIELD_OF_VIEW_RAD),
    cull: bool = False,
    name: str = "free",
) -> Viewpoint:
    """Create a viewpoint that looks at a target point.

    Parameters
    ----------
    eye, target, up : (3,) camera centre and target, metres, and direction that is up in the image.
    width, height : image size, pixels.
    field : vertical field of view, degrees, above 0 and below 180.
    cull, name : see Viewpoint.

    Raises
    ------
    UsageError
        If the values do not define a view.
    """
    vectors = np.array([eye, target, up], np.float64)
    if vectors.shape != (3, 3) or not np.isfinite(vectors).all():
        raise UsageError(USAGE_ARGUMENT_INVALID, "eye, look and up must be three finite numbers each.")
    direction = vectors[1] - vectors[0]
    if not direction.any():
        raise UsageError(
            USAGE_ARGUMENT_INVALID,
            "eye and look are the same point",
            remedy="choose another point to look at.",
        )
    if not 0 < field < 180:
        raise UsageError(USAGE_ARGUMENT_INVALID, "the field of view must be above 0° and below 180°.")
    focal = 0.5 * height / math.tan(math.radians(0.5 * field))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = (
        _compute_rotation(direction / np.linalg.norm(direction), vectors[2]),
        vectors[0],
    )
    camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    return Viewpoint(name, camera, pose, cull, float(np.linalg.norm(direction)))


def select_framed_points(points: Floats) -> Floats:
    """Return the points that an image must contain: all but the outermost on each axis."""
    low, high = np.quantile(points, [_STRAY_QUANTILE, 1 - _STRAY_QUANTILE], axis=0)
    kept = points[((points >= low) & (points <= high)).all(axis=1)]
    return kept if len(kept) else points


def _compute_rotation(forward: Floats, up: Floats) -> Floats:
    """Compute the axes (3, 3) of an OpenCV camera as columns.

    The right axis is arbitrary if the camera looks along the up direction.
    """
    right = np.cross(forward, up)
    if np.linalg.norm(right) < _PARALLEL_SINE * np.linalg.norm(up):
        right = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def _fit_viewpoint(
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
    rotation = _compute_rotation(forward, up)
    camera_points = select_framed_points(points @ rotation)
    focal = 0.5 * width / math.tan(0.5 * _FIELD_OF_VIEW_RAD)
    slopes = FILL_RATIO * np.array((width, height)) / (2 * focal)
    # |x - eye_x| <= slope (z - eye_z) for all points: both sides of each axis bound the eye.
    lower = np.array([(camera_points[:, i] - slopes[i] * camera_points[:, 2]).max() for i in (0, 1)])
    upper = np.array([(camera_points[:, i] + slopes[i] * camera_points[:, 2]).min() for i in (0, 1)])
    eye = np.array([*((lower + upper) / 2), ((upper - lower) / (2 * slopes)).min()])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, rotation @ eye
    camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    return Viewpoint(name, camera, pose, cull)
