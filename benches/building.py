"""Generator of a synthetic RGB-D scan of a building.

    python benches/building.py FOLDER [--rooms 50] [--frames 10000] [--workers 2]

Rooms with tables, cupboards and boxes are arranged in rows and connected by doors. An RGB-D camera walks
through them (320×240, noise of a structured-light sensor, exact poses). All random numbers have fixed seeds,
and each frame has its own seed: a scan with fewer frames is a prefix of a longer one. `scan.json` is written
next to the image folders.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from scanloom.stages._open3d import import_open3d
from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.scan import Camera, Frame, Pose

Floats = NDArray[np.float64]

SEED = 11
ROOM = np.array((4.0, 3.5, 2.6))
WALL = 0.12
DOOR = np.array((0.9, 2.0))
COLUMNS = 10
FRAMES_PER_ROOM = 200
CAMERA = Camera(320, 240, 262.5, 262.5, 159.5, 119.5)


def main() -> None:
    """Write the scan."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rooms", type=int, default=50)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    make_building(options.folder, options.rooms, options.frames, options.workers)


def make_building(folder: Path, rooms: int, frames: int, workers: int = 1) -> None:
    """Write the first `frames` frames of a building with `rooms` rooms."""
    for kind in ("color", "depth"):
        (folder / kind).mkdir(parents=True)
    work = partial(_write_frame, folder, rooms)
    if workers == 1:
        written = [work(number) for number in range(frames)]
    else:
        with ProcessPoolExecutor(workers) as pool:
            written = list(pool.map(work, range(frames), chunksize=32))
    write_scan_json(folder, written)


def _write_frame(folder: Path, rooms: int, number: int) -> Frame:
    pose = np.round(_compute_pose(number, rooms), 9)
    color, depth = _render_frame(rooms, pose, np.random.default_rng((SEED, 1, number)))
    paths = folder / "color" / f"{number:06d}.jpg", folder / "depth" / f"{number:06d}.png"
    cv2.imwrite(str(paths[0]), cv2.cvtColor(color, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 90])
    cv2.imwrite(str(paths[1]), depth, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return Frame(f"{number:06d}", CAMERA, color=paths[0], depth=paths[1], world_from_camera=pose)


def _compute_room_corner(room: int) -> Floats:
    """Compute the lowest corner of a room.

    Rows are traversed in alternating directions.
    """
    row, column = divmod(room, COLUMNS)
    column = column if row % 2 == 0 else COLUMNS - 1 - column
    return np.array((column, row, 0)) * (ROOM + WALL) * (1, 1, 0)


def _compute_pose(number: int, rooms: int) -> Pose:
    """Compute the world-from-camera pose of a frame.

    The camera moves on a circle around the room's centre and looks outward, up and down.
    """
    room, step = divmod(number, FRAMES_PER_ROOM)
    t = step / FRAMES_PER_ROOM
    yaw = 2 * np.pi * (2 * t + 0.13 * (room % rooms))
    pitch = np.deg2rad(-12 + 26 * np.sin(2 * np.pi * 5 * t))
    around = np.array((np.cos(yaw + 2.6), np.sin(yaw + 2.6), 0.0))
    eye = _compute_room_corner(room % rooms) + ROOM * (0.5, 0.5, 0.58) + 0.55 * around
    forward = np.array((np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)))
    right = np.cross(forward, (0, 0, 1))
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(forward, right), forward, eye], axis=1)
    return pose


def _render_frame(
    rooms: int, pose: Pose, draw: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
    """Render the colour image and the depth map of a pose.

    Colour is (h, w, 3) uint8, depth (h, w) uint16 in millimetres, 0 where invalid.
    """
    height, width = CAMERA.height, CAMERA.width
    x = (np.arange(width) - CAMERA.cx) / CAMERA.fx
    y = (np.arange(height) - CAMERA.cy) / CAMERA.fy
    rays = np.stack([*np.meshgrid(x, y), np.ones((height, width))], axis=-1).reshape(-1, 3) @ pose[:3, :3].T
    scene, colors = _build_painted_scene(rooms)
    given = np.concatenate([np.broadcast_to(pose[:3, 3], rays.shape), rays], axis=1).astype(np.float32)
    hits = scene.cast_rays(import_open3d().core.Tensor(given))
    z = hits["t_hit"].numpy().astype(np.float64)
    is_hit = np.isfinite(z)
    z[~is_hit] = 0
    normal = hits["primitive_normals"].numpy().astype(np.float64)
    length = np.linalg.norm(rays, axis=1)
    cosine = np.abs(np.einsum("kx,kx->k", normal, rays)) / length
    points = pose[:3, 3] + rays * z[:, None]
    part = np.where(is_hit, hits["primitive_ids"].numpy(), 0) // 12
    light = 0.55 + 0.45 * np.abs(normal @ (0.36, 0.48, 0.8))
    paint = colors[part] * (_compute_pattern(points, part) * light)[:, None]
    color = np.where(is_hit[:, None], paint, 0.3) + 0.012 * draw.standard_normal((len(z), 3))
    # Approximate noise model of a structured-light sensor: Nguyen, Izadi and Lovell 2012.
    measured = z + (0.0012 + 0.0019 * (z - 0.4) ** 2) * draw.standard_normal(len(z))
    is_invalid = ~is_hit | (cosine < 0.15) | (z > 5) | (draw.random(len(z)) < 0.01)
    depth = np.where(is_invalid, 0, np.rint(measured * 1000)).astype(np.uint16)
    return (
        np.rint(color.clip(0, 1) * 255).astype(np.uint8).reshape(height, width, 3),
        depth.reshape(height, width),
    )


def _compute_pattern(points: Floats, part: NDArray[np.int64]) -> Floats:
    """Compute the brightness (n,) of points (n, 3).

    The pattern is checks and stripes, whose width depends on the box.
    """
    pitch = (3 + part % 5)[:, None] * 2.0
    checks = np.sin(pitch * points).prod(axis=1)
    return np.asarray(0.8 + 0.2 * np.tanh(6 * checks) * (0.5 + 0.5 * np.cos(31 * points.sum(axis=1))))


def build_scene(rooms: int) -> Any:
    """Return the true surface of a building as Open3D raycasting scene."""
    return _build_painted_scene(rooms)[0]


@lru_cache(maxsize=1)
def _build_painted_scene(rooms: int) -> tuple[Any, Floats]:
    """Build the raycasting scene and its box colours (n, 3), 0..1."""
    boxes = np.array(_list_boxes(rooms))
    corner = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)])
    faces = np.array(
        [
            *((0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4)),
            *((2, 6, 7), (2, 7, 3), (0, 4, 6), (0, 6, 2), (1, 3, 7), (1, 7, 5)),
        ]
    )
    vertices = (boxes[:, None, 0] + corner * (boxes[:, 1] - boxes[:, 0])[:, None]).reshape(-1, 3)
    triangles = (faces + 8 * np.arange(len(boxes))[:, None, None]).reshape(-1, 3)
    core = import_open3d().core
    scene = import_open3d().t.geometry.RaycastingScene()
    scene.add_triangles(core.Tensor(vertices.astype(np.float32)), core.Tensor(triangles.astype(np.uint32)))
    return scene, np.random.default_rng((SEED, 2)).uniform(0.35, 0.95, (len(boxes), 3))


def _list_boxes(rooms: int) -> list[tuple[Floats, Floats]]:
    """List the lowest and highest corner of each box of the building."""
    found = []
    for room in range(rooms):
        low = _compute_room_corner(room)
        high = low + ROOM
        draw = np.random.default_rng((SEED, 0, room))
        outer = np.array((WALL, WALL, 0)) / 2
        found += [
            (low - outer - (0, 0, 0.1), (*(high + outer)[:2], 0.0)),
            ((*(low - outer)[:2], high[2]), high + outer + (0, 0, 0.1)),
        ]
        for axis in (0, 1):
            found += _make_wall(low, high, axis, upper=False, is_open=_has_neighbour(room, axis, -1, rooms))
            found += _make_wall(low, high, axis, upper=True, is_open=_has_neighbour(room, axis, 1, rooms))
        found += _make_furniture(low, draw)
    return [(np.asarray(a, float), np.asarray(b, float)) for a, b in found]


def _has_neighbour(room: int, axis: int, step: int, rooms: int) -> bool:
    """Check if there is a neighbouring room on one side."""
    there = _compute_room_corner(room)
    there[axis] += step * (ROOM + WALL)[axis]
    return any(np.allclose(_compute_room_corner(other), there) for other in range(rooms))


def _make_wall(
    low: Floats, high: Floats, axis: int, *, upper: bool, is_open: bool
) -> list[tuple[Floats, Floats]]:
    """Make the boxes of one wall, with a door if `is_open`.

    A wall has half its full thickness, because the neighbouring room contributes the other half.
    """
    along = 1 - axis
    a, b = np.array(low), np.array(high)
    a[along] -= WALL / 2
    b[along] += WALL / 2
    a[axis], b[axis] = (high[axis], high[axis] + WALL / 2) if upper else (low[axis] - WALL / 2, low[axis])
    if not is_open:
        return [(a, b)]
    middle = (low[along] + high[along]) / 2
    left, right, above = (a.copy(), b.copy()), (a.copy(), b.copy()), (a.copy(), b.copy())
    left[1][along] = above[0][along] = middle - DOOR[0] / 2
    right[0][along] = above[1][along] = middle + DOOR[0] / 2
    above[0][2] = DOOR[1]
    return [left, right, above]


def _make_furniture(low: Floats, draw: np.random.Generator) -> list[tuple[Floats, Floats]]:
    """Make the boxes of cupboards, boxes and tables in a room's corners."""
    found: list[tuple[Floats, Floats]] = []

    def add(base: Floats, low: Sequence[float], high: Sequence[float]) -> None:
        found.append((base + np.array(low), base + np.array(high)))

    for corner in range(4):
        size = draw.uniform((0.35, 0.3, 0.4), (0.9, 0.7, 1.9))
        gap = draw.uniform(0.02, 0.2, 2)
        x = gap[0] if corner & 1 == 0 else ROOM[0] - size[0] - gap[0]
        y = gap[1] if corner & 2 == 0 else ROOM[1] - size[1] - gap[1]
        base = low + np.array((x, y, 0))
        if draw.random() >= 0.4:
            add(base, (0, 0, 0), size)
            continue
        top = min(size[2], 0.8)
        add(base, (0, 0, top - 0.04), (size[0], size[1], top))
        for dx, dy in product((0.0, size[0] - 0.06), (0.0, size[1] - 0.06)):
            add(base, (dx, dy, 0), (dx + 0.06, dy + 0.06, top - 0.04))
        thing = draw.uniform(0.08, 0.25, 3)
        add(base, (0.1, 0.1, top), thing + np.array((0.1, 0.1, top)))
    return found


if __name__ == "__main__":
    main()
