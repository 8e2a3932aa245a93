"""Textured ball in front of a textured board, in posed views.

The background is black.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Camera, Frame, Scan

CAMERA = Camera(240, 180, 300.0, 305.0, 121.0, 87.0)
RADIUS, BOARD_Z, BOARD = 0.22, 0.25, 0.4  # radius of the ball, and z and half side of the board, metres
DISTANCE = 1.2
# Rolls of the cameras about their axes, degrees: upright, upside down, on their sides and oblique.
ROLLS = (0, 90, 180, 37, 0, -90, 10)


@cache
def _make_noise() -> np.ndarray:
    raw = gaussian_filter(np.random.default_rng(5).uniform(0, 1, (64, 64, 64)), 0.8, mode="wrap")
    return np.clip((raw - raw.mean()) / raw.std() * 45 + 125, 20, 235)


def pose(angle: float, roll: float, distance: float = DISTANCE) -> np.ndarray:
    """Compute the world-from-camera pose of a camera that faces the origin; angles in degrees, 0 in front."""
    a, r = np.radians((angle, roll))
    z = np.array((np.sin(a), 0.0, np.cos(a)))
    x = np.array((np.cos(a), 0.0, -np.sin(a)))
    y = np.cross(z, x)
    turned = np.stack([np.cos(r) * x + np.sin(r) * y, -np.sin(r) * x + np.cos(r) * y, z], axis=1)
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = turned, -distance * z
    return result


def render_view(world_from_camera: np.ndarray, camera: Camera = CAMERA) -> tuple[np.ndarray, np.ndarray]:
    """Render the (h, w, 3) uint8 image and the (h, w) depth along the axis, 0 on the background."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    way, centre = rays @ world_from_camera[:3, :3].T, world_from_camera[:3, 3]
    a, b, c = (way**2).sum(-1), way @ centre, centre @ centre - RADIUS**2
    inside = b**2 - a * c
    ball = np.where(inside > 0, (-b - np.sqrt(np.maximum(inside, 0))) / a, np.inf)
    board = (BOARD_Z - centre[2]) / way[..., 2]
    hit = centre + way * board[..., None]
    board = np.where((np.abs(hit[..., :2]) < BOARD).all(-1), board, np.inf)
    depth = np.minimum(ball, board)
    found = np.isfinite(depth)
    depth = np.where(found, depth, 0)
    points = centre + way * depth[..., None]
    grey = map_coordinates(_make_noise(), points.reshape(-1, 3).T * 110, order=1, mode="grid-wrap")
    image = np.where(found, grey.reshape(found.shape), 0).round().astype(np.uint8)
    return np.repeat(image[..., None], 3, axis=2), depth


@cache
def make_posed_scan() -> tuple[Scan, tuple[np.ndarray, ...]]:
    """Make a scan of seven views, 7 degrees apart and with different rolls; return their true depth as well.

    The result is cached and shared; tests must not change it.
    """
    frames, depths = [], []
    for number, roll in enumerate(ROLLS):
        where = pose(7.0 * (number - 3), roll)
        image, depth = render_view(where)
        frames.append(Frame(f"{number:04d}", CAMERA, color=image, world_from_camera=where))
        depths.append(depth)
    return Scan("made", tuple(frames)), tuple(depths)


def write_posed_views(folder: Path, count: int = len(ROLLS)) -> Path:
    """Write the first views in Middlebury's multi-view layout, without depth."""
    scan, _ = make_posed_scan()
    folder.mkdir()
    lines = [str(count)]
    for frame in scan.frames[:count]:
        name = f"made{frame.name}.png"
        assert isinstance(frame.color, np.ndarray)
        assert cv2.imwrite(str(folder / name), frame.color)
        assert frame.world_from_camera is not None
        camera_from_world = invert_pose(frame.world_from_camera)
        numbers = [
            *frame.camera.matrix.ravel(),
            *camera_from_world[:3, :3].ravel(),
            *camera_from_world[:3, 3],
        ]
        lines.append(" ".join([name, *(repr(float(number)) for number in numbers)]))
    (folder / "made_par.txt").write_text("\n".join(lines) + "\n")
    return folder
