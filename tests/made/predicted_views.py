"""A wavy wall seen by several cameras, as a network would predict its depth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT, FOCAL = 56, 42, 50.0


@dataclass(frozen=True)
class PredictedViews:
    """Exact depth (n, h, w), photos (n, h, w, 3) uint8, and camera-to-world poses (n, 4, 4)."""

    depth: NDArray[np.float32]
    colors: NDArray[np.uint8]
    poses: NDArray[np.float64]

    @property
    def extrinsics(self) -> NDArray[np.float64]:
        """(n, 3, 4), world-to-camera."""
        return np.linalg.inv(self.poses)[:, :3]

    @property
    def intrinsics(self) -> NDArray[np.float64]:
        """(n, 3, 3) camera matrices."""
        one = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
        return np.repeat(one[None], len(self.poses), axis=0)

    def to_arrays(self, **changes: object) -> dict[str, object]:
        """Return the arrays of VGGT's predictions."""
        arrays = {
            "depth": self.depth[..., None],
            "depth_conf": np.full(self.depth.shape, 8.0, np.float32),
            "extrinsic": self.extrinsics.astype(np.float32),
            "intrinsic": self.intrinsics.astype(np.float32),
            "images": (self.colors / 255).astype(np.float32).transpose(0, 3, 1, 2),
            "pose_enc": np.zeros((len(self.poses), 9), np.float32),
        } | changes
        return {name: array for name, array in arrays.items() if array is not None}

    def write(self, folder: Path, **changes: object) -> Path:
        """Write predictions.npz and return it."""
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(folder / "predictions.npz", **self.to_arrays(**changes))
        return folder / "predictions.npz"


def make_views(count: int = 6) -> PredictedViews:
    """Make cameras on an arc in front of a wall with waves in depth and colour."""
    poses, depths, colors = [], [], []
    for angle in np.linspace(-0.35, 0.35, count):
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(np.array([0.05 * np.sin(9 * angle), -0.8 * angle, 0]))[0]
        pose[:3, 3] = (2.2 * np.sin(angle), 0.3 * angle, 2.2 * (1 - np.cos(angle)))
        depth = _trace(pose)
        poses.append(pose)
        depths.append(depth)
        colors.append(_paint(pose, depth))
    return PredictedViews(np.array(depths, np.float32), np.array(colors), np.array(poses))


def _compute_rays() -> NDArray[np.float64]:
    v, u = np.indices((HEIGHT, WIDTH), np.float64)
    return np.stack([(u - WIDTH / 2) / FOCAL, (v - HEIGHT / 2) / FOCAL, np.ones_like(u)], axis=-1)


def _trace(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Intersect rays with the wall z = 2 + waves by fixed-point iteration."""
    rays = _compute_rays() @ pose[:3, :3].T
    depth = np.full((HEIGHT, WIDTH), 2.0)
    for _ in range(60):
        points = pose[:3, 3] + rays * depth[..., None]
        wall = 2 + 0.15 * np.sin(2 * points[..., 0]) + 0.1 * np.sin(3 * points[..., 1] + 1)
        depth = (wall - pose[2, 3]) / rays[..., 2]
    return depth


def _paint(pose: NDArray[np.float64], depth: NDArray[np.float64]) -> NDArray[np.uint8]:
    points = pose[:3, 3] + _compute_rays() @ pose[:3, :3].T * depth[..., None]
    x, y = 7 * points[..., 0], 7 * points[..., 1]
    waves = [np.sin(x) * np.cos(y), np.sin(1.3 * x + 1), np.cos(0.7 * y - x)]
    return np.rint(127 + 100 * np.stack(waves, axis=-1)).astype(np.uint8)
