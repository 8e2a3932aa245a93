"""Tiny scans of a ball in front of a wall.

A run takes less than a second.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.scan import Camera, Frame

_CAMERA = Camera(width=64, height=48, fx=56.0, fy=56.0, cx=31.5, cy=23.5)
_WALL = 1.2


def write_small_scan(folder: Path, number: int = 0, frames: int = 4) -> Path:
    """Write a scan in the plain layout: depth in millimetres, colour, poses along a line.

    Parameters
    ----------
    number : seed of the ball's position, radius and colour.
    """
    folder.mkdir(parents=True)
    drawn = np.random.default_rng(number)
    center = np.array([*drawn.uniform(-0.12, 0.12, 2), drawn.uniform(0.9, 1.0)])
    radius, color = drawn.uniform(0.15, 0.25), drawn.integers(40, 220, 3)
    made = []
    for i, x in enumerate(np.linspace(-0.08, 0.08, frames)):
        depth, on_ball = _render_depth(x, center, radius)
        files = {kind: folder / f"{kind}-{i}.png" for kind in ("color", "depth")}
        image = np.where(on_ball[..., None], color, (180, 180, 160)).astype(np.uint8)
        assert cv2.imwrite(str(files["depth"]), np.rint(depth * 1000).astype(np.uint16))
        assert cv2.imwrite(str(files["color"]), image)
        pose = np.eye(4)
        pose[0, 3] = x
        made.append(Frame(f"{i}", _CAMERA, files["color"], depth=files["depth"], world_from_camera=pose))
    write_scan_json(folder, made)
    return folder


def write_small_scans(folder: Path, count: int) -> Path:
    """Write `count` scans into subfolders."""
    for number in range(count):
        write_small_scan(folder / f"scan-{number:04d}", number)
    return folder


def _render_depth(
    x: float, center: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Render the depth in metres of a camera at (x, 0, 0), and the mask of the ball."""
    u, v = np.meshgrid(np.arange(_CAMERA.width), np.arange(_CAMERA.height))
    rays = np.stack([(u - _CAMERA.cx) / _CAMERA.fx, (v - _CAMERA.cy) / _CAMERA.fy, np.ones(u.shape)], -1)
    origin = np.array([x, 0.0, 0.0]) - center
    a, b = (rays**2).sum(-1), rays @ origin
    root = b * b - a * (origin @ origin - radius**2)
    hit = root > 0
    return np.where(hit, (-b - np.sqrt(np.maximum(root, 0))) / a, _WALL), hit
