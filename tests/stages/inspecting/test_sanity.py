"""Colour beside depth: told from 3 px on, and never of frames that are registered."""

import re
from pathlib import Path

import numpy as np
import pytest

from stages.fusion.posed_depth import read_matching_color
from stages.inspecting.sanity import check_registration
from stages.scans.images import read_depth
from stages.scans.read import read_scan

SAMPLE = Path(__file__).parents[3] / "samples" / "rgbd"


@pytest.fixture(scope="module")
def pairs():
    frames = read_scan(SAMPLE).frames
    depths = [(frame, read_depth(frame)) for frame in frames[:: len(frames) // 5]]
    return [(read_matching_color(frame, depth), depth) for frame, depth in depths]


@pytest.mark.parametrize(
    ("right", "down", "words"),
    [
        (0, 0, None),
        (1, 0, None),
        (0, 1, None),
        (5, 0, "about 5 px right and [01] px"),
        (-5, 0, "about 5 px left and [01] px"),
        (0, -6, "about 0 px left and [67] px above"),
    ],
)
def test_colour_that_is_moved(pairs, right, down, words):
    moved = [(np.roll(color, (down, right), axis=(0, 1)), depth) for color, depth in pairs]
    said = check_registration(moved)
    assert len(said) == (words is not None)
    if words is not None:
        assert re.search(words, said[0])
