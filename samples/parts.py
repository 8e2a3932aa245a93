"""Parts of made scenes: rectangles, cuboids and surfaces of revolution with procedural colours."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from paints import Floats, Ints

Paint = Callable[[Floats], Floats]


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


def make_rectangle(corner: Floats, u: Floats, v: Floats, spacing: float, paint: Paint) -> Part:
    """Make a rectangle spanned by `u` and `v`, normal u × v."""
    i, j = (max(2, round(float(np.linalg.norm(side)) / spacing) + 1) for side in (u, v))
    s, t = (
        a.ravel()[:, None] for a in np.meshgrid(np.linspace(0, 1, i), np.linspace(0, 1, j), indexing="ij")
    )
    normal = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    vertices = corner + s * u + t * v
    return Part(vertices, np.tile(normal, (len(vertices), 1)), make_grid(i, j), paint)


def make_cuboid(
    low: Floats,
    edges: Sequence[Floats],
    spacing: float,
    paint: Paint,
    omit: Collection[str] = ("bottom",),
) -> list[Part]:
    """Make the sides of a cuboid, which share no vertices.

    Parameters
    ----------
    low : corner (3,) from which all edges start.
    edges : vectors x, y, z of the edges, right-handed.
    omit : sides to leave out: front, right, back, left (in the direction of -y, x, y, -x), top and bottom.
    """
    x, y, z = edges
    sides = {
        "front": (low, x, z),
        "right": (low + x, y, z),
        "back": (low + x + y, -x, z),
        "left": (low + y, -y, z),
        "top": (low + z, x, y),
        "bottom": (low, y, x),
    }
    return [
        make_rectangle(corner, u, v, spacing, paint)
        for side, (corner, u, v) in sides.items()
        if side not in omit
    ]


def make_revolution(
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
    triangles = make_grid(i, j, wrap=True)
    flat = vertices.reshape(-1, 3)
    a, b, c = (flat[triangles[:, k]] for k in range(3))
    triangles = triangles[np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-12]
    used, triangles = np.unique(triangles, return_inverse=True)
    return Part(flat[used] + center, normals.reshape(-1, 3)[used], triangles.reshape(-1, 3), paint)


def make_grid(i: int, j: int, *, wrap: bool = False) -> Ints:
    """Make the triangles of a grid of i × j points.

    With `wrap`, the last and the first column are joined.
    """
    row, column = (a.ravel() for a in np.meshgrid(np.arange(i - 1), np.arange(j - 1), indexing="ij"))
    right = (column + 1) % (j - 1) if wrap else column + 1
    a, b, c, d = row * j + column, (row + 1) * j + column, (row + 1) * j + right, row * j + right
    if wrap:  # seen from outside, the orientation is reversed along the angle
        b, d = d, b
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
