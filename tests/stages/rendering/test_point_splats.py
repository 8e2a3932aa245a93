"""Point clouds as triangles: one around each point, oriented by its normal."""

from __future__ import annotations

import numpy as np
import pytest
from clouds import make_cloud

from scanloom.stages.rendering.point_splats import make_point_splats
from scanloom.stages.surface.raycasting import compute_triangle_normals


@pytest.mark.parametrize("has_normals", [True, False])
def test_each_point_becomes_a_triangle_tangent_to_the_surface(has_normals: bool) -> None:
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    away = np.array((4e5, 5e6, 100.0))
    colors = rng.integers(0, 256, (2000, 3), np.uint8)
    ball = make_cloud(2 * directions + away, colors, directions if has_normals else None).with_(up=(0, 0, 1))
    drawn = make_point_splats(ball, 5000)
    corners = drawn.vertices[drawn.triangles]
    np.testing.assert_allclose(corners.mean(axis=1), ball.vertices, atol=1e-8)
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    np.testing.assert_allclose(sides, sides[0, 0], rtol=1e-5)
    # About as large as the point spacing, 0.16 m on average.
    assert 0.1 < sides[0, 0] < 0.6
    facing = np.abs(np.einsum("kx,kx->k", compute_triangle_normals(drawn), directions))
    assert facing.min() > (0.999 if has_normals else 0.9)
    np.testing.assert_array_equal(drawn.colors[::3], colors)
    assert drawn.up == (0, 0, 1)


def test_large_clouds_are_subsampled_deterministically() -> None:
    many = make_cloud(np.random.default_rng(2).normal(size=(3000, 3)))
    drawn, again = make_point_splats(many, 100), make_point_splats(many, 100)
    assert len(drawn.triangles) == 100
    np.testing.assert_array_equal(drawn.vertices, again.vertices)
    assert drawn.colors is None
