"""Generator of a room with known truth, seen by a noisy depth camera.

    python samples/room.py OUT [--warp] [--frames N] [--seed N]

A camera with Kinect-like errors moves in front of a table, a chair, a bin and a carton in the corner of a
room of 4 × 3 × 2.5 m. OUT is a scan in the layout of `rgbd/`: `scan.json`, `color/`, `depth/`. In addition:

- truth.ply: the true surface, with the scene's colours at its vertices.
- thin_parts.ply: its thin parts, a mug with a wall of 4 mm and a chair back with slats of 2 cm.
- true_poses.tum: world from camera, without the noise of the poses in `scan.json`.

With --warp, depth is 1.5 % too long and bent by up to 1 % over the image. Lengths are in metres, z is up.
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from lit_scene import LitScene
from make_samples import write_image
from paints import Floats, compute_noise, hash_lattice, mix, to_rgb
from parts import Paint, Part, make_cuboid, make_rectangle, make_revolution
from sensors import DepthSensor, measure_depth, photograph

from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.scan import Camera, Frame, Pose
from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.surface.mesh import Mesh

SEED = 11
FRAMES = 60
CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
# Axial noise of Nguyen, Izadi and Lovell (2012). Disparity has steps of 1/8 pixel at a baseline of 75 mm.
KINECT = DepthSensor(0.0012, 0.0019, 0.4, disparity_step=1 / (8 * CAMERA.fx * 0.075))
# Root mean square length and angle of the errors of poses.
POSE_NOISE_M, POSE_NOISE_DEG = 0.004, 0.25
WARP_SCALE, WARP_BEND = 0.015, 0.01
SIZE = np.array((4.0, 3.0, 2.5))
TABLE, TABLE_SIZE, TABLE_TOP = np.array((0.55, 2.25)), np.array((1.4, 0.7)), (0.71, 0.74)
MUG, MUG_RADIUS, MUG_HEIGHT, MUG_WALL = np.array((1.05, 2.42, TABLE_TOP[1])), 0.041, 0.095, 0.004
BALL, BALL_RADIUS = np.array((1.30, 2.40, TABLE_TOP[1] + 0.06)), 0.06
BIN, BIN_RADIUS, BIN_HEIGHT, BIN_WALL = np.array((2.25, 2.62, 0.0)), 0.14, 0.32, 0.006
BUST = np.array((1.62, 2.52, TABLE_TOP[1]))
CHAIR, CHAIR_TURN = np.array((0.78, 1.82, 0.0)), np.deg2rad(17)
SLAT_WIDTH, SLAT_COUNT = 0.02, 5
_BUST_CELL = 0.004  # spacing of the samples of the bust's distance field
_OBJECT_SPACING, _WALL_SPACING = 0.01, 0.03
_LAMPS = np.array([(2.1, 1.2, 2.3), (1.4, 0.8, 2.3)])
_AMBIENT = 0.6
_GRAIN_CELLS, _GRAIN_CELL = 64, 0.004


class Room(LitScene):
    """Corner of a furnished room.

    Attributes
    ----------
    thin_parts : surface of the mug and of the slats of the chair.
    """

    def __init__(self) -> None:
        grain = Grain(SEED)
        thin = [*_make_mug(grain), *_make_slats(grain)]
        others = [
            *_make_walls(grain),
            *_make_table(grain),
            *_make_chair(grain),
            *_make_books(grain),
            *_make_cartons(grain),
            _make_ball(grain),
            _make_bin(grain),
            _make_bust(grain),
        ]
        super().__init__([*thin, *others], _LAMPS, _AMBIENT)
        vertex_count, triangle_count = (
            sum(len(getattr(part, name)) for part in thin) for name in ("vertices", "triangles")
        )
        self.thin_parts = Mesh(self.mesh.vertices[:vertex_count], self.mesh.triangles[:triangle_count])


class Grain:
    """Periodic noise of wavelengths from 8 mm to 7 cm, stored as a volume.

    The sum of two samples at unrelated scales and directions does not repeat within the room.
    """

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        spectrum = np.fft.rfftn(rng.standard_normal((_GRAIN_CELLS,) * 3))
        frequencies = np.fft.fftfreq(_GRAIN_CELLS)
        x, y, z = np.meshgrid(frequencies, frequencies, np.fft.rfftfreq(_GRAIN_CELLS), indexing="ij")
        radius = np.sqrt(x * x + y * y + z * z)
        # Equal contrast of all octaves between both limits.
        spectrum *= np.where((radius > 1 / 18) & (radius < 0.5), 1 / np.maximum(radius, 1e-3) ** 1.5, 0)
        volume = np.fft.irfftn(spectrum, (_GRAIN_CELLS,) * 3, axes=(0, 1, 2))
        self._volume = np.pad(volume / volume.std(), (0, 1), mode="wrap").astype(np.float32)
        self._turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]

    def sample(self, points: Floats) -> Floats:
        """Sample the noise (n, 1) at points (n, 3); the standard deviation is about 0.3."""
        return 0.21 * (self._interpolate(points) + self._interpolate(points @ self._turn / 0.73))

    def _interpolate(self, points: Floats) -> Floats:
        position = ((points / _GRAIN_CELL) % _GRAIN_CELLS).astype(np.float32)
        cell = np.minimum(position.astype(np.int32), _GRAIN_CELLS - 1)
        x, y, z = np.ascontiguousarray((position - cell).T, np.float32)
        side = _GRAIN_CELLS + 1
        first = (cell[:, 0] * side + cell[:, 1]) * side + cell[:, 2]
        flat, total = self._volume.ravel(), np.zeros(len(points), np.float32)
        for dx, dy, dz in np.ndindex(2, 2, 2):
            weight = (x if dx else 1 - x) * (y if dy else 1 - y) * (z if dz else 1 - z)
            total += weight * flat[first + (dx * side + dy) * side + dz]
        return total[:, None].astype(np.float64)


def make_poses(count: int) -> Iterator[Pose]:
    """Yield true world-from-camera poses along a closed path in front of the table."""
    for t in 2 * np.pi * np.arange(count) / count:
        eye = np.array(
            (1.3 + 0.95 * np.sin(t), 1.35 + 0.3 * np.cos(2 * t + 0.6), 1.27 + 0.27 * np.sin(3 * t + 0.4))
        )
        target = np.array(
            (1.25 + 0.65 * np.sin(t + 0.8), 2.5 - 0.15 * np.cos(t), 0.62 + 0.26 * np.cos(2 * t + 1.2))
        )
        forward = (target - eye) / np.linalg.norm(target - eye)
        right = np.cross(forward, (0, 0, 1))
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3] = np.stack([right, np.cross(forward, right), forward, eye], axis=1)
        yield pose


def disturb_pose(pose: Pose, rng: np.random.Generator) -> Pose:
    """Add the noise of a tracker to a pose."""
    turn = np.deg2rad(POSE_NOISE_DEG) / np.sqrt(3) * rng.standard_normal(3)
    noisy = pose.copy()
    noisy[:3, :3] = cv2.Rodrigues(turn)[0] @ pose[:3, :3]
    noisy[:3, 3] += POSE_NOISE_M / np.sqrt(3) * rng.standard_normal(3)
    return noisy


def compute_warp(camera: Camera) -> Floats:
    """Compute the factor (h, w) of an uncalibrated sensor on depth."""
    u, v = np.meshgrid(np.linspace(-1, 1, camera.width), np.linspace(-1, 1, camera.height))
    bend = u * u + v * v + 0.6 * u - 0.4 * u * v
    bend = 2 * (bend - bend.min()) / np.ptp(bend) - 1
    return np.asarray(1 + WARP_SCALE + WARP_BEND * bend)


def make_room(folder: Path, *, warp: bool = False, frames: int = FRAMES, seed: int = SEED) -> None:
    """Write the scan and its truth.

    Parameters
    ----------
    warp : bend depth and make it too long.
    frames : number of frames.
    seed : of the noise; the scene does not depend on the seed.
    """
    scene = Room()
    for kind in ("color", "depth"):
        shutil.rmtree(folder / kind, ignore_errors=True)
        (folder / kind).mkdir(parents=True)
    poses = list(make_poses(frames))
    take = partial(_take_frame, scene, folder, compute_warp(CAMERA) if warp else 1.0, seed)
    with ThreadPoolExecutor(2) as pool:
        taken = list(pool.map(take, range(frames), poses))
    write_scan_json(folder, taken)
    write_ply(folder / "truth.ply", scene.mesh)
    write_ply(folder / "thin_parts.ply", scene.thin_parts)
    (folder / "true_poses.tum").write_text("".join(map(_format_tum, range(frames), poses)))


def _take_frame(
    scene: Room, folder: Path, scale: Floats | float, seed: int, number: int, pose: Pose
) -> Frame:
    rng = np.random.default_rng((seed, number))
    name = f"{number:04d}"
    color, depth = folder / "color" / f"{name}.jpg", folder / "depth" / f"{name}.png"
    write_image(color, photograph(scene, CAMERA, pose, rng))
    write_image(depth, measure_depth(scene, CAMERA, pose, rng, sensor=KINECT, scale=scale), compression=4)
    noisy = np.round(disturb_pose(pose, rng), 9)
    return Frame(name, CAMERA, color=color, depth=depth, world_from_camera=noisy)


def _format_tum(number: int, pose: Pose) -> str:
    from scipy.spatial.transform import Rotation

    values = [*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()]
    return f"{number} " + " ".join(f"{value:.9f}" for value in values) + "\n"


# -- objects ---------------------------------------------------------------------------------------------


def _make_walls(grain: Grain) -> list[Part]:
    x, y, z = np.diag(SIZE)
    zero = np.zeros(3)
    planes = [
        (zero, x, y, _paint_floor),
        (z, y, x, _paint_ceiling),
        (y, x, z, _paint_back_wall),
        (zero, z, x, _paint_plain_wall),
        (zero, y, z, _paint_side_wall),
        (x, z, y, _paint_plain_wall),
    ]
    return [
        make_rectangle(corner, u, v, _WALL_SPACING, partial(paint, grain)) for corner, u, v, paint in planes
    ]


def _make_block(
    bottom: Sequence[float] | Floats,
    size: Sequence[float],
    turn: float,
    paint: Paint,
    omit: Sequence[str] = ("bottom",),
) -> list[Part]:
    """Make a cuboid turned about the vertical.

    Parameters
    ----------
    bottom : centre of the bottom side.
    size : lengths of the edges before turning.
    turn : angle in radians.
    """
    c, s = np.cos(turn), np.sin(turn)
    x, y, z = np.array(size)[:, None] * np.array(((c, s, 0), (-s, c, 0), (0, 0, 1)))
    return make_cuboid(np.asarray(bottom) - (x + y) / 2, (x, y, z), _OBJECT_SPACING, paint, omit)


def _make_table(grain: Grain) -> list[Part]:
    paint = partial(_paint_wood, grain, to_rgb(150, 104, 66), 0)
    low, high = TABLE_TOP
    parts = _make_block((*(TABLE + TABLE_SIZE / 2), low), (*TABLE_SIZE, high - low), 0.0, paint, ())
    for corner in ((0, 0), (1, 0), (0, 1), (1, 1)):
        foot = TABLE + 0.045 + np.array(corner) * (TABLE_SIZE - 0.09)
        parts += _make_block((*foot, 0.0), (0.05, 0.05, low), 0.0, paint, ("top", "bottom"))
    return parts


def _make_chair_block(
    paint: Paint, bottom: Sequence[float], size: Sequence[float], omit: Sequence[str]
) -> list[Part]:
    c, s = np.cos(CHAIR_TURN), np.sin(CHAIR_TURN)
    turned = np.array(((c, -s, 0), (s, c, 0), (0, 0, 1))) @ bottom
    return _make_block(CHAIR + turned, size, CHAIR_TURN, paint, omit)


def _make_chair(grain: Grain) -> list[Part]:
    paint = partial(_paint_wood, grain, to_rgb(186, 142, 84), 2)
    parts = _make_chair_block(paint, (0, 0, 0.44), (0.42, 0.42, 0.03), ())
    for x in (-0.19, 0.19):
        for y in (-0.19, 0.19):
            parts += _make_chair_block(paint, (x, y, 0), (0.035, 0.035, 0.44), ("top", "bottom"))
        parts += _make_chair_block(paint, (x, -0.19, 0.47), (0.03, 0.03, 0.45), ("bottom",))
    return parts + _make_chair_block(paint, (0, -0.19, 0.86), (0.35, 0.02, 0.06), ("left", "right"))


def _make_slats(grain: Grain) -> list[Part]:
    paint = partial(_paint_wood, grain, to_rgb(206, 162, 98), 2)
    middle = (SLAT_COUNT - 1) / 2
    return [
        side
        for number in range(SLAT_COUNT)
        for side in _make_chair_block(
            paint, (0.06 * (number - middle), -0.19, 0.47), (SLAT_WIDTH, 0.012, 0.39), ("top", "bottom")
        )
    ]


def _make_books(grain: Grain) -> list[Part]:
    parts, height = [], TABLE_TOP[1]
    for number, (width, depth, thickness, turn) in enumerate(
        [(0.27, 0.20, 0.034, 4), (0.25, 0.18, 0.022, -7), (0.22, 0.16, 0.028, 12), (0.19, 0.13, 0.018, -3)]
    ):
        paint = partial(_paint_book, grain, number)
        parts += _make_block((0.76, 2.64, height), (width, depth, thickness), np.deg2rad(turn), paint)
        height += thickness
    left = 0.98
    for number, (thickness, depth, tall) in enumerate(
        [(0.032, 0.17, 0.25), (0.02, 0.15, 0.21), (0.041, 0.18, 0.27), (0.024, 0.15, 0.23), (0.03, 0.16, 0.2)]
    ):
        paint = partial(_paint_book, grain, 4 + number)
        bottom = (left + thickness / 2, 2.93 - depth / 2, TABLE_TOP[1])
        parts += _make_block(bottom, (thickness, depth, tall), 0.0, paint)
        left += thickness + 0.004
    return parts


def _make_cartons(grain: Grain) -> list[Part]:
    paint = partial(_paint_carton, grain)
    small = _make_block((1.36, 2.74, TABLE_TOP[1]), (0.20, 0.14, 0.16), np.deg2rad(25), paint)
    return small + _make_block((2.85, 2.42, 0.0), (0.42, 0.30, 0.34), np.deg2rad(35), paint)


def _make_ball(grain: Grain) -> Part:
    return make_revolution(
        lambda t: (BALL_RADIUS * np.sin(np.pi * t), -BALL_RADIUS * np.cos(np.pi * t)),
        BALL,
        (np.pi * BALL_RADIUS, 2 * np.pi * BALL_RADIUS),
        0.003,
        partial(_paint_ball, grain),
    )


def _make_vessel(
    foot: Floats, radius: float, height: float, wall: float, spacing: float, paint: Paint
) -> Part:
    """Make an open cylinder with a rounded rim and a floor inside."""
    angles = np.linspace(0, np.pi, 9)
    rim = np.stack(
        [radius - wall / 2 * (1 - np.cos(angles)), height - wall / 2 * (1 - np.sin(angles))], axis=1
    )
    inside = radius - wall
    profile = np.concatenate(
        [[(radius - wall, 0), (radius, wall)], rim, [(inside, 2 * wall), (inside - wall, wall), (0, wall)]]
    )
    steps = np.linalg.norm(np.diff(profile, axis=0), axis=1)
    along = np.concatenate([[0], np.cumsum(steps)]) / steps.sum()

    def compute_outline(t: Floats) -> tuple[Floats, Floats]:
        return np.interp(t, along, profile[:, 0]), np.interp(t, along, profile[:, 1])

    return make_revolution(compute_outline, foot, (steps.sum(), 2 * np.pi * radius), spacing, paint)


def _make_mug(grain: Grain) -> list[Part]:
    paint = partial(_paint_mug, grain)
    cup = _make_vessel(MUG, MUG_RADIUS, MUG_HEIGHT, MUG_WALL, 0.0015, paint)
    # The handle is a torus cut in half; its ends are inside the wall.
    ring = make_revolution(
        lambda t: (0.028 - 0.0045 * np.cos(2 * np.pi * t), -0.0045 * np.sin(2 * np.pi * t)),
        np.zeros(3),
        (2 * np.pi * 0.0045, 2 * np.pi * 0.028),
        0.0015,
        paint,
    )
    turn = np.deg2rad(-65)
    out = np.array((np.cos(turn), np.sin(turn), 0))
    axes = np.stack([out, (0, 0, 1), np.cross(out, (0, 0, 1))])
    center = MUG + (MUG_RADIUS - MUG_WALL / 2) * out + (0, 0, MUG_HEIGHT / 2)
    half = ring.triangles[(ring.vertices[ring.triangles, 0] > -1e-9).all(axis=1)]
    used, half = np.unique(half, return_inverse=True)
    handle = Part(ring.vertices[used] @ axes + center, ring.normals[used] @ axes, half.reshape(-1, 3), paint)
    return [cup, handle]


def _make_bin(grain: Grain) -> Part:
    return _make_vessel(BIN, BIN_RADIUS, BIN_HEIGHT, BIN_WALL, 0.004, partial(_paint_bin, grain))


def _make_bust(grain: Grain) -> Part:
    """Make a head on shoulders: the level set of smoothly joined ellipsoids."""
    from skimage.measure import marching_cubes

    low, high = np.array((-0.19, -0.14, 0.0)), np.array((0.19, 0.14, 0.38))
    sides = [
        np.arange(a, b + _BUST_CELL / 2, _BUST_CELL, dtype=np.float64) for a, b in zip(low, high, strict=True)
    ]
    grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1)
    vertices, triangles, _, _ = marching_cubes(_compute_bust_field(grid), 0.0, spacing=(_BUST_CELL,) * 3)
    points = vertices.astype(np.float64) + low
    steps = 1e-4 * np.eye(3)
    ends = np.stack(
        [_compute_bust_field(points + step) - _compute_bust_field(points - step) for step in steps]
    )
    normals = (ends / np.linalg.norm(ends, axis=0)).T
    a, b, c = points[triangles].swapaxes(0, 1)
    outward = np.einsum("kx,kx->k", np.cross(b - a, c - a), normals[triangles].mean(axis=1)) > 0
    triangles = np.where(outward[:, None], triangles, triangles[:, ::-1]).astype(np.int64)
    return Part(points + BUST, normals, triangles, partial(_paint_bust, grain))


def _compute_bust_field(points: Floats) -> Floats:
    """Compute approximate signed distances (...) to the bust, metres, negative inside."""
    ellipsoids = [  # centre and semi-axes; the face looks to -y
        ((0, 0.0, 0.27), (0.072, 0.088, 0.098)),  # skull
        ((0, -0.035, 0.225), (0.048, 0.055, 0.06)),  # jaw
        ((0, -0.088, 0.252), (0.013, 0.024, 0.026)),  # nose
        ((-0.073, 0.005, 0.255), (0.012, 0.024, 0.034)),  # ears
        ((0.073, 0.005, 0.255), (0.012, 0.024, 0.034)),
        ((0, 0.008, 0.15), (0.045, 0.047, 0.10)),  # neck
        ((0, 0.01, 0.035), (0.16, 0.085, 0.075)),  # shoulders
    ]
    joined = np.zeros(points.shape[:-1])
    for center, axes in ellipsoids:
        scaled = (points - center) / axes
        length = np.linalg.norm(scaled, axis=-1)
        gradient = np.linalg.norm(scaled / axes, axis=-1)
        distance = length * (length - 1) / np.maximum(gradient, 1e-9)
        joined += np.exp(-distance.clip(-0.15, 0.15) / 0.009)
    return -0.009 * np.log(joined)


# -- colours ---------------------------------------------------------------------------------------------


def _finish(color: Floats, grain: Grain, p: Floats, contrast: float) -> Floats:
    return np.asarray((color + contrast * grain.sample(p)).clip(0.02, 1))


def _paint_floor(grain: Grain, p: Floats) -> Floats:
    row = np.floor(p[:, 1] / 0.12)
    plank = np.floor(p[:, 0] / 0.7 + 0.37 * row)
    tone = hash_lattice(np.stack([plank, row, row], axis=1).astype(np.int64), 3)[:, None]
    joint = (np.abs((p[:, 1] / 0.12) % 1 - 0.5) > 0.48) | (
        np.abs((p[:, 0] / 0.7 + 0.37 * row) % 1 - 0.5) > 0.496
    )
    color = mix(joint, to_rgb(74, 52, 38), to_rgb(172, 130, 88) + 0.09 * tone)
    return _finish(color, grain, p * (0.35, 1, 1), 0.22)


def _paint_ceiling(grain: Grain, p: Floats) -> Floats:
    return _finish(np.broadcast_to(to_rgb(226, 226, 222), (len(p), 3)), grain, p, 0.1)


def _paint_plain_wall(grain: Grain, p: Floats) -> Floats:
    return _finish(np.broadcast_to(to_rgb(208, 202, 186), (len(p), 3)), grain, p, 0.2)


def _paint_side_wall(grain: Grain, p: Floats) -> Floats:
    stripe = np.sin(p[:, 1] * 2 * np.pi / 0.2) > 0.2
    color = mix(stripe, to_rgb(176, 192, 204), to_rgb(204, 208, 200))
    return _finish(color, grain, p, 0.22)


def _paint_back_wall(grain: Grain, p: Floats) -> Floats:
    color = np.broadcast_to(to_rgb(204, 198, 184), (len(p), 3))
    # Two posters: rings, and coloured cells.
    x, z = p[:, 0] - 0.95, p[:, 2] - 1.35
    rings = np.sin(np.hypot(x - 0.1, z + 0.05) * 2 * np.pi / 0.07) > 0
    poster = (np.abs(x) < 0.35) & (np.abs(z) < 0.25)
    color = mix(poster, mix(rings, to_rgb(228, 176, 70), to_rgb(70, 112, 172)), color)
    x, z = p[:, 0] - 1.95, p[:, 2] - 1.25
    cells = hash_lattice(np.floor(p / (0.06, 10, 0.06)).astype(np.int64), 9)
    poster = (np.abs(x) < 0.27) & (np.abs(z) < 0.33)
    color = mix(poster, mix(cells > 0, to_rgb(196, 82, 74), to_rgb(230, 222, 200)), color)
    return _finish(color, grain, p, 0.2)


def _paint_wood(grain: Grain, tone: Floats, axis: int, p: Floats) -> Floats:
    """Paint wood with fibres along an axis."""
    stretch = np.ones(3)
    stretch[axis] = 0.25
    rings = np.sin(compute_noise(p * stretch, 0.05, 13) * 9)[:, None]
    return _finish(tone * (1 + 0.12 * rings), grain, p * stretch, 0.24)


def _paint_book(grain: Grain, number: int, p: Floats) -> Floats:
    tones = [(168, 52, 48), (52, 92, 140), (66, 120, 78), (214, 176, 70), (120, 74, 128)]
    tone = to_rgb(*tones[number % len(tones)])
    title = (np.sin(p[:, 2] * 2 * np.pi / 0.031 + number) > 0.75) | (np.sin(p[:, 0] * 90 + number) > 0.93)
    return _finish(mix(title, to_rgb(232, 224, 204), tone), grain, p, 0.22)


def _paint_carton(grain: Grain, p: Floats) -> Floats:
    cell = p / 0.055
    dot = np.linalg.norm(cell - np.round(cell), axis=1) < 0.32
    return _finish(mix(dot, to_rgb(96, 70, 48), to_rgb(190, 152, 106)), grain, p, 0.22)


def _paint_ball(grain: Grain, p: Floats) -> Floats:
    angle = np.arctan2(p[:, 1] - BALL[1], p[:, 0] - BALL[0])
    return _finish(mix(np.sin(5 * angle) > 0, to_rgb(216, 84, 54), to_rgb(238, 214, 168)), grain, p, 0.22)


def _paint_mug(grain: Grain, p: Floats) -> Floats:
    q = p - MUG
    zigzag = np.abs((np.arctan2(q[:, 1], q[:, 0]) * 6 / np.pi) % 2 - 1) * 0.014
    band = np.sin((q[:, 2] + zigzag) * 2 * np.pi / 0.04) > 0.1
    return _finish(mix(band, to_rgb(54, 84, 150), to_rgb(226, 222, 210)), grain, p, 0.2)


def _paint_bin(grain: Grain, p: Floats) -> Floats:
    band = np.abs(p[:, 2] - 0.2) < 0.03
    return _finish(mix(band, to_rgb(206, 190, 92), to_rgb(88, 116, 112)), grain, p, 0.24)


def _paint_bust(grain: Grain, p: Floats) -> Floats:
    return _finish(np.broadcast_to(to_rgb(196, 182, 168), (len(p), 3)), grain, p, 0.24)


def main() -> None:
    """Write the scan."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="OUT")
    parser.add_argument("--warp", action="store_true", help="bend depth and make it too long")
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("--seed", type=int, default=SEED, help="of the noise")
    options = parser.parse_args()
    make_room(options.folder, warp=options.warp, frames=options.frames, seed=options.seed)


if __name__ == "__main__":
    main()
