"""Parameters that do not apply to a folder are refused instead of ignored."""

import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan


@pytest.fixture
def scan_folder(tmp_path, tiny, matrix_text):
    for number, pose in enumerate((tiny.identity, tiny.second)):
        tiny.color(tmp_path / f"frame-{number:06d}.color.png")
        tiny.depth(tmp_path / f"frame-{number:06d}.depth.png", 1000)
        (tmp_path / f"frame-{number:06d}.pose.txt").write_text(matrix_text(pose))
    (tmp_path / "camera-intrinsics.txt").write_text("100 0 16\n0 100 12\n0 0 1\n")
    return tmp_path


@pytest.fixture
def pair_folder(tmp_path, tiny):
    for name in ("im0.png", "im1.png"):
        tiny.color(tmp_path / name)
    (tmp_path / "calib.txt").write_text(
        "cam0=[100 0 16; 0 100 12; 0 0 1]\ncam1=[100 0 16; 0 100 12; 0 0 1]\ndoffs=0\nbaseline=100\n"
    )
    return tmp_path


def test_a_calibration_that_the_layout_does_not_take(pair_folder):
    (pair_folder / "mine.json").write_text("{}")
    with pytest.raises(UsageError, match=r"mine\.json has no effect: the layout middlebury does not use it"):
        read_scan(pair_folder, ScanParams(calibration="mine.json"), complete=False)


def test_a_camera_stated_twice(scan_folder):
    with pytest.raises(UsageError, match=r"scan\.intrinsics and scan\.calibration=.* both state the camera"):
        read_scan(scan_folder, ScanParams(intrinsics="100,100,16,12", calibration="camera-intrinsics.txt"))


def test_the_baseline_of_no_pair(scan_folder):
    with pytest.raises(UsageError, match="these frames are not stereo pairs"):
        read_scan(scan_folder, ScanParams(baseline=0.1))


def test_a_unit_and_a_confidence_of_depth_that_is_not_there(scan_folder, pair_folder):
    with pytest.raises(UsageError, match="these frames have none; remove the option"):
        read_scan(scan_folder, ScanParams(min_confidence=1))
    for path in scan_folder.glob("frame-*"):
        path.unlink()
    with pytest.raises(UsageError, match="stereo pairs have none"):
        read_scan(pair_folder, ScanParams(depth_scale=1000), complete=False)


def test_an_order_of_no_poses(scan_folder):
    for path in scan_folder.glob("*.pose.txt"):
        path.unlink()
    with pytest.raises(UsageError, match=r"the scan has none; give one with scan\.poses=FILE"):
        read_scan(scan_folder, ScanParams(poses_by_order=True), complete=False)


def test_used_parameters_are_not_refused(scan_folder, tiny):
    (scan_folder / "mine.txt").write_text("0 0 0 0 0 0 1\n" * 2)
    stated = ScanParams(calibration="camera-intrinsics.txt", poses="mine.txt", poses_by_order=True)
    # Equal poses count as missing, but the file was read.
    scan = read_scan(scan_folder, stated, complete=False)
    assert "all 2 frames have the same pose" in str(scan.missing[0])
    np.testing.assert_allclose(scan.frames[0].camera.fx, tiny.intrinsics[0])
