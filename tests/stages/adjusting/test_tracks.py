"""Matches joined to tracks: three views at least, and no view twice."""

import numpy as np

from scanloom.stages.adjusting.matching import Matches
from scanloom.stages.adjusting.tracks import tracks
from scanloom.stages.adjusting.view import View


def views(count: int, points: int = 5) -> list[View]:
    pixels = np.arange(2 * points, dtype=np.float32).reshape(-1, 2)
    return [
        View(
            name=f"{number}",
            pixels=pixels + 100 * number,
            descriptors=np.zeros((points, 128), np.uint8),
            size=(8, 8),
            full_size=(8, 8),
            depth=np.ones((8, 8), np.float32),
            lens=np.zeros(9),
            depth_lens=np.zeros(4),
            is_plain=True,
        )
        for number in range(count)
    ]


def matches(*found: tuple[int, int, int, int]) -> Matches:
    """Return matches, each: a view and its point, another view and its point."""
    rows = np.array(found, np.intp).reshape(-1, 4)
    return Matches(rows[:, [0, 2]], rows[:, [1, 3]])


def test_matches_of_three_views_are_a_track():
    found = tracks(views(4), matches((0, 1, 1, 2), (1, 2, 3, 0), (0, 3, 2, 3)))
    assert found.count == 1
    assert found.view.tolist() == [0, 1, 3]
    np.testing.assert_array_equal(found.pixels, [[2, 3], [104, 105], [300, 301]])
    assert found.matched.tolist() == [0, 0, -1], "two views are no track"


def test_a_track_that_meets_itself_in_one_view_is_left_out():
    wrong = matches((0, 1, 1, 1), (1, 1, 2, 1), (2, 1, 0, 4))
    assert tracks(views(3), wrong).count == 0
    right = tracks(views(3), matches((0, 1, 1, 1), (1, 1, 2, 1), (2, 2, 0, 4), (0, 4, 1, 3)))
    assert right.count == 2
    assert np.bincount(right.point).tolist() == [3, 3]


def test_nothing_matched_is_no_track():
    assert tracks(views(2), matches()).count == 0


def test_some_points_are_taken():
    found = tracks(views(3), matches((0, 1, 1, 1), (1, 1, 2, 1), (2, 2, 0, 4), (0, 4, 1, 3)))
    second = found.of(np.array([False, True]))
    assert second.count == 1
    assert second.point.tolist() == [0, 0, 0]
    np.testing.assert_array_equal(second.pixels, found.pixels[found.point == 1])
