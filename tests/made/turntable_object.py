"""Box and ball on a turntable, seen by a static camera.

A papered wall is in the background; z is up.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from scanloom.stages.scans.model.scan import Camera, Frame

Floats = NDArray[np.float64]

CAMERA = Camera(320, 240, 290.0, 290.0, 159.5, 119.5)
PLATE = 0.17  # radius of the turntable's plate, whose top is at z = 0, metres
TABLE = -0.015  # height of the table below the plate, metres
WALL = 0.55  # distance of the wall behind the plate's centre, metres
# Centre and half sides of the box; centre and radius of the ball. Both are off the axis.
BOX = np.array((0.03, -0.02, 0.05)), np.array((0.06, 0.04, 0.05))
BALL = np.array((-0.05, 0.04, 0.045)), 0.045
_WALL, _TABLE, _PLATE, _THING = range(4)


@cache
def _make_noise() -> Floats:
    raw = gaussian_filter(np.random.default_rng(11).uniform(0, 1, (64, 64, 64)), 0.9, mode="wrap")
    return (raw - raw.mean()) / raw.std()


@cache
def _make_dots() -> Floats:
    """Draw dots (n, 2) all around the plate at varying radii."""
    draw = np.random.default_rng(3)
    angles = np.sort(draw.uniform(0, 2 * np.pi, 26))
    radii = draw.uniform(0.10, 0.16, 26)
    return np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])


def camera_pose() -> Floats:
    """Compute the world-from-camera pose of the camera, 0.6 m away and 30° above the plate."""
    tilt = np.radians(30)
    back = np.array((0.0, -np.cos(tilt), np.sin(tilt)))
    x = np.array((1.0, 0.0, 0.0))
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = x, np.cross(-back, x), -back
    pose[:3, 3] = 0.6 * back + (0, 0, 0.04)
    return pose


def make_object_pose(angle: float) -> Floats:
    """Compute world-from-object after the plate has turned by an angle in degrees."""
    a = np.radians(angle)
    pose = np.eye(4)
    pose[:2, :2] = ((np.cos(a), -np.sin(a)), (np.sin(a), np.cos(a)))
    return pose


def render_view(
    angle: float, *, texture: float = 45.0, dots: bool = False
) -> tuple[NDArray[np.uint8], Floats, Floats]:
    """Render the (h, w, 3) image, the (h, w) depth along the axis, and the mask of turning pixels.

    Parameters
    ----------
    texture : standard deviation of the grey levels of the box, the ball and the plate.
    dots : the plate is white paper with black dots.
    """
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
    pose = camera_pose()
    way, eye = rays @ pose[:3, :3].T, pose[:3, 3]
    own = make_object_pose(angle)[:3, :3]
    own_way, own_eye = way @ own, eye @ own
    with np.errstate(divide="ignore", invalid="ignore"):
        wall = (WALL - eye[1]) / way[..., 1]
        table, plate = (TABLE - eye[2]) / way[..., 2], -eye[2] / way[..., 2]
        plate[np.linalg.norm((eye + way * plate[..., None])[..., :2], axis=-1) > PLATE] = np.inf
        one, other = ((BOX[0] + side * BOX[1] - own_eye) / own_way for side in (-1, 1))
        near, far = np.minimum(one, other).max(-1), np.maximum(one, other).min(-1)
        box = np.where(near < far, near, np.inf)
        a, away = (way**2).sum(-1), own_eye - BALL[0]
        b = own_way @ away
        root = b**2 - a * (away @ away - BALL[1] ** 2)
        ball = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
    hits = np.stack([np.where(hit > 0, hit, np.inf) for hit in (wall, table, plate, np.minimum(box, ball))])
    what, depth = hits.argmin(axis=0), hits.min(axis=0)
    still = eye + way * depth[..., None]
    moving = own_eye + own_way * depth[..., None]

    def sample_pattern(points: Floats, scale: float) -> Floats:
        at = points.reshape(-1, 3).T * scale
        return map_coordinates(_make_noise(), at, order=1, mode="grid-wrap").reshape(depth.shape)

    grey = np.choose(
        what,
        [
            120 + 45 * sample_pattern(still, 90),
            np.full(depth.shape, 95.0),
            150 + texture * sample_pattern(moving, 260),
            130 + texture * sample_pattern(moving, 260),
        ],
    )
    if dots:
        off = np.linalg.norm(moving[..., None, :2] - _make_dots(), axis=-1).min(axis=-1)
        grey = np.where(what == _PLATE, np.where(off < 0.004, 40.0, 215.0), grey)
    image = np.repeat(grey.clip(0, 255).round().astype(np.uint8)[..., None], 3, axis=2)
    return image, depth, (what >= _PLATE).astype(np.float64)


def frames(angles: list[float], *, noise: float = 0.0015, **look: float) -> list[Frame]:
    """Make a frame without a pose for each angle of the plate in degrees; noise is relative to depth."""
    draw = np.random.default_rng(1)
    made = []
    for number, angle in enumerate(angles):
        image, depth, _ = render_view(angle, **look)
        measured = depth * (1 + noise * draw.standard_normal(depth.shape))
        made.append(
            Frame(
                f"{number:03}",
                CAMERA,
                color=image,
                depth=(np.round(measured * 1000) / 1000).astype(np.float32),
            )
        )
    return made
