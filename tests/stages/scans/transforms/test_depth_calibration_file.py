"""A depth calibration is written, read and applied; an invalid file is one clear error."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scanloom import InputError, ScanParams, UsageError, read_scan
from scanloom.pipeline.cache.digest import compute_scan_digest
from scanloom.stages.scans.model.depth_correction import COEFFICIENT_COUNT, DepthCorrection
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.transforms.depth_calibration import (
    read_depth_calibration,
    to_depth_calibration_table,
    write_depth_calibration,
)

SAMPLES = Path(__file__).parents[4] / "samples"


@pytest.fixture
def correction() -> DepthCorrection:
    values = 0.004 * np.random.default_rng(1).normal(size=COEFFICIENT_COUNT)
    return DepthCorrection(320, 240, 0.3, 1.9, tuple(values.tolist()))


def test_a_correction_that_is_written_is_read_again(tmp_path: Path, correction: DepthCorrection) -> None:
    path = tmp_path / "depth_calibration.json"
    write_depth_calibration(path, correction)
    assert read_depth_calibration(path) == correction


def test_a_stored_correction_applies_to_a_scan(tmp_path: Path, correction: DepthCorrection) -> None:
    path = tmp_path / "depth_calibration.json"
    write_depth_calibration(path, correction)
    scan = read_scan(SAMPLES / "rgbd", ScanParams(depth_calibration=str(path), last=1))
    given = read_scan(SAMPLES / "rgbd", ScanParams(last=1))
    for frame, other in zip(scan.frames, given.frames, strict=True):
        assert frame.depth_correction == correction
        np.testing.assert_array_equal(read_depth(frame), correction.correct_map(read_depth(other)))
    assert compute_scan_digest(scan).digest != compute_scan_digest(given).digest


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"coefficients": [0.0] * 3}, "30 coefficients"),
        ({"coefficients": ["0"] * COEFFICIENT_COUNT}, "30 coefficients"),
        ({"coefficients": [0.3] * COEFFICIENT_COUNT}, "at most 50 % are plausible"),
        ({"near_m": 3.0}, "near_m < far_m"),
        ({"width": 0}, "width and height"),
        ({"version": 2}, "unsupported version"),
        ({"coefficients": None}, "30 coefficients"),
        ({"width": 400}, "is for depth maps of 400 × 240 px"),
    ],
)
def test_an_invalid_file_is_an_error(
    tmp_path: Path, correction: DepthCorrection, change: dict[str, Any], message: str
) -> None:
    path = tmp_path / "depth_calibration.json"
    path.write_text(json.dumps(to_depth_calibration_table(correction) | change))
    with pytest.raises(InputError, match=message):
        read_scan(SAMPLES / "rgbd", ScanParams(depth_calibration=str(path)))


def test_another_file_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "cameras.json"
    path.write_text('{"accepted": true}')
    with pytest.raises(InputError, match=r"depth_calibration\.json of `scanloom adjust` is expected"):
        read_scan(SAMPLES / "rgbd", ScanParams(depth_calibration=str(path)))


def test_stereo_pairs_have_no_depth_to_correct(tmp_path: Path, correction: DepthCorrection) -> None:
    path = tmp_path / "depth_calibration.json"
    write_depth_calibration(path, correction)
    with pytest.raises(UsageError, match="applies to depth maps"):
        read_scan(SAMPLES / "stereo", ScanParams(depth_calibration=str(path)))
