"""Pale object with little texture on black, in a ring of views.

The object consists of five shaded balls.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from posed_scene import pose
from scipy.ndimage import gaussian_filter, map_coordinates

from scanloom.stages.scans.model.scan import Camera, Frame, Scan

CAMERA = Camera(320, 240, 420.0, 420.0, 159.5, 119.5)
# Centres (x, y, z; y down) and radii of the balls, metres.
BALLS = (
    ((0.0, 0.08, 0.0), 0.13),
    ((0.01, -0.09, 0.02), 0.09),
    ((0.13, 0.0, 0.03), 0.05),
    ((-0.12, 0.02, -0.04), 0.055),
    ((0.0, 0.16, 0.09), 0.07),
)
LIGHT = np.array((-0.5, -0.7, -0.5)) / np.linalg.norm((0.5, 0.7, 0.5))


@cache
def _make_noise() -> np.ndarray:
    raw = gaussian_filter(np.random.default_rng(7).uniform(0, 1, (64, 64, 64)), 1.0, mode="wrap")
    return (raw - raw.mean()) / raw.std()


def render_view(
    world_from_camera: np.ndarray, texture: float = 2.0, backdrop: float = 4.0, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Render the (h, w, 3) uint8 image and the (h, w) depth along the axis, 0 on the backdrop.

    Parameters
    ----------
    texture : standard deviation of the object's grey levels.
    backdrop : grey level of the backdrop.
    """
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
    way, eye = rays @ world_from_camera[:3, :3].T, world_from_camera[:3, 3]
    depth = np.full(u.shape, np.inf)
    normal = np.zeros((*u.shape, 3))
    for centre, radius in BALLS:
        away = eye - np.array(centre)
        a, b, c = (way**2).sum(-1), way @ away, away @ away - radius**2
        inside = b**2 - a * c
        hit = np.where(inside > 0, (-b - np.sqrt(np.maximum(inside, 0))) / a, np.inf)
        nearer = hit < depth
        depth[nearer] = hit[nearer]
        normal[nearer] = (away + way * hit[..., None])[nearer] / radius
    found = np.isfinite(depth)
    depth = np.where(found, depth, 0)
    points = eye + way * depth[..., None]
    own = map_coordinates(_make_noise(), points.reshape(-1, 3).T * 200, order=1, mode="grid-wrap")
    lit = 150 + 60 * (normal @ LIGHT)
    grey = np.where(found, lit + texture * own.reshape(found.shape), backdrop)
    grey += np.random.default_rng(seed).normal(0, 0.7, grey.shape)
    image = grey.round().clip(0, 255).astype(np.uint8)
    return np.repeat(image[..., None], 3, axis=2), depth


def make_pale_scan(views: int = 36, step: float = 10.0, **look: float) -> tuple[Scan, list[np.ndarray]]:
    """Make a scan of views `step` degrees apart; return their true depth as well."""
    frames, depths = [], []
    for number in range(views):
        where = pose(step * number, 0, distance=0.9)
        image, depth = render_view(where, seed=number, **look)
        frames.append(Frame(f"{number:04d}", CAMERA, color=image, world_from_camera=where))
        depths.append(depth)
    return Scan("made", frames), depths
