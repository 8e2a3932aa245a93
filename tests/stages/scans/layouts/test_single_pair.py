import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan


@pytest.fixture
def scan_folder(tmp_path, tiny):
    for name in ("view1", "view5"):
        tiny.color(tmp_path / f"{name}.png", (460, 370))
    (tmp_path / "dmin.txt").write_text("240\n")
    return tmp_path


def test_the_published_calibration_at_a_third_of_the_size(scan_folder, tiny):
    scan = read_scan(scan_folder)
    assert (scan.layout, scan.rig.is_rectified) == ("pair", True)
    point = (0.2, 0.1, 2.0)
    left = tiny.pixel(point, np.eye(4), scan.rig.left)
    right = tiny.pixel(point, scan.rig.right_from_left, scan.rig.right)
    # z = f b / (d + dmin), all in pixels at a third of the size.
    disparity = 3740 / 3 * 0.16 / 2.0 - 240 / 3
    np.testing.assert_allclose(left - right, (disparity, 0), atol=1e-9)
    np.testing.assert_allclose(left, (229.5 + 3740 / 30, 184.5 + 3740 / 60))
    texts = [str(one) for one in scan.diagnostics]
    assert any("published calibration of Middlebury" in t and "scan.intrinsics" in t for t in texts)
    assert any("the only frame has no pose" in t for t in texts)


def test_a_stated_calibration_wins(scan_folder):
    scan = read_scan(scan_folder, ScanParams(intrinsics="400,400,230,185", baseline=0.3))
    assert (scan.rig.left.fx, scan.rig.right.cx, scan.rig.baseline) == (400, 230, 0.3)
    assert not any("published" in text for text in map(str, scan.diagnostics))
    assert read_scan(scan_folder, ScanParams(baseline=0.3)).rig.baseline == pytest.approx(0.3)
    with pytest.raises(InputError, match="no calibration"):
        read_scan(scan_folder, ScanParams(intrinsics="400,400,230,185"))


def test_without_dmin_or_of_another_size_the_calibration_is_asked_for(scan_folder, tiny):
    for name in ("view1", "view5"):
        tiny.color(scan_folder / f"{name}.png", (460, 371))
    with pytest.raises(
        InputError, match=r"no calibration: .*scan\.intrinsics=fx,fy,cx,cy and scan\.baseline"
    ):
        read_scan(scan_folder)
    for name in ("view1", "view5"):
        tiny.color(scan_folder / f"{name}.png", (460, 370))
    (scan_folder / "dmin.txt").unlink()
    with pytest.raises(InputError, match="no calibration"):
        read_scan(scan_folder)


@pytest.mark.parametrize("text", ["", "nan", "1 2", "1e9", "x"])
def test_a_damaged_dmin_is_reported(scan_folder, text):
    (scan_folder / "dmin.txt").write_text(text)
    with pytest.raises(InputError, match=r"dmin\.txt: the file must contain one number"):
        read_scan(scan_folder)


def test_a_pose_can_be_given(scan_folder):
    (scan_folder / "mine.txt").write_text("1 0 0 7 0 1 0 8 0 0 1 9\n")
    (frame,) = read_scan(scan_folder, ScanParams(poses="mine.txt")).frames
    np.testing.assert_array_equal(frame.world_from_camera[:3, 3], (7, 8, 9))


def test_cones_lack_a_calibration(shared_data):
    folder = shared_data / "stereo" / "middlebury2003_cones"
    with pytest.raises(InputError, match="no calibration"):
        read_scan(folder)
    assert read_scan(folder, ScanParams(intrinsics="900,900,225,187", baseline=0.16)).rig.baseline == 0.16


def test_k_txt_is_the_matrix_and_the_baseline(tmp_path, tiny):
    for name in ("left", "right"):
        tiny.color(tmp_path / f"{name}.png")
    (tmp_path / "K.txt").write_text("100 0 16 0 100 12 0 0 1\n0.5\n")
    scan = read_scan(tmp_path)
    assert (scan.layout, scan.rig.is_rectified, scan.rig.baseline, scan.rig.left.cx) == (
        "pair",
        True,
        0.5,
        16,
    )
    point = (0.2, 0.1, 2.0)
    at = [tiny.pixel(point, pose, scan.rig.left) for pose in (np.eye(4), scan.rig.right_from_left)]
    np.testing.assert_allclose(at, [(26, 17), (1, 17)])


def test_a_real_pair_with_k_txt(shared_data):
    scan = read_scan(shared_data / "real" / "stereo_pair_k_txt")
    assert (scan.rig.is_rectified, scan.rig.baseline) == (True, 0.063)
    assert scan.rig.left.fx == pytest.approx(754.668, abs=1e-3)
