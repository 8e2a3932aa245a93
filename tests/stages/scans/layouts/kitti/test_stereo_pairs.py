import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan


def calib(baseline):
    return (
        "S_rect_02: 32 24\nP_rect_02: 100 0 16 6 0 100 12 0 0 0 1 0\n"
        f"S_rect_03: 32 24\nP_rect_03: 100 0 16 {6 - 100 * baseline:g} 0 100 12 0 0 0 1 0\n"
    )


@pytest.fixture
def scan_folder(tmp_path, tiny):
    for side in ("image_2", "image_3"):
        for name in ("000000_10", "000000_11", "000001_10", "000001_11"):
            tiny.color(tmp_path / side / f"{name}.png")
    (tmp_path / "calib_cam_to_cam").mkdir()
    for scene, baseline in (("000000", 0.5), ("000001", 0.25)):
        (tmp_path / "calib_cam_to_cam" / f"{scene}.txt").write_text(calib(baseline))
    return tmp_path


@pytest.mark.parametrize(("position", "name", "baseline"), [(0, "000000_10", 0.5), (3, "000001_11", 0.25)])
def test_a_scene_has_its_own_calibration(scan_folder, tiny, position, name, baseline):
    scan = read_scan(scan_folder, ScanParams(first=position, last=position))
    assert scan.layout == "kitti-stereo"
    (frame,) = scan.frames
    assert (frame.name, frame.right.parent.name) == (name, "image_3")
    assert scan.rig.baseline == pytest.approx(baseline)
    np.testing.assert_array_equal(frame.world_from_camera, np.eye(4))
    np.testing.assert_allclose(tiny.pixel(tiny.points[0], np.eye(4), scan.rig.left), (26, 17))
    # Disparity f b / z.
    right = tiny.pixel(tiny.points[0], scan.rig.right_from_left, scan.rig.right)
    np.testing.assert_allclose(right, (26 - 100 * baseline / 2, 17))


def test_scenes_are_not_mixed(scan_folder):
    with pytest.raises(InputError, match=r"2 scenes.*000000_10, set scan\.first=0 and scan\.last=0"):
        read_scan(scan_folder)


def test_the_two_moments_of_a_scene_lack_poses(scan_folder):
    with pytest.raises(InputError, match="no poses: the data set contains no poses"):
        read_scan(scan_folder, ScanParams(first=2, last=3))


def test_given_poses_are_used(scan_folder, tiny):
    poses = [tiny.identity, tiny.second] * 2
    rows = [" ".join(f"{value:g}" for value in pose[:3].ravel()) for pose in poses]
    (scan_folder / "mine.txt").write_text("\n".join(rows))
    scan = read_scan(scan_folder, ScanParams(first=2, last=3, poses="mine.txt"))
    np.testing.assert_allclose([frame.world_from_camera for frame in scan.frames], poses[2:])


def test_the_older_set_names_its_folders_otherwise(scan_folder):
    for old, new in (("image_2", "image_0"), ("image_3", "image_1"), ("calib_cam_to_cam", "calib")):
        (scan_folder / old).rename(scan_folder / new)
    (scan_folder / "calib" / "000000.txt").write_text(
        "P0: 100 0 16 0 0 100 12 0 0 0 1 0\nP1: 100 0 16 -50 0 100 12 0 0 0 1 0\n"
    )
    scan = read_scan(scan_folder, ScanParams(last=0))
    assert (scan.layout, scan.rig.baseline) == ("kitti-stereo", pytest.approx(0.5))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (calib(0.5).replace("32 24", "32000000 24"), "S_rect is not a valid image size"),
        (None, "calib_cam_to_cam/000000.txt is missing"),
        ("", "projection matrices P2 and P3 are missing"),
        ("P_rect_02: 1 2\n", "must be 12 finite numbers"),
        (calib(-0.5), "not right of the first"),
        (calib(0.5).replace("32 24", "1e400 24"), "S_rect must be two numbers"),
    ],
)
def test_wrong_calibrations_are_reported(scan_folder, text, message):
    path = scan_folder / "calib_cam_to_cam" / "000000.txt"
    path.unlink() if text is None else path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_scan(scan_folder, ScanParams(last=0))
