"""Misalignment of colour, depth and poses is reported in pixels, with a remedy."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scanloom import inspect, read_scan
from scanloom.stages.adjusting.cameras import compute_motions

SAMPLE = Path(__file__).parents[3] / "samples" / "rgbd"


@pytest.mark.slow
def test_consistent_frames_raise_no_warning():
    found = inspect(read_scan(SAMPLE))
    assert found.reprojection_error_px < 0.5
    assert not any("px (median" in text for text in map(str, found.diagnostics))


@pytest.mark.slow
def test_inexact_poses_are_reported_with_a_remedy():
    scan = read_scan(SAMPLE)
    steps = np.random.default_rng(3).normal(size=(len(scan.frames), 1, 6)) * 0.006
    frames = [
        replace(frame, world_from_camera=frame.world_from_camera @ compute_motions(step)[0])
        for frame, step in zip(scan.frames, steps, strict=True)
    ]
    found = inspect(replace(scan, frames=frames))
    assert found.reprojection_error_px > 2
    (said,) = (text for text in map(str, found.diagnostics) if "scanloom adjust" in text)
    assert f"misaligned by {found.reprojection_error_px:.1f} px" in said
    assert f"points seen in two frames are {found.reprojection_error_px:.2g} px apart" in "\n".join(
        found.format_lines()
    )
