"""Room with equal posters on opposite walls, seen by a rotating camera."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import Camera, Frame, Pose

CAMERA = Camera(320, 240, 270.0, 270.0, 159.5, 119.5)
# Half of the room's side and height in metres; resolution of wallpapers and posters in pixels per metre.
_HALF, _HALF_HEIGHT, _PIXELS_PER_METRE = 2.0, 1.5, 160
_POSTER = 1.2
# Degrees between frames.
STEP = 12.0


def make_turning_frames(first: float, last: float) -> list[Frame]:
    """Make frames of a camera that turns to the right between two angles in degrees, with true poses.

    The camera moves around a small circle. The walls at 0 and 180 degrees show the same poster on different
    wallpaper.
    """
    walls = _make_walls()
    rng = np.random.default_rng(5)
    return [_make_frame(number, turn, walls, rng) for number, turn in enumerate(np.arange(first, last, STEP))]


def _make_walls() -> list[NDArray[np.float64]]:
    rng = np.random.default_rng(4)
    size = (int(2 * _HALF_HEIGHT * _PIXELS_PER_METRE), int(2 * _HALF * _PIXELS_PER_METRE))
    walls = [_make_paper(rng, size) for _ in range(4)]
    side = int(_POSTER * _PIXELS_PER_METRE)
    poster = _make_paper(rng, (side, side))
    row, column = (size[0] - side) // 2, (size[1] - side) // 2
    for wall in walls[::2]:
        wall[row : row + side, column : column + side] = poster
    return walls


def _make_paper(rng: np.random.Generator, size: tuple[int, int]) -> NDArray[np.float64]:
    """Make grey values with spots of several sizes."""
    total = np.zeros(size)
    for blur in (2.0, 4.0, 9.0):
        spots = cv2.GaussianBlur(rng.standard_normal(size), (0, 0), blur)
        total += spots / spots.std()
    return np.asarray(128 + 40 * total)


def _make_frame(
    number: int, turn: float, walls: list[NDArray[np.float64]], rng: np.random.Generator
) -> Frame:
    pose = _make_pose(np.radians(turn))
    rows, columns = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack(
        [(columns - CAMERA.cx) / CAMERA.fx, (rows - CAMERA.cy) / CAMERA.fy, np.ones(rows.shape)], axis=2
    )
    ways = rays @ pose[:3, :3].T
    depth = np.full(rows.shape, np.inf)
    grey = np.full(rows.shape, 128.0)
    for wall in range(4):
        out, along = _get_wall_axes(wall)
        towards = ways @ out
        z = np.where(
            towards > 1e-6, (_HALF - pose[:3, 3] @ out) / np.where(towards > 1e-6, towards, 1), np.inf
        )
        nearer = z < depth
        at = pose[:3, 3] + np.where(np.isfinite(z), z, 0)[..., None] * ways
        across = ((at @ along + _HALF) * _PIXELS_PER_METRE).astype(np.float32)
        down = ((at[..., 1] + _HALF_HEIGHT) * _PIXELS_PER_METRE).astype(np.float32)
        seen = cv2.remap(walls[wall], across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        grey[nearer], depth[nearer] = seen[nearer], z[nearer]
    # Noise of a structured light camera.
    depth += (0.001 + 0.0016 * depth**2) * rng.standard_normal(depth.shape)
    grey += 2 * rng.standard_normal(grey.shape)
    color = np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
    return Frame(f"{number:03d}", CAMERA, color=color, depth=depth.astype(np.float32), world_from_camera=pose)


def _make_pose(turn: float) -> Pose:
    pose = np.eye(4)
    cosine, sine = np.cos(turn), np.sin(turn)
    pose[:3, :3] = [[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]]
    pose[:3, 3] = 0.25 * np.array([sine, 0, cosine])
    return pose


def _get_wall_axes(wall: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute the outward direction of a wall and the direction to the right along the wall."""
    turn = wall * np.pi / 2
    return np.array([np.sin(turn), 0, np.cos(turn)]), np.array([np.cos(turn), 0, -np.sin(turn)])
