import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

CALIB = """cam0=[100 0 16; 0 100 12; 0 0 1]
cam1=[100 0 20; 0 100 12; 0 0 1]
doffs=4
baseline=250
width=32
height=24
ndisp=30
isint=0
"""


@pytest.fixture
def scan_folder(tmp_path, tiny):
    tiny.color(tmp_path / "im0.png")
    tiny.color(tmp_path / "im1.png")
    (tmp_path / "calib.txt").write_text(CALIB)
    return tmp_path


def test_the_known_point_falls_on_known_pixels(scan_folder, tiny):
    scan = read_scan(scan_folder)
    (frame,) = scan.frames
    assert (scan.layout, scan.rig.is_rectified, scan.rig.disparity_count) == ("middlebury", True, 30)
    assert scan.rig.baseline == pytest.approx(0.25)
    camera_from_world = np.linalg.inv(frame.world_from_camera)
    left = tiny.pixel(tiny.points[0], camera_from_world, scan.rig.left)
    right = tiny.pixel(tiny.points[0], scan.rig.right_from_left @ camera_from_world, scan.rig.right)
    np.testing.assert_allclose(left, (26, 17))
    # z = f b / (d + doffs): 2 = 100 * 0.25 / (8.5 + 4).
    np.testing.assert_allclose(right, (26 - 8.5, 17))


def test_a_single_pair_without_pose_is_at_the_origin_with_a_report(scan_folder):
    scan = read_scan(scan_folder)
    np.testing.assert_array_equal(scan.frames[0].world_from_camera, np.eye(4))
    assert any("the only frame has no pose" in text for text in map(str, scan.diagnostics))


def test_a_pose_file_is_used(scan_folder, tiny, matrix_text):
    (scan_folder / "pose.txt").write_text(matrix_text(tiny.second))
    scan = read_scan(scan_folder)
    np.testing.assert_allclose(scan.frames[0].world_from_camera, tiny.second)
    assert not scan.diagnostics


def test_a_baseline_in_metres_is_noticed(scan_folder):
    (scan_folder / "calib.txt").write_text(CALIB.replace("baseline=250", "baseline=0.25"))
    scan = read_scan(scan_folder)
    assert scan.rig.baseline == pytest.approx(0.25)
    assert any("metres" in text for text in map(str, scan.diagnostics))


def test_stated_values_win(scan_folder):
    rig = read_scan(scan_folder, ScanParams(baseline=0.1, intrinsics="50,50,15,11")).rig
    assert rig.baseline == pytest.approx(0.1)
    assert (rig.left.fx, rig.right.fx, rig.right.cx - rig.left.cx) == (50, 50, 4)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "cam0"),
        (CALIB.replace("baseline=250\n", ""), "baseline"),
        (CALIB.replace("cam1=[100 0 20; 0 100 12; 0 0 1]", "cam1=[1 2]"), "3x3"),
        (CALIB.replace("width=32", "width=64"), "64×24.*32×24"),
        (CALIB.replace("baseline=250", "baseline=-1"), "baseline"),
        (CALIB.replace("baseline=250", "baseline=nan"), "baseline"),
        (CALIB.replace("cam0=[100", "cam0=[-100"), "focal length"),
    ],
)
def test_damaged_calibrations_are_reported(scan_folder, text, message):
    (scan_folder / "calib.txt").write_text(text)
    with pytest.raises(InputError, match=message):
        read_scan(scan_folder)


def test_motorcycle(shared_data):
    scan = read_scan(shared_data / "stereo" / "middlebury2014_motorcycle")
    assert (scan.layout, scan.rig.disparity_count) == ("middlebury", 70)
    assert scan.rig.baseline == pytest.approx(0.193001)
    assert scan.rig.right.cx - scan.rig.left.cx == pytest.approx(31.086)


def test_a_missing_calibration_is_an_error_with_a_remedy(tmp_path, tiny):
    tiny.color(tmp_path / "im2.ppm")
    tiny.color(tmp_path / "im6.ppm")
    with pytest.raises(InputError, match=r"no calibration.*scan\.intrinsics.*scan\.baseline"):
        read_scan(tmp_path)
    scan = read_scan(tmp_path, ScanParams(intrinsics=tiny.option, baseline=0.5))
    right = tiny.pixel(tiny.points[0], scan.rig.right_from_left, scan.rig.right)
    np.testing.assert_allclose(right, (1, 17))
    assert scan.frames[0].right.name == "im6.ppm"


def test_middlebury_2014_without_its_calibration(scan_folder):
    (scan_folder / "calib.txt").unlink()
    with pytest.raises(InputError, match="no calibration"):
        read_scan(scan_folder)


def test_cones(shared_data):
    folder = shared_data / "stereo" / "middlebury2003_cones"
    with pytest.raises(InputError, match=r"middlebury2003_cones.*no calibration"):
        read_scan(folder)
    scan = read_scan(folder, ScanParams(intrinsics="1000,1000,225,187", baseline=0.16))
    assert (scan.rig.left.width, scan.rig.left.height) == (450, 375)
