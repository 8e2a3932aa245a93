"""Systematic disagreement of depth maps, independent of noise and pose errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from scanloom.stages import Frame, Scan, inspect, read_scan
from scanloom.stages.fusion.depth_noise import measure_depth_noise
from scanloom.stages.inspecting.bent_depth import BentDepth, measure_bent_depth
from scanloom.stages.scans.model.depth_correction import COEFFICIENT_COUNT, DepthCorrection
from scanloom.stages.scans.model.images import read_color, read_depth

SAMPLE = Path(__file__).resolve().parents[3] / "samples" / "rgbd"


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return [_make_frame(one) for one in read_scan(SAMPLE).frames]


def _make_frame(frame: Frame, bend: float = 0.0) -> Frame:
    """Load a frame and distort its depth by up to `bend` at the corners, relative to the centre."""
    color, depth = read_color(frame), read_depth(frame)
    assert color is not None
    assert depth is not None
    if bend:
        coefficients = np.zeros(COEFFICIENT_COUNT)
        # Second Legendre polynomials of both image axes, which are −1/2 in the centre and 1 at the corners.
        coefficients[[3, 5]] = bend / 3
        camera = frame.camera
        depth = DepthCorrection(camera.width, camera.height, 0.5, 4, tuple(coefficients)).correct_map(depth)
    return Frame.from_arrays(color, depth, frame.camera, np.asarray(frame.world_from_camera), name=frame.name)


def _shake(frames: list[Frame], metres: float, degrees: float) -> list[Frame]:
    """Add random errors to the poses."""
    rng = np.random.default_rng(5)
    shaken = []
    for frame in frames:
        pose = np.array(frame.world_from_camera)
        turn, _ = cv2.Rodrigues(np.radians(degrees) * rng.standard_normal(3))
        pose[:3, :3] = pose[:3, :3] @ turn
        pose[:3, 3] += metres * rng.standard_normal(3)
        shaken.append(replace(frame, world_from_camera=pose))
    return shaken


def _measure(frames: list[Frame]) -> BentDepth:
    found = measure_bent_depth(frames, measure_depth_noise(frames).noise)
    assert found is not None
    return found


def test_noise_is_not_bent_depth(frames: list[Frame]) -> None:
    found = _measure(frames)
    assert not found.is_clear
    assert found.gain_ratio < 0.05
    assert found.difference_ratio < 0.001


def test_inexact_poses_are_not_bent_depth(frames: list[Frame]) -> None:
    found = _measure(_shake(frames, 0.01, 0.5))
    assert not found.is_clear
    assert found.gain_ratio < 0.05


@pytest.mark.parametrize("pose_error_m", [0.0, 0.01])
def test_bent_depth_is_found_despite_inexact_poses(frames: list[Frame], pose_error_m: float) -> None:
    bent = [_make_frame(one, bend=0.02) for one in frames]
    found = _measure(_shake(bent, pose_error_m, 50 * pose_error_m))
    assert found.is_clear
    assert 0.003 < found.difference_ratio < 0.02


def test_inspect_warns_about_bent_depth(frames: list[Frame]) -> None:
    found = inspect(Scan.from_frames([_make_frame(one, bend=0.02) for one in frames])).diagnostics
    (warning,) = [one for one in found if one.code == "camera.depth-bent"]
    assert "% of the distance, depending on the position in the image" in warning.message
    assert "`scanloom adjust`" in str(warning)


def test_frames_that_adjust_cannot_correct_are_not_measured(frames: list[Frame]) -> None:
    noise = measure_depth_noise(frames).noise
    assert measure_bent_depth([replace(one, color=None) for one in frames], noise) is None
    corrected = [
        replace(one, depth_correction=DepthCorrection(1, 1, 1, 2, (0.0,) * COEFFICIENT_COUNT))
        for one in frames
    ]
    assert measure_bent_depth(corrected, noise) is None
    # Frames from the same pose have equal errors in equal pixels.
    still = [replace(one, world_from_camera=frames[0].world_from_camera) for one in frames]
    assert measure_bent_depth(still, noise) is None
    assert measure_bent_depth(frames[:1], noise) is None
