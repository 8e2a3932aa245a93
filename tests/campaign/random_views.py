"""Random depth maps and their cameras: smooth, torn, noisy, with invalid depths."""

from __future__ import annotations

import random
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Pinhole = tuple[float, float, float, float, int, int]

# Values found in files and from sensors, and values that only a test would use.
_ODD = (np.nan, np.inf, -np.inf, -1.0, 0.0, 1e-40, 1e-6, 3e19, 3.4e38)


@dataclass(frozen=True, eq=False)
class Shot:
    """Depth map with its camera.

    Attributes
    ----------
    pinhole : focal lengths, principal point, width and height, pixels.
    pose : (4, 4), camera to volume.
    depth : (h, w) float32, metres.
    wanted : (h, w), pixels whose surface must be in the volume.
    color : (h, w, 3) uint8.
    """

    pinhole: Pinhole
    pose: NDArray[np.float64]
    depth: NDArray[np.float32]
    wanted: NDArray[np.bool_]
    color: NDArray[np.uint8]

    def compute_ray_lengths(self) -> NDArray[np.float64]:
        """Compute the distance of each pixel (h, w) at a depth of one."""
        fx, fy, cx, cy, width, height = self.pinhole
        v, u = np.mgrid[:height, :width]
        return np.asarray(np.sqrt(1 + ((u - cx) / fx) ** 2 + ((v - cy) / fy) ** 2))


def make_random_shots(draw: random.Random, size: float) -> list[Shot]:
    """Make some shots of one scene, `size` metres in front of their cameras."""
    rng = np.random.default_rng(draw.randrange(2**32))
    width, height = (draw.choice((1, 7, 9, 31, 64, 64, 64, 65, 96)) for _ in range(2))
    focal = draw.uniform(0.5, 2.0) * max(width, height)
    center = draw.uniform(-0.2, 1.2) * width, draw.uniform(-0.2, 1.2) * height
    pinhole = (focal, focal * draw.choice((1.0, 1.0, 0.3)), *center, width, height)
    kind = draw.choice(("plane", "ball", "steps", "noise"))
    turn = draw.choice((0.0, 0.0, 0.2, 3.0))
    # The origin is at integer voxels or not, or so far away that single precision matters.
    far = draw.choice((0.0, 0.0, 0.0, 10.0, 1e4)) * size
    count = draw.randrange(1, 5)
    return [_make_shot(pinhole, kind, size, turn, far, draw, rng) for _ in range(count)]


def _make_shot(
    pinhole: Pinhole,
    kind: str,
    size: float,
    turn: float,
    far: float,
    draw: random.Random,
    rng: np.random.Generator,
) -> Shot:
    width, height = pinhole[4:]
    v, u = np.mgrid[:height, :width]
    across, down = (u - width / 2) / max(width, height), (v - height / 2) / max(width, height)
    match kind:
        case "plane":
            depth = 1 + draw.uniform(-1.5, 1.5) * across + draw.uniform(-1.5, 1.5) * down
        case "ball":
            depth = 1.2 - np.sqrt(np.maximum(0.16 - across**2 - down**2, 0))
        case "steps":
            depth = np.where(np.sin(9 * across) * np.cos(7 * down) > 0, 0.6, 1.0)
        case _:
            depth = rng.uniform(0.3, 1.5, v.shape)
    depth = depth * (1 + rng.normal(0, draw.choice((0, 1e-3, 0.02)), v.shape))
    depth = (np.maximum(depth, 0.05) * size).astype(np.float32)
    odd = rng.random(v.shape) < draw.choice((0.0, 0.0, 0.01, 0.3))
    depth[odd] = rng.choice(np.array(_ODD, np.float32), int(odd.sum()))
    pose = np.eye(4)
    pose[:3, :3] = _rotate(rng.normal(size=3), turn * draw.random())
    pose[:3, 3] = far + rng.normal(0, 0.05 * size, 3)
    wanted = rng.random(v.shape) < draw.choice((1.0, 1.0, 0.7))
    return Shot(pinhole, pose, depth, wanted, rng.integers(0, 256, (height, width, 3)).astype(np.uint8))


def _rotate(axis: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Make a rotation matrix with Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)
