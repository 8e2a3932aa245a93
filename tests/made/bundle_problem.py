"""Synthetic bundle adjustment problem with known cameras and points.

Views on an arc show a wavy wall.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scanloom.stages.adjusting.cameras import Cameras, compute_motions
from scanloom.stages.adjusting.lens import project_with_distortion
from scanloom.stages.adjusting.tracks import Tracks
from scanloom.stages.adjusting.unprojection import transform_to_color_camera
from scanloom.stages.adjusting.view import AdjustmentView

SIZE = (320, 240)
DEPTH_LENS = np.array([290.0, 290.0, 159.5, 119.5])


@dataclass(frozen=True)
class BundleProblem:
    """Views with depth maps, true cameras and points, and the observations of the points."""

    views: list[AdjustmentView]
    cameras: Cameras
    points: np.ndarray
    tracks: Tracks


def make_bundle_problem(
    seed: int = 3, views: int = 6, points: int = 300, degrees: float = 0.0
) -> BundleProblem:
    """Make a bundle adjustment problem.

    Depth is exact. Pixels have errors of 0.2. Each camera turns by about `degrees` during the readout of its
    rows.
    """
    rng = np.random.default_rng(seed)
    steps = np.zeros((views, 6))
    steps[:, 0] = np.linspace(-0.35, 0.35, views)
    steps[:, 1] = 0.05 * rng.normal(size=views)
    steps[:, 4] = -np.linspace(-0.25, 0.25, views)
    steps[:, 3:] += 0.03 * rng.normal(size=(views, 3))
    lens = np.array([*DEPTH_LENS, -0.04, 0, 0, 0, 0]) * np.array([0.97, 0.97, *[1] * 7])
    apart = compute_motions(np.array([[0.02, -0.004, 0.003, 0.005, -0.008, 0.002]]))
    turns = np.radians(degrees) * np.random.default_rng(seed).normal(size=(views, 3))
    turns -= turns.mean(axis=0)
    cameras = Cameras(compute_motions(steps), np.tile(lens, (views, 1)), np.tile(apart, (views, 1, 1)), turns)
    flat = rng.uniform((-0.8, -0.5), (0.8, 0.5), (points, 2))
    places = np.column_stack([flat, _compute_wall_depth(*flat.T)])
    number = np.repeat(np.arange(points), views)
    view = np.tile(np.arange(views), points)
    late = np.zeros(len(view))
    for _ in range(6):
        pixels = project_with_distortion(
            transform_to_color_camera(cameras, view, places[number], late), cameras.lenses[view]
        )
        late = np.clip((pixels[:, 1] + 0.5) / SIZE[1] - 0.5, -0.5, 0.5)
    inside = ((pixels > 2) & (pixels < np.array(SIZE) - 3)).all(axis=1)
    often = np.bincount(number[inside], minlength=points) >= 3
    kept = inside & often[number]
    _, point = np.unique(number[kept], return_inverse=True)
    noisy = pixels[kept] + 0.2 * rng.normal(size=(np.count_nonzero(kept), 2))
    tracks = Tracks(view[kept], point, noisy, late[kept], np.zeros(0, np.intp))
    seen = [
        _make_view(n, pose, turn) for n, (pose, turn) in enumerate(zip(cameras.poses, turns, strict=True))
    ]
    return BundleProblem(seen, cameras, places[often], tracks)


def _compute_wall_depth(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 1.5 + 0.15 * np.sin(3 * x) * np.cos(4 * y) + 0.1 * x


def _make_view(number: int, pose: np.ndarray, turn: np.ndarray) -> AdjustmentView:
    columns, rows = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    fx, fy, cx, cy = DEPTH_LENS
    way = np.stack([(columns - cx) / fx, (rows - cy) / fy, np.ones(columns.shape)], axis=-1)
    late = (np.arange(SIZE[1]) + 0.5) / SIZE[1] - 0.5
    steps = np.concatenate([np.zeros((SIZE[1], 3)), late[:, None] * turn], axis=1)
    ahead = np.einsum("rij,rcj->rci", pose[:3, :3] @ compute_motions(steps)[:, :3, :3], way)
    depth = np.full(columns.shape, 1.5)
    for _ in range(30):
        hit = ahead * depth[..., None] + pose[:3, 3]
        depth += (_compute_wall_depth(hit[..., 0], hit[..., 1]) - hit[..., 2]) / ahead[..., 2]
    return AdjustmentView(
        name=f"{number:04d}",
        pixels=np.zeros((0, 2), np.float32),
        descriptors=np.zeros((0, 128), np.uint8),
        size=SIZE,
        full_size=SIZE,
        depth=depth.astype(np.float32),
        lens=np.array([*DEPTH_LENS, 0, 0, 0, 0, 0]),
        depth_lens=DEPTH_LENS,
        has_adjustable_lens=True,
    )
