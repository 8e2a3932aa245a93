"""Filling of untextured regions: only if the measured surroundings are on one plane."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import posed_scene
import pytest

from scanloom.stages.scans.model.scan import Camera, DepthImage, Frame, Scan, SkippedFrame
from scanloom.stages.stereo.depth_map import DepthMap
from scanloom.stages.stereo.opencv_matching import SearchRange
from scanloom.stages.stereo.params import DepthParams
from scanloom.stages.stereo.plane_filling import (
    _mask_confirmed,
    compute_plane_depth,
    fill_from_planes,
    fit_plane,
)
from scanloom.stages.stereo.posed_views import PosedView

HEIGHT, WIDTH = 240, 320
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH].astype(float)
# Inverse depth of a floor that recedes towards the top, 1 to 2.2 m.
FLOOR = 1 / (0.45 + 0.0022 * ROWS + 0.0003 * COLUMNS)
SQUARE = np.s_[40:200, 60:260]


def make_photo(*edges: tuple[slice, slice]) -> np.ndarray:
    """Make a photo with texture everywhere except in single-colour patches."""
    color = np.random.default_rng(1).integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    for number, patch in enumerate(edges):
        color[patch] = 90 + 60 * number
    return color


def add_noise_and_holes(depth: np.ndarray, *open_: tuple[slice, slice]) -> tuple[DepthImage, np.ndarray]:
    """Add noise, and remove depth inside patches except for a margin; return confidence as well."""
    noise = 1 + 2e-3 * np.random.default_rng(2).standard_normal(depth.shape)
    found = (depth * noise).astype(np.float32)
    for rows, columns in open_:
        found[rows.start + 3 : rows.stop - 3, columns.start + 3 : columns.stop - 3] = 0
    return found, np.full(depth.shape, 250, np.uint8)


def test_a_patch_of_a_floor_is_filled_to_a_fraction_of_the_noise() -> None:
    depth, trust = add_noise_and_holes(FLOOR, SQUARE)
    told = compute_plane_depth(depth, trust, make_photo(SQUARE))
    assert not told[depth > 0].any()
    hole = np.zeros(depth.shape, bool)
    hole[SQUARE] = depth[SQUARE] == 0
    assert np.mean(told[hole] > 0) > 0.95
    off = told[hole & (told > 0)] / FLOOR[hole & (told > 0)] - 1
    assert np.abs(off).max() < 2e-3
    np.testing.assert_array_equal(told, compute_plane_depth(depth, trust, make_photo(SQUARE)))


def test_textured_or_uncertain_patches_are_not_filled() -> None:
    depth, trust = add_noise_and_holes(FLOOR, SQUARE)
    assert not compute_plane_depth(depth, trust, make_photo()).any()
    assert not compute_plane_depth(depth, np.full_like(trust, 210), make_photo(SQUARE)).any()
    assert not compute_plane_depth(np.zeros_like(depth), trust, make_photo(SQUARE)).any()


def test_a_patch_without_dominant_plane_is_not_filled() -> None:
    """A fold of cloth, and a ball: untextured, but not flat."""
    fold = np.where(COLUMNS < 160, FLOOR, FLOOR * (1 + 0.003 * (COLUMNS - 160)))
    radius2 = ((ROWS - 120) ** 2 + (COLUMNS - 160) ** 2) / 200**2
    ball = 2 - np.sqrt(np.maximum(1 - radius2, 0.01))
    for depth in (fold, ball):
        found, trust = add_noise_and_holes(depth, SQUARE)
        told = compute_plane_depth(found, trust, make_photo(SQUARE))
        off = np.abs(told[told > 0] / depth[told > 0] - 1)
        assert not told.any() or off.max() < 0.01


def test_foreground_does_not_affect_the_plane_and_background_prevents_filling() -> None:
    for factor, is_filled in ((0.6, True), (1.3, False)):
        depth = np.array(FLOOR)
        # A quarter of the rim belongs to another surface.
        depth[195:, :] *= factor
        found, trust = add_noise_and_holes(depth, SQUARE)
        told = compute_plane_depth(found, trust, make_photo(SQUARE))
        assert told.any() == is_filled
        if is_filled:
            inside = np.zeros(depth.shape, bool)
            inside[43:190, 63:257] = True
            there = inside & (told > 0)
            assert np.abs(told[there] / FLOOR[there] - 1).max() < 5e-3


def test_nothing_is_filled_beyond_the_measured_side() -> None:
    """Depth on one side does not determine the other side, however well a plane fits."""
    depth, trust = add_noise_and_holes(FLOOR, SQUARE)
    depth[:, 110:] = 0
    told = compute_plane_depth(depth, trust, make_photo(SQUARE))
    assert not told[:, 112:].any()


def test_the_dominant_plane_is_found_among_outliers() -> None:
    random = np.random.default_rng(3)
    squares = np.column_stack([random.uniform(0, 300, (60, 2)), np.zeros(60)])
    squares[:, 2] = 0.5 + squares[:, :2] @ (1e-3, -4e-4)
    squares[:20, 2] *= random.uniform(1.2, 3, 20)
    taken = fit_plane(squares, random)
    assert taken is not None
    np.testing.assert_array_equal(taken, np.arange(60) >= 20)
    squares[:40, 2] *= random.uniform(1.2, 3, 40)
    assert fit_plane(squares, random) is None
    # Points on a line determine no plane.
    squares[:, 1] = squares[:, 0]
    assert fit_plane(squares[:11], random) is None


@pytest.mark.parametrize(
    ("said", "seen", "is_kept"),
    [
        ((1.0, 1.0, 0.0), (0.0, 0.0, 0.0), True),
        ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), False),
        ((1.0, 1.0, 1.2), (0.0, 0.0, 1.2), False),
        ((1.0, 1.0, 1.2), (1.0, 0.0, 1.2), True),
    ],
)
def test_a_pixel_is_filled_if_other_views_agree_and_none_contradicts(
    said: tuple[float, ...], seen: tuple[float, ...], is_kept: bool
) -> None:
    view = PosedView(posed_scene.CAMERA, posed_scene.pose(0, 0), 0.8, 1.6)
    told = np.full((view.camera.height, view.camera.width), 1.0, np.float32)
    way = view.compute_projection_to(view)
    whole, measured_ = ([(way, told * np.float32(z)) for z in values] for values in (said, seen))
    kept = _mask_confirmed(told, whole, measured_, min_view_count=2)[1:-1, 1:-1]
    assert (kept == is_kept).all()


@pytest.mark.parametrize("threads", [1, 2])
def test_depth_maps_of_views_are_filled_marked_and_masked(tmp_path: Path, threads: int) -> None:
    """Three views from one position and one skipped view; the left half of their hole is masked."""
    camera, color = Camera(WIDTH, HEIGHT, 300.0, 300.0, 160.0, 120.0), make_photo(SQUARE)
    depth, trust = add_noise_and_holes(FLOOR, SQUARE)
    nothing = np.full(depth.shape, np.nan, np.float32)
    found = DepthMap(depth, trust, nothing, color, camera, np.eye(3), SearchRange(0, 16), 0.5, 5.0)
    maps: list[DepthMap | SkippedFrame] = [found, found, SkippedFrame("2", "it is damaged"), found]
    views = [PosedView(camera, np.eye(4), 0.5, 5.0)] * 4
    frames = [Frame(str(at), camera, color=color, world_from_camera=np.eye(4)) for at in range(4)]
    right = COLUMNS >= 160
    told: list[int] = []
    filled = fill_from_planes(
        iter(maps),
        Scan("views", frames),
        views,
        [[other for other in range(4) if other != at] for at in range(4)],
        lambda _, depth: np.where(right, depth, np.float32(0)),
        DepthParams(threads=threads),
        tmp_path,
        told.append,
    )
    results = list(filled)
    assert told == [1, 2, 3, 4]
    assert results[2] == maps[2]
    for one in (results[0], results[1], results[3]):
        assert isinstance(one, DepthMap)
        assert one.filled is not None
        assert not one.filled[~right].any()
        assert np.mean(one.filled[right & (depth == 0)]) > 0.9
        np.testing.assert_array_equal(one.depth[~one.filled], depth[~one.filled])
        assert (one.confidence[one.filled] == 1).all()
        np.testing.assert_allclose(one.depth[one.filled], FLOOR[one.filled], rtol=3e-3)
        np.testing.assert_array_equal(one.color, color)
