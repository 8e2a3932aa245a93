"""Scene of the sample scans: the corner of a room.

Colours are procedural, the light is fixed. Lengths are in metres, z is up. A floor and two walls meet at
(-0.45, 0.45, 0). A box, a vase, a globe and a ring are on the floor. Colours are functions of the 3-D point,
so they are sharper than vertex colours of a mesh of this size. Their features range from centimetres to
millimetres, so that stereo matching has texture.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from lit_scene import LitScene
from paints import Floats, compute_grain, compute_noise, hash_lattice, mix, to_rgb
from parts import Paint, Part, make_cuboid, make_rectangle, make_revolution

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


class Scene(LitScene):
    """Corner of a room with a box, a vase, a globe and a ring.

    Parameters
    ----------
    spacing : of the vertices, metres.
    tags : add AprilTags to floor and walls.
    visitor : position (x, y) of a small person in a red coat on the floor.
    """

    def __init__(
        self, spacing: float = 0.0091, *, tags: bool = False, visitor: tuple[float, float] | None = None
    ) -> None:
        parts = _make_parts(spacing, _add_tags if tags else _keep_paint)
        if visitor is not None:
            parts.append(_make_visitor(np.array((*visitor, 0.0)), spacing))
        super().__init__(parts, _LIGHTS, _AMBIENT)


def _make_parts(spacing: float, add_tags: TagPainter) -> list[Part]:
    x, y, z = np.eye(3)
    corner = np.array((-HALF_SIDE, HALF_SIDE, 0.0))
    floor_paint = add_tags(_paint_floor, (0, 1), _FLOOR_TAGS, 0)
    left_paint = add_tags(_paint_left_wall, (1, 2), _LEFT_TAGS, len(_FLOOR_TAGS))
    back_paint = add_tags(_paint_back_wall, (0, 2), _BACK_TAGS, len(_FLOOR_TAGS) + len(_LEFT_TAGS))
    floor = make_rectangle(
        corner - 2 * HALF_SIDE * y, 2 * HALF_SIDE * x, 2 * HALF_SIDE * y, spacing, floor_paint
    )
    left = make_rectangle(corner - 2 * HALF_SIDE * y, 2 * HALF_SIDE * y, WALL_HEIGHT * z, spacing, left_paint)
    back = make_rectangle(corner, 2 * HALF_SIDE * x, WALL_HEIGHT * z, spacing, back_paint)
    globe = make_revolution(
        lambda t: (GLOBE_RADIUS * np.sin(np.pi * t), -GLOBE_RADIUS * np.cos(np.pi * t)),
        GLOBE,
        (np.pi * GLOBE_RADIUS, 2 * np.pi * GLOBE_RADIUS),
        spacing * 0.9,
        _paint_globe,
    )
    wide, thin = RING_RADII
    ring = make_revolution(
        lambda t: (wide + thin * np.cos(2 * np.pi * t), thin * np.sin(2 * np.pi * t)),
        RING,
        (2 * np.pi * thin, 2 * np.pi * wide),
        spacing * 0.8,
        _paint_ring,
    )
    vase = make_revolution(_compute_vase_outline, VASE, (0.42, 0.4), spacing * 0.8, _paint_vase)
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

    return make_revolution(
        compute_outline, place, (0.4, 0.32), spacing * 0.8, lambda p: _paint_visitor(p - place)
    )


def _make_box(spacing: float) -> list[Part]:
    c, s = np.cos(BOX_TURN), np.sin(BOX_TURN)
    turn = np.array(((c, -s, 0), (s, c, 0), (0, 0, 1)))
    width, depth, height = BOX_SIZE
    edges = width * turn[:, 0], depth * turn[:, 1], height * turn[:, 2]
    return make_cuboid(BOX - (edges[0] + edges[1]) / 2, edges, spacing, _paint_box)


def _compute_vase_outline(t: Floats) -> tuple[Floats, Floats]:
    from scipy.interpolate import PchipInterpolator

    steps = np.linalg.norm(np.diff(VASE_OUTLINE, axis=0), axis=1)
    along = np.concatenate([[0], np.cumsum(steps)]) / steps.sum()
    radius, height = PchipInterpolator(along, VASE_OUTLINE)(t).T
    return radius, height


def _paint_floor(p: Floats) -> Floats:
    tile = np.floor(p[:, :2] / 0.15)
    tone = hash_lattice(np.concatenate([tile, tile[:, :1]], axis=1).astype(np.int64), 5)[:, None]
    color = mix((tile.sum(axis=1) % 2) == 0, to_rgb(196, 164, 122), to_rgb(150, 92, 68)) + 0.05 * tone
    grout = (np.abs((p[:, :2] / 0.15) % 1 - 0.5) > 0.5 - 0.02).any(axis=1)
    return np.asarray((mix(grout, to_rgb(92, 86, 80), color) + 0.15 * compute_grain(p, 11)).clip(0.02, 1))


def _paint_left_wall(p: Floats) -> Floats:
    stripe = np.sin(2 * np.pi * p[:, 1] / 0.09) > 0.2
    color = mix(stripe, to_rgb(176, 198, 178), to_rgb(206, 214, 190))
    panel = p[:, 2] < 0.13
    color = mix(panel, to_rgb(112, 132, 118), color)
    return np.asarray((color + 0.13 * compute_grain(p, 23)).clip(0.02, 1))


def _paint_back_wall(p: Floats) -> Floats:
    color = np.broadcast_to(to_rgb(196, 192, 206), (len(p), 3))
    # A poster that shows rings around a sun over hills.
    x, z = p[:, 0] + 0.05, p[:, 2] - 0.25
    poster = (np.abs(x) < 0.2) & (np.abs(z) < 0.13)
    rings = np.sin(np.hypot(x - 0.06, z - 0.03) * 2 * np.pi / 0.04) > 0
    picture = mix(rings, to_rgb(240, 188, 72), to_rgb(84, 126, 190))
    hills = z < -0.05 + 0.03 * np.sin(x * 30) + 0.012 * np.sin(x * 95)
    picture = mix(hills, to_rgb(58, 110, 70), picture)
    frame = poster & ((np.abs(x) > 0.188) | (np.abs(z) > 0.118))
    color = mix(frame, to_rgb(70, 48, 36), mix(poster, picture, color))
    return np.asarray((color + 0.12 * compute_grain(p, 31)).clip(0.02, 1))


def _paint_globe(p: Floats) -> Floats:
    q = p - GLOBE
    land = compute_noise(p, 0.06, 41) + 0.5 * compute_noise(p, 0.025, 42)
    color = mix(land > 0.1, to_rgb(96, 148, 70), to_rgb(52, 96, 170))
    color = mix(land > 0.55, to_rgb(176, 148, 96), color)
    color = mix(np.abs(q[:, 2]) > 0.083, to_rgb(236, 240, 244), color)
    return np.asarray((color + 0.12 * compute_grain(p, 43)).clip(0.02, 1))


def _paint_ring(p: Floats) -> Floats:
    q = p - RING
    angle = np.arctan2(q[:, 1], q[:, 0])
    turn = np.arctan2(q[:, 2], np.hypot(q[:, 0], q[:, 1]) - RING_RADII[0])
    color = mix(np.sin(6 * angle + turn) > 0, to_rgb(206, 60, 52), to_rgb(240, 206, 92))
    return np.asarray((color + 0.13 * compute_grain(p, 53)).clip(0.02, 1))


def _paint_vase(p: Floats) -> Floats:
    q = p - VASE
    angle = np.arctan2(q[:, 1], q[:, 0])
    zigzag = np.abs((angle * 8 / np.pi) % 2 - 1) * 0.016
    band = np.sin((q[:, 2] + zigzag) * 2 * np.pi / 0.05)
    color = mix(band > 0.1, to_rgb(44, 72, 140), to_rgb(228, 224, 212))
    color = mix(np.abs(band - 0.1) < 0.25, to_rgb(196, 120, 60), color)
    return np.asarray((color + 0.11 * compute_grain(p, 61)).clip(0.02, 1))


def _paint_box(p: Floats) -> Floats:
    q = (p - BOX) / 0.042
    dot = np.linalg.norm(q - np.round(q), axis=1) < 0.33
    kind = hash_lattice(np.round(q).astype(np.int64), 71)
    spots = mix(kind > 0, to_rgb(232, 96, 120), to_rgb(74, 170, 176))
    return np.asarray((mix(dot, spots, to_rgb(222, 206, 176)) + 0.13 * compute_grain(p, 73)).clip(0.02, 1))


def _paint_visitor(q: Floats) -> Floats:
    buttons = np.sin(q[:, 2] * 2 * np.pi / 0.03) > 0.8
    coat = mix(buttons, to_rgb(250, 240, 60), to_rgb(210, 20, 40))
    return np.asarray(
        (mix(q[:, 2] > 0.23, to_rgb(236, 188, 160), coat) + 0.05 * compute_grain(q, 83)).clip(0.02, 1)
    )
