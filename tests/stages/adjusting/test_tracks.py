"""Matches are joined to tracks of at least three views, with each view at most once."""

import numpy as np

from scanloom.stages.adjusting.matching import Matches
from scanloom.stages.adjusting.tracks import build_tracks
from scanloom.stages.adjusting.view import AdjustmentView


def make_views(count: int, points: int = 5) -> list[AdjustmentView]:
    pixels = np.arange(2 * points, dtype=np.float32).reshape(-1, 2)
    return [
        AdjustmentView(
            name=f"{number}",
            pixels=pixels + 100 * number,
            descriptors=np.zeros((points, 128), np.uint8),
            size=(8, 8),
            full_size=(8, 8),
            depth=np.ones((8, 8), np.float32),
            lens=np.zeros(9),
            depth_lens=np.zeros(4),
            has_adjustable_lens=True,
        )
        for number in range(count)
    ]


def make_matches(*found: tuple[int, int, int, int]) -> Matches:
    """Make matches from tuples of view, point, other view, other point."""
    rows = np.array(found, np.intp).reshape(-1, 4)
    return Matches(rows[:, [0, 2]], rows[:, [1, 3]])


def test_matches_of_three_views_are_a_track():
    found = build_tracks(make_views(4), make_matches((0, 1, 1, 2), (1, 2, 3, 0), (0, 3, 2, 3)))
    assert found.point_count == 1
    assert found.view_indices.tolist() == [0, 1, 3]
    np.testing.assert_array_equal(found.pixels, [[2, 3], [104, 105], [300, 301]])
    assert found.point_of_match.tolist() == [0, 0, -1], "two views are no track"


def test_a_track_with_two_points_in_one_view_is_rejected():
    wrong = make_matches((0, 1, 1, 1), (1, 1, 2, 1), (2, 1, 0, 4))
    assert build_tracks(make_views(3), wrong).point_count == 0
    right = build_tracks(make_views(3), make_matches((0, 1, 1, 1), (1, 1, 2, 1), (2, 2, 0, 4), (0, 4, 1, 3)))
    assert right.point_count == 2
    assert np.bincount(right.point_indices).tolist() == [3, 3]


def test_no_matches_give_no_track():
    assert build_tracks(make_views(2), make_matches()).point_count == 0


def test_points_can_be_selected():
    found = build_tracks(make_views(3), make_matches((0, 1, 1, 1), (1, 1, 2, 1), (2, 2, 0, 4), (0, 4, 1, 3)))
    second = found.select(np.array([False, True]))
    assert second.point_count == 1
    assert second.point_indices.tolist() == [0, 0, 0]
    np.testing.assert_array_equal(second.pixels, found.pixels[found.point_indices == 1])
