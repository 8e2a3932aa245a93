"""Searches in single precision also find needle triangles."""

from __future__ import annotations

import numpy as np
import pytest

from scanloom import Mesh, compare


def _make_fan(height: float, count: int = 24) -> Mesh:
    """Make needle triangles of 2 m length around an oblique axis; `height` is relative to the length."""
    angles = height * np.arange(count + 1)
    rim = np.stack([np.cos(angles), np.sin(angles), 0.1 * np.sin(9 * angles)], axis=1)
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    vertices = np.concatenate([[[0.0, 0, 0]], 2 * rim]) @ turn
    first = np.arange(1, count + 1)
    triangles = np.stack([np.zeros_like(first), first, first + 1], axis=1)
    return Mesh(vertices, triangles.astype(np.int32))


@pytest.mark.parametrize(
    "height",
    [2e-4, 4e-3, *(pytest.param(height, marks=pytest.mark.thorough) for height in (1e-3, 7e-3, 0.015))],
)
def test_a_mesh_of_needles_has_no_distance_to_itself(height: float) -> None:
    mesh = _make_fan(height)
    found = compare(mesh, mesh, samples=200_000)
    assert found.symmetric.maximum < 1.5e-4


def test_needles_keep_their_colours() -> None:
    mesh = _make_fan(4e-3)
    colors = np.random.default_rng(0).integers(0, 256, (len(mesh.vertices), 3)).astype(np.uint8)
    found = compare(mesh.with_(colors=colors), mesh.with_(colors=colors), samples=50_000)
    assert found.color is not None
    assert found.color.rmse < 0.1
