"""Touching sheets: sheets that touch at a few vertices are not joined any further."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from seamed_meshes import count_duplicates, count_edges, weld_corners

from scanloom import Mesh, simplify

SIDES, RINGS = 8, 5


def _make_ball(width: float) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Make rings of vertices between two poles; the distance of the poles does not depend on the width."""
    along, around = np.pi * np.arange(1, RINGS + 1) / (RINGS + 1), 2 * np.pi * np.arange(SIDES) / SIDES
    x, radius = np.repeat(-np.cos(along), SIDES), np.repeat(width * np.sin(along), SIDES)
    angles = np.tile(around, RINGS)
    points = np.stack([x, radius * np.cos(angles), radius * np.sin(angles)], axis=1)
    last = 1 + RINGS * SIDES
    triangles = []
    for side in range(SIDES):
        a, b = 1 + side, 1 + (side + 1) % SIDES
        triangles.append((0, b, a))
        for ring in range(RINGS - 1):
            low, high = ring * SIDES, (ring + 1) * SIDES
            triangles += [(a + low, b + low, b + high), (a + low, b + high, a + high)]
        triangles.append((last, a + last - 1 - SIDES, b + last - 1 - SIDES))
    return np.concatenate([[[-1.0, 0, 0]], points, [[1.0, 0, 0]]]), np.array(triangles, np.int32)


def _make_nested_balls(touching: int) -> Mesh:
    """Make two closed surfaces, one inside the other, with common vertices that are not adjacent."""
    outer, triangles = _make_ball(1.0)
    inner, _ = _make_ball(0.6)
    common = [0, len(outer) - 1, 1 + SIDES * (RINGS // 2)][:touching]
    inner[common] = outer[common]
    numbers = np.arange(len(inner), dtype=np.int32) + len(outer)
    numbers[common] = common
    return Mesh(np.concatenate([outer, inner]), np.concatenate([triangles, numbers[triangles]]))


@pytest.mark.parametrize("touching", [2, 3])
@pytest.mark.parametrize(
    "how",
    [
        {"method": "quadric", "triangles": 8},
        {"method": "certified", "max_shape": 2.0},
        {"method": "jia01", "triangles": 8},
        {"method": "planar", "max_shape": 1.0, "planar": {"patch_angle": 80.0, "crease_angle": 80.0}},
    ],
)
@pytest.mark.parametrize("is_soup", [False, True])
def test_no_edge_or_triangle_is_duplicated(touching: int, how: dict[str, Any], is_soup: bool) -> None:
    mesh = _make_nested_balls(touching)
    before = weld_corners(mesh)
    if is_soup:
        corners = np.arange(3 * len(mesh.triangles), dtype=np.int32).reshape(-1, 3)
        mesh = Mesh(mesh.vertices[mesh.triangles.reshape(-1)], corners)
    assert count_edges(before) == (0, 0)
    assert count_duplicates(before) == 0

    light = simplify(mesh, **how).mesh

    assert len(light.triangles) < len(mesh.triangles)
    assert count_edges(weld_corners(light)) == (0, 0)
    assert count_duplicates(weld_corners(light)) == 0
