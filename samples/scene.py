"""Scene of the sample scans: the corner of a room.

Colours are procedural, the light is fixed. Lengths are in metres, z is up. A floor and two walls meet at
(-0.45, 0.45, 0). A box, a vase, a globe and a ring are on the floor. Colours are functions of the 3-D point,
so they are sharper than vertex colours of a mesh of this size. Their features range from centimetres to
millimetres, so that stereo matching has texture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._open3d import import_open3d
from scanloom.stages.surface.mesh import Mesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Paint = Callable[[Floats], Floats]
# Adds tags to a paint. Arguments: paint, axes of its plane, centres of the tags, number of the first tag.
TagPainter = Callable[[Paint, tuple[int, int], Floats, int], Paint]

HALF_SIDE = 0.45  # half the side of the floor, metres
WALL_HEIGHT = 0.42  # height of the walls, metres
GLOBE, GLOBE_RADIUS = np.array((0.17, -0.12, 0.095)), 0.095
RING, RING_RADII = np.array((-0.14, -0.20, 0.034)), (0.085, 0.034)
VASE = np.array((0.14, 0.20, 0.0))
BOX, BOX_SIZE, BOX_TURN = np.array((-0.18, 0.13, 0.0)), np.array((0.20, 0.14, 0.17)), np.deg2rad(25)
# Profile of the vase (radius, height), from the foot over the lip to the bottom inside, metres.
VASE_OUTLINE = np.array(
    [
        *(
            (0.045, 0),
            (0.05, 0.008),
            (0.065, 0.05),
            (0.072, 0.09),
            (0.066, 0.13),
            (0.046, 0.175),
            (0.034, 0.205),
        ),
        *(
            (0.036, 0.23),
            (0.046, 0.25),
            (0.044, 0.254),
            (0.036, 0.246),
            (0.028, 0.225),
            (0.024, 0.2),
            (0, 0.195),
        ),
    ]
)
# Area light approximated by points, for soft shadows.
_LIGHTS = np.array((0.9, -0.5, 1.5)) + 0.16 * np.array(
    [(np.cos(a), np.sin(a), 0.4 * np.sin(2 * a)) for a in np.arange(8) * np.pi / 4]
)
_AMBIENT = 0.42
# Centres of AprilTags (36h11) in the axes of floor and walls, and their side with the white border, metres.
_FLOOR_TAGS = np.array(
    [(-0.35, -0.35), (-0.05, -0.36), (0.3, -0.36), (0.36, 0.1), (0.02, 0.0), (-0.36, -0.02)]
)
_LEFT_TAGS = np.array([(-0.3, 0.12), (-0.12, 0.28), (0.06, 0.12), (0.3, 0.3)])
_BACK_TAGS = np.array([(-0.34, 0.3), (0.33, 0.12), (0.36, 0.3), (-0.1, 0.07)])
_TAG, _TAG_CELLS = 0.14, 10


@dataclass(frozen=True)
class Part:
    """Object of the scene.

    Attributes
    ----------
    vertices, normals : (n, 3).
    triangles : (m, 3).
    paint : computes the albedo (n, 3) of points (n, 3), sRGB 0..1.
    """

    vertices: Floats
    normals: Floats
    triangles: Ints
    paint: Paint


class Scene:
    """Raycasting scene with lit colours.

    Parameters
    ----------
    spacing : of the vertices, metres.
    tags : add AprilTags to floor and walls.
    visitor : position (x, y) of a small person in a red coat on the floor.

    Attributes
    ----------
    mesh : the true surface, coloured by sampling the procedural colours at its vertices.
    """

    def __init__(
        self, spacing: float = 0.0091, *, tags: bool = False, visitor: tuple[float, float] | None = None
    ) -> None:
        self._parts = _make_parts(spacing, _add_tags if tags else _keep_paint)
        if visitor is not None:
            self._parts.append(_make_visitor(np.array((*visitor, 0.0)), spacing))
        counts = [len(part.vertices) for part in self._parts]
        offsets = np.concatenate([[0], np.cumsum(counts)[:-1]])
        vertices = np.concatenate([part.vertices for part in self._parts])
        self._normals = np.concatenate([part.normals for part in self._parts])
        triangles = [part.triangles + offset for part, offset in zip(self._parts, offsets, strict=True)]
        self._part_of = np.repeat(np.arange(len(triangles)), [len(t) for t in triangles])
        self._triangles = np.concatenate(triangles)
        core = import_open3d().core
        self._rays = import_open3d().t.geometry.RaycastingScene()
        self._rays.add_triangles(
            core.Tensor(vertices.astype(np.float32)), core.Tensor(self._triangles.astype(np.uint32))
        )
        colors = self.color(vertices, self._normals, np.repeat(np.arange(len(counts)), counts))
        self.mesh = Mesh(vertices, self._triangles.astype(np.int32), np.rint(colors * 255).astype(np.uint8))

    def cast(self, origin: Floats, directions: Floats) -> tuple[Floats, Floats, Ints]:
        """Cast rays with directions (k, 3) from an origin.

        Returns distance (k,), inf for a miss, unit normal (k, 3), and part index (k,) of the first hit.
        """
        rays = np.empty((len(directions), 6), np.float32)
        rays[:, :3], rays[:, 3:] = origin, directions
        hits = self._rays.cast_rays(import_open3d().core.Tensor(rays))
        distance = hits["t_hit"].numpy().astype(np.float64)
        triangle = np.where(np.isfinite(distance), hits["primitive_ids"].numpy(), 0).astype(np.int64)
        u, v = hits["primitive_uvs"].numpy().astype(np.float64).T
        corner_normals = self._normals[self._triangles[triangle]]
        normal = np.einsum("kc,kcx->kx", np.stack([1 - u - v, u, v], axis=1), corner_normals)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        return distance, normal / np.maximum(length, 1e-9), self._part_of[triangle]

    def color(self, points: Floats, normals: Floats, parts: Ints) -> Floats:
        """Compute the lit colours (n, 3) of surface points, sRGB 0..1.

        These are the colours that an ideal camera records.
        """
        albedo = np.empty((len(points), 3))
        for number, part in enumerate(self._parts):
            own = np.flatnonzero(parts == number)
            albedo[own] = part.paint(points[own])
        light = np.full(len(points), _AMBIENT)
        for lamp in _LIGHTS:
            towards = lamp - points
            towards /= np.linalg.norm(towards, axis=1, keepdims=True)
            rays = np.concatenate([points + 1e-3 * normals, towards], axis=1).astype(np.float32)
            blocked = self._rays.test_occlusions(import_open3d().core.Tensor(rays)).numpy()
            facing = np.einsum("kx,kx->k", normals, towards).clip(0, 1)
            light += np.where(blocked, 0, facing) * (1 - _AMBIENT) * 1.3 / len(_LIGHTS)
        return np.asarray((albedo**2.2 * light[:, None]).clip(0, 1) ** (1 / 2.2))


def _make_parts(spacing: float, add_tags: TagPainter) -> list[Part]:
    x, y, z = np.eye(3)
    corner = np.array((-HALF_SIDE, HALF_SIDE, 0.0))
    floor_paint = add_tags(_paint_floor, (0, 1), _FLOOR_TAGS, 0)
    left_paint = add_tags(_paint_left_wall, (1, 2), _LEFT_TAGS, len(_FLOOR_TAGS))
    back_paint = add_tags(_paint_back_wall, (0, 2), _BACK_TAGS, len(_FLOOR_TAGS) + len(_LEFT_TAGS))
    floor = _make_rectangle(
        corner - 2 * HALF_SIDE * y, 2 * HALF_SIDE * x, 2 * HALF_SIDE * y, spacing, floor_paint
    )
    left = _make_rectangle(
        corner - 2 * HALF_SIDE * y, 2 * HALF_SIDE * y, WALL_HEIGHT * z, spacing, left_paint
    )
    back = _make_rectangle(corner, 2 * HALF_SIDE * x, WALL_HEIGHT * z, spacing, back_paint)
    globe = _make_revolution(
        lambda t: (GLOBE_RADIUS * np.sin(np.pi * t), -GLOBE_RADIUS * np.cos(np.pi * t)),
        GLOBE,
        (np.pi * GLOBE_RADIUS, 2 * np.pi * GLOBE_RADIUS),
        spacing * 0.9,
        _paint_globe,
    )
    wide, thin = RING_RADII
    ring = _make_revolution(
        lambda t: (wide + thin * np.cos(2 * np.pi * t), thin * np.sin(2 * np.pi * t)),
        RING,
        (2 * np.pi * thin, 2 * np.pi * wide),
        spacing * 0.8,
        _paint_ring,
    )
    vase = _make_revolution(_compute_vase_outline, VASE, (0.42, 0.4), spacing * 0.8, _paint_vase)
    return [floor, left, back, globe, ring, vase, *_make_box(spacing)]


def _keep_paint(paint: Paint, _axes: tuple[int, int], _middles: Floats, _first: int) -> Paint:
    return paint


def _add_tags(paint: Paint, axes: tuple[int, int], middles: Floats, first: int) -> Paint:
    import cv2

    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    cells = [
        np.pad(cv2.aruco.generateImageMarker(family, first + n, _TAG_CELLS - 2), 1, constant_values=255)
        for n in range(len(middles))
    ]

    def paint_with_tags(p: Floats) -> Floats:
        color = paint(p)
        for middle, cell in zip(middles, cells, strict=True):
            column, row = np.floor(((p[:, axes] - middle) * (1, -1) / _TAG + 0.5) * _TAG_CELLS).astype(int).T
            inside = (column >= 0) & (row >= 0) & (column < _TAG_CELLS) & (row < _TAG_CELLS)
            color[inside] = 0.05 + 0.85 * cell[row[inside], column[inside], None] / 255
        return color

    return paint_with_tags


def _make_visitor(place: Floats, spacing: float) -> Part:
    def compute_outline(t: Floats) -> tuple[Floats, Floats]:
        # Profile of a coat with a head on top.
        height = 0.3 * t
        coat = 0.05 * np.sqrt(np.clip(1 - (np.minimum(height, 0.22) / 0.24) ** 4, 0, 1))
        head = np.sqrt(np.clip(0.035**2 - (height - 0.265) ** 2, 0, None))
        return np.where(t <= 0, 0, np.maximum(np.where(height < 0.23, coat, 0.0), head)), height

    return _make_revolution(
        compute_outline, place, (0.4, 0.32), spacing * 0.8, lambda p: _paint_visitor(p - place)
    )


def _make_rectangle(corner: Floats, u: Floats, v: Floats, spacing: float, paint: Paint) -> Part:
    """Make a rectangle spanned by `u` and `v`, normal u × v."""
    i, j = (max(2, round(float(np.linalg.norm(side)) / spacing) + 1) for side in (u, v))
    s, t = (
        a.ravel()[:, None] for a in np.meshgrid(np.linspace(0, 1, i), np.linspace(0, 1, j), indexing="ij")
    )
    normal = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    vertices = corner + s * u + t * v
    return Part(vertices, np.tile(normal, (len(vertices), 1)), _make_grid(i, j), paint)


def _make_box(spacing: float) -> list[Part]:
    c, s = np.cos(BOX_TURN), np.sin(BOX_TURN)
    turn = np.array(((c, -s, 0), (s, c, 0), (0, 0, 1)))
    width, depth, height = BOX_SIZE
    x, y, z = width * turn[:, 0], depth * turn[:, 1], height * turn[:, 2]
    low = BOX - (x + y) / 2
    sides = [(low, x, z), (low + x, y, z), (low + x + y, -x, z), (low + y, -y, z), (low + z, x, y)]
    return [_make_rectangle(corner, u, v, spacing, _paint_box) for corner, u, v in sides]


def _make_revolution(
    outline: Callable[[Floats], tuple[Floats, Floats]],
    center: Floats,
    lengths: tuple[float, float],
    spacing: float,
    paint: Paint,
) -> Part:
    """Make a surface of revolution about the z axis.

    Parameters
    ----------
    outline : maps 0..1 to radius and height; the outside is on its right.
    lengths : of the outline and of the circumference, metres.
    """
    i, j = (round(length / spacing) + 1 for length in lengths)
    t, angle = np.linspace(0, 1, i), np.linspace(0, 2 * np.pi, j)
    radius, height = outline(t)
    ahead, behind = outline(np.minimum(t + 1e-4, 1)), outline(np.maximum(t - 1e-4, 0))
    slope = np.stack([ahead[1] - behind[1], behind[0] - ahead[0]])
    slope /= np.linalg.norm(slope, axis=0)
    around = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices, normals = (
        np.concatenate([r[:, None, None] * around, np.broadcast_to(h[:, None, None], (i, j, 1))], axis=2)
        for r, h in ((radius, height), slope)
    )
    # The first and last column coincide. Triangles at the poles have no area and are removed.
    triangles = _make_grid(i, j, wrap=True)
    flat = vertices.reshape(-1, 3)
    a, b, c = (flat[triangles[:, k]] for k in range(3))
    triangles = triangles[np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-12]
    used, triangles = np.unique(triangles, return_inverse=True)
    return Part(flat[used] + center, normals.reshape(-1, 3)[used], triangles.reshape(-1, 3), paint)


def _compute_vase_outline(t: Floats) -> tuple[Floats, Floats]:
    from scipy.interpolate import PchipInterpolator

    steps = np.linalg.norm(np.diff(VASE_OUTLINE, axis=0), axis=1)
    along = np.concatenate([[0], np.cumsum(steps)]) / steps.sum()
    radius, height = PchipInterpolator(along, VASE_OUTLINE)(t).T
    return radius, height


def _make_grid(i: int, j: int, *, wrap: bool = False) -> Ints:
    """Make the triangles of a grid of i × j points.

    With `wrap`, the last and the first column are joined.
    """
    row, column = (a.ravel() for a in np.meshgrid(np.arange(i - 1), np.arange(j - 1), indexing="ij"))
    right = (column + 1) % (j - 1) if wrap else column + 1
    a, b, c, d = row * j + column, (row + 1) * j + column, (row + 1) * j + right, row * j + right
    if wrap:  # seen from outside, the orientation is reversed along the angle
        b, d = d, b
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def _compute_noise(points: Floats, wavelength: float, seed: int) -> Floats:
    """Compute smooth value noise (n,), -1..1, on a cubic lattice.

    Parameters
    ----------
    wavelength : lattice spacing, metres.
    """
    q = points / wavelength + 1000.0
    cell = np.floor(q).astype(np.int64)
    f = q - cell
    f = f * f * (3 - 2 * f)
    total = np.zeros(len(points))
    for dx, dy, dz in np.ndindex(2, 2, 2):
        weight = np.abs(1 - dx - f[:, 0]) * np.abs(1 - dy - f[:, 1]) * np.abs(1 - dz - f[:, 2])
        total += weight * _hash(cell + np.array((dx, dy, dz)), seed)
    return total


def _hash(cell: Ints, seed: int) -> Floats:
    """Hash lattice points to fixed pseudo-random numbers, -1..1."""
    h = (cell[:, 0] * 73856093) ^ (cell[:, 1] * 19349663) ^ (cell[:, 2] * 83492791) ^ (seed * 2654435761)
    h = (h ^ (h >> 13)) * 1274126177 & 0xFFFFFFFF
    return ((h ^ (h >> 16)) & 0xFFFF) / 32767.5 - 1


def _compute_grain(points: Floats, seed: int) -> Floats:
    """Compute noise (n, 1), about -1..1, of several wavelengths.

    The wavelengths range from 5 mm to 5 cm.
    """
    octaves = [(0.05, 0.3), (0.022, 0.35), (0.011, 0.45), (0.0055, 0.4)]
    grain = np.zeros(len(points))
    for k, (wavelength, weight) in enumerate(octaves):
        grain += weight * _compute_noise(points, wavelength, seed + k)
    return grain[:, None]


def _mix(mask: NDArray[np.bool_] | Floats, inside: Floats, outside: Floats) -> Floats:
    share = np.asarray(mask, np.float64).reshape(-1, 1)
    return np.asarray(share * inside + (1 - share) * outside)


def _to_rgb(*levels: int) -> Floats:
    return np.array(levels) / 255


def _paint_floor(p: Floats) -> Floats:
    tile = np.floor(p[:, :2] / 0.15)
    tone = _hash(np.concatenate([tile, tile[:, :1]], axis=1).astype(np.int64), 5)[:, None]
    color = _mix((tile.sum(axis=1) % 2) == 0, _to_rgb(196, 164, 122), _to_rgb(150, 92, 68)) + 0.05 * tone
    grout = (np.abs((p[:, :2] / 0.15) % 1 - 0.5) > 0.5 - 0.02).any(axis=1)
    return np.asarray((_mix(grout, _to_rgb(92, 86, 80), color) + 0.15 * _compute_grain(p, 11)).clip(0.02, 1))


def _paint_left_wall(p: Floats) -> Floats:
    stripe = np.sin(2 * np.pi * p[:, 1] / 0.09) > 0.2
    color = _mix(stripe, _to_rgb(176, 198, 178), _to_rgb(206, 214, 190))
    panel = p[:, 2] < 0.13
    color = _mix(panel, _to_rgb(112, 132, 118), color)
    return np.asarray((color + 0.13 * _compute_grain(p, 23)).clip(0.02, 1))


def _paint_back_wall(p: Floats) -> Floats:
    color = np.broadcast_to(_to_rgb(196, 192, 206), (len(p), 3))
    # A poster that shows rings around a sun over hills.
    x, z = p[:, 0] + 0.05, p[:, 2] - 0.25
    poster = (np.abs(x) < 0.2) & (np.abs(z) < 0.13)
    rings = np.sin(np.hypot(x - 0.06, z - 0.03) * 2 * np.pi / 0.04) > 0
    picture = _mix(rings, _to_rgb(240, 188, 72), _to_rgb(84, 126, 190))
    hills = z < -0.05 + 0.03 * np.sin(x * 30) + 0.012 * np.sin(x * 95)
    picture = _mix(hills, _to_rgb(58, 110, 70), picture)
    frame = poster & ((np.abs(x) > 0.188) | (np.abs(z) > 0.118))
    color = _mix(frame, _to_rgb(70, 48, 36), _mix(poster, picture, color))
    return np.asarray((color + 0.12 * _compute_grain(p, 31)).clip(0.02, 1))


def _paint_globe(p: Floats) -> Floats:
    q = p - GLOBE
    land = _compute_noise(p, 0.06, 41) + 0.5 * _compute_noise(p, 0.025, 42)
    color = _mix(land > 0.1, _to_rgb(96, 148, 70), _to_rgb(52, 96, 170))
    color = _mix(land > 0.55, _to_rgb(176, 148, 96), color)
    color = _mix(np.abs(q[:, 2]) > 0.083, _to_rgb(236, 240, 244), color)
    return np.asarray((color + 0.12 * _compute_grain(p, 43)).clip(0.02, 1))


def _paint_ring(p: Floats) -> Floats:
    q = p - RING
    angle = np.arctan2(q[:, 1], q[:, 0])
    turn = np.arctan2(q[:, 2], np.hypot(q[:, 0], q[:, 1]) - RING_RADII[0])
    color = _mix(np.sin(6 * angle + turn) > 0, _to_rgb(206, 60, 52), _to_rgb(240, 206, 92))
    return np.asarray((color + 0.13 * _compute_grain(p, 53)).clip(0.02, 1))


def _paint_vase(p: Floats) -> Floats:
    q = p - VASE
    angle = np.arctan2(q[:, 1], q[:, 0])
    zigzag = np.abs((angle * 8 / np.pi) % 2 - 1) * 0.016
    band = np.sin((q[:, 2] + zigzag) * 2 * np.pi / 0.05)
    color = _mix(band > 0.1, _to_rgb(44, 72, 140), _to_rgb(228, 224, 212))
    color = _mix(np.abs(band - 0.1) < 0.25, _to_rgb(196, 120, 60), color)
    return np.asarray((color + 0.11 * _compute_grain(p, 61)).clip(0.02, 1))


def _paint_box(p: Floats) -> Floats:
    q = (p - BOX) / 0.042
    dot = np.linalg.norm(q - np.round(q), axis=1) < 0.33
    kind = _hash(np.round(q).astype(np.int64), 71)
    spots = _mix(kind > 0, _to_rgb(232, 96, 120), _to_rgb(74, 170, 176))
    return np.asarray((_mix(dot, spots, _to_rgb(222, 206, 176)) + 0.13 * _compute_grain(p, 73)).clip(0.02, 1))


def _paint_visitor(q: Floats) -> Floats:
    buttons = np.sin(q[:, 2] * 2 * np.pi / 0.03) > 0.8
    coat = _mix(buttons, _to_rgb(250, 240, 60), _to_rgb(210, 20, 40))
    return np.asarray(
        (_mix(q[:, 2] > 0.23, _to_rgb(236, 188, 160), coat) + 0.05 * _compute_grain(q, 83)).clip(0.02, 1)
    )
