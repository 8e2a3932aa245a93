"""Flaps are narrow strips that are only visible edge-on."""

from __future__ import annotations

import numpy as np

from scanloom.stages.refinement.flaps import mask_flaps


def _make_grid(width: int, height: int) -> np.ndarray:
    at = np.arange(width * height).reshape(height, width)
    a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]
    return np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3).astype(np.int32)


def test_a_narrow_strip_at_the_border_is_a_flap() -> None:
    triangles = _make_grid(40, 30)
    flaps = mask_flaps(triangles, np.tile(np.where(np.arange(40) < 4, 0.0, 0.9), 30))
    assert np.array_equal(flaps, (triangles % 40 < 4).all(axis=1))
    assert flaps.any()


def test_a_wide_region_is_not_a_flap() -> None:
    triangles = _make_grid(60, 40)
    assert not mask_flaps(triangles, np.tile(np.where(np.arange(60) < 40, 0.0, 0.9), 40)).any()


def test_surface_seen_from_the_front_is_not_a_flap() -> None:
    assert not mask_flaps(_make_grid(5, 5), np.ones(25)).any()
    assert mask_flaps(np.zeros((0, 3), np.int32), np.zeros(0)).shape == (0,)


def test_a_street_seen_only_at_grazing_angles_is_not_a_flap() -> None:
    triangles = _make_grid(60, 6)
    cosines = np.tile(1.6 / np.linspace(8, 30, 60), 6)
    assert mask_flaps(triangles, cosines).mean() < 0.05
