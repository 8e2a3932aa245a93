"""Painted wall and simulated photos with known cameras and colours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from scanloom.stages.scans.model.scan import Camera, Frame
from scanloom.stages.surface.mesh import Mesh

CAMERA = Camera(160, 120, 150.0, 150.0, 79.5, 59.5)


def paint(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Compute colours (…, 3) of the wall z = 0 at x and y in 0..1: blobs of several sizes, and stripes."""
    red = 128 + 60 * np.sin(9 * x + 2) * np.cos(7 * y) + 30 * np.sin(41 * x)
    green = 120 + 50 * np.cos(12 * x - 5 * y) + 30 * np.sin(37 * y)
    blue = 130 + 70 * np.sin(5 * (x + y)) + 20 * np.cos(53 * x + 11)
    return np.stack([red, green, blue], axis=-1).clip(10, 245)


def wall(n: int = 12, colors: np.ndarray | None = None) -> Mesh:
    """Make the unit square in n × n cells, visible from z < 0."""
    x, y = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1))
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    cells = np.stack([a, a + n + 1, a + 1, a + 1, a + n + 1, a + n + 2], axis=1)
    return Mesh(vertices, cells.reshape(-1, 3).astype(np.int32), colors)


def pose(x: float, y: float, z: float = -0.8, turn: float = 0.0) -> np.ndarray:
    """Compute world-from-camera of a camera that faces along z, turned about y by degrees."""
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    found = np.eye(4)
    found[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    found[:3, 3] = x, y, z
    return found


def intersect_plane(
    world_from_camera: np.ndarray, z: float = 0.0, turn: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Intersect pixel rays with the plane at z; return x, y and depth.

    With `turn`, a rotation vector, the camera turns by this rotation during the readout of its rows.
    """
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
    late = (np.arange(CAMERA.height) + 0.5) / CAMERA.height - 0.5
    turns = Rotation.from_rotvec(late[:, None] * (np.zeros(3) if turn is None else turn)).as_matrix()
    way = np.einsum("rij,rcj->rci", world_from_camera[:3, :3] @ turns, rays)
    depth = (z - world_from_camera[2, 3]) / way[..., 2]
    at = world_from_camera[:3, 3] + way * depth[..., None]
    return at[..., 0], at[..., 1], depth


def photo(
    number: int, world_from_camera: np.ndarray, *, with_depth: bool = True, turn: np.ndarray | None = None
) -> Frame:
    """Render a frame of the wall on black; `turn` see `intersect_plane`."""
    x, y, depth = intersect_plane(world_from_camera, turn=turn)
    on_wall = (np.minimum(x, y) >= 0) & (np.maximum(x, y) <= 1) & (depth > 0)
    levels = np.where(on_wall[..., None], paint(x, y), 0)
    return Frame(
        f"{number:03d}",
        CAMERA,
        color=np.rint(levels).astype(np.uint8),
        depth=np.where(on_wall, depth, 0).astype(np.float32) if with_depth else None,
        world_from_camera=world_from_camera,
    )


def photos(count: int = 12, *, with_depth: bool = True) -> list[Frame]:
    """Render frames along the wall, some of them turned."""
    rng = np.random.default_rng(7)
    places = zip(rng.uniform(0.25, 0.75, (count, 2)), rng.uniform(-15, 15, count), strict=True)
    return [
        photo(number, pose(*place, turn=turn), with_depth=with_depth)
        for number, (place, turn) in enumerate(places)
    ]


def make_grazing_photo(number: int, z: float = -0.08, turn: float = -80.0) -> Frame:
    """Render a frame at a grazing angle of 82° or more, on grey.

    The camera is next to the wall and close to its plane.
    """
    frame = photo(number, pose(1.6, 0.5, z=z, turn=turn))
    assert isinstance(frame.color, np.ndarray)
    shown = frame.color.max(axis=2, keepdims=True) > 0
    return replace(frame, color=np.where(shown, frame.color, np.uint8(60)))


def change_exposure(frame: Frame, gain: float, bias: float) -> Frame:
    """Apply another exposure to a frame."""
    assert isinstance(frame.color, np.ndarray)
    levels = np.rint(frame.color * gain + bias).clip(0, 255).astype(np.uint8)
    return replace(
        frame, color=np.where(frame.color.max(axis=2, keepdims=True) > 0, levels, 0).astype(np.uint8)
    )
