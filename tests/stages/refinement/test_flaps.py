"""Flaps are narrow strips that are only visible edge-on; through skirts, frames see free space."""

from __future__ import annotations

import numpy as np

from scanloom.stages.refinement.flaps import mask_flaps as mask_false_surface


def _make_grid(width: int, height: int) -> np.ndarray:
    at = np.arange(width * height).reshape(height, width)
    a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]
    return np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3).astype(np.int32)


def mask_flaps(triangles: np.ndarray, cosines: np.ndarray) -> np.ndarray:
    return mask_false_surface(triangles, cosines, np.zeros(len(cosines), bool))


def mask_skirts(triangles: np.ndarray, is_contradicted: np.ndarray) -> np.ndarray:
    return mask_false_surface(triangles, np.ones(len(is_contradicted)), is_contradicted)


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


def test_a_contradicted_strip_is_a_skirt_only_at_the_border() -> None:
    triangles = _make_grid(40, 30)
    column = np.tile(np.arange(40), 30)
    skirt = mask_skirts(triangles, column < 4)
    assert np.array_equal(skirt, (triangles % 40 < 4).all(axis=1))
    assert skirt.any()
    assert not mask_skirts(triangles, (column > 15) & (column < 20) & (np.arange(1200) // 40 == 15)).any()


def test_contradicted_surface_around_a_flap_is_a_skirt() -> None:
    triangles = _make_grid(40, 30)
    row, column = np.divmod(np.arange(1200), 40)
    is_oblique = (abs(row - 15) < 3) & (column >= 20) & (column < 24)
    is_contradicted = (abs(row - 15) < 3) & (column >= 22) & (column < 27)
    flap = mask_flaps(triangles, np.where(is_oblique, 0.0, 0.9))
    found = mask_false_surface(triangles, np.where(is_oblique, 0.0, 0.9), is_contradicted)
    assert np.array_equal(found, flap | is_contradicted[triangles].all(axis=1))
    assert np.count_nonzero(found) > np.count_nonzero(flap) > 0


def test_strips_that_remain_between_skirts_are_removed_and_wide_ones_stay() -> None:
    triangles, column = _make_grid(40, 12), np.tile(np.arange(40), 12)
    # A strip of one square is left between two skirts, and a wide part on the right.
    is_contradicted = (column < 3) | ((column > 3) & (column < 8))
    left = ~mask_skirts(triangles, is_contradicted)
    assert not left[(triangles % 40 < 7).all(axis=1)].any()
    assert left[(triangles % 40 > 8).all(axis=1)].all()


def test_a_small_mesh_without_false_surface_stays() -> None:
    assert not mask_skirts(_make_grid(2, 2), np.zeros(4, bool)).any()
