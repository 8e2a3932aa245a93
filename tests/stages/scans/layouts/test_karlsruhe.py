import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

CALIB = (
    "P1: 90 0 20 0 0 90 15 0 0 0 1 0\n"
    "P1_roi: 100 0 16 0 0 100 12 0 0 0 1 0\n"
    "P2_roi: 100 0 16 -50 0 100 12 0 0 0 1 0\n"
)


@pytest.fixture
def scan_folder(tmp_path, tiny):
    for side in (1, 2):
        for number in (0, 1):
            tiny.color(tmp_path / f"I{side}_{number:06}.png")
    (tmp_path / "calib.txt").write_text(CALIB)
    (tmp_path / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n0 0 1 1 0 1 0 2 -1 0 0 3\n")
    return tmp_path


def test_known_points_fall_on_known_pixels(scan_folder, tiny):
    scan = read_scan(scan_folder)
    assert (scan.layout, scan.rig.is_rectified, scan.rig.baseline) == ("karlsruhe", True, 0.5)
    assert [frame.right.name for frame in scan.frames] == ["I2_000000.png", "I2_000001.png"]
    for frame, point in zip(scan.frames, tiny.points, strict=True):
        camera_from_world = np.linalg.inv(frame.world_from_camera)
        np.testing.assert_allclose(tiny.pixel(point, camera_from_world, frame.camera), (26, 17), atol=1e-6)
        right = tiny.pixel(point, scan.rig.right_from_left @ camera_from_world, scan.rig.right)
        np.testing.assert_allclose(right, (1, 17), atol=1e-6)


def test_without_poses_and_without_a_calibration(scan_folder):
    for name in ("calib.txt", "poses.txt"):
        (scan_folder / name).unlink()
    lacking = read_scan(scan_folder, complete=False).missing
    assert [one.code for one in lacking] == ["camera.pair-uncalibrated", "pose.missing"]
    stated = ScanParams(intrinsics="100,100,16,12", baseline=0.5)
    assert read_scan(scan_folder, stated, complete=False).rig.baseline == 0.5
    with pytest.raises(InputError, match=r"no calibration: calib\.txt .*; and no poses: poses\.txt") as both:
        read_scan(scan_folder)
    assert both.value.diagnostic.code == "camera.pair-uncalibrated"
    with pytest.raises(InputError, match=r"no poses: poses\.txt is missing; name a traj") as alone:
        read_scan(scan_folder, stated)
    assert (alone.value.diagnostic.code, alone.value.diagnostic.severity.value) == ("pose.missing", "error")


def test_gps_positions_are_not_used_as_poses_and_reported(scan_folder):
    (scan_folder / "poses.txt").unlink()
    (scan_folder / "insdata.txt").write_text("1.0 49.01 8.43 112 0 0 0 0.01 0.02 1.5\n" * 2)
    (lacking,) = read_scan(scan_folder, complete=False).missing
    assert "insdata.txt has positions of the car" in str(lacking)
    assert "scan.poses=FILE" in str(lacking)


def test_a_damaged_projection(scan_folder):
    (scan_folder / "calib.txt").write_text(CALIB.replace("-50", "fifty"))
    with pytest.raises(InputError, match="P2_roi must be 12 finite numbers"):
        read_scan(scan_folder)
