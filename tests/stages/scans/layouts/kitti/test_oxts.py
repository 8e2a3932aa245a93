"""Poses of KITTI's raw recordings from the car's GPS/IMU unit.

The drive is at a latitude of 60°, whose cosine is 1/2, so a degree of longitude is half as long as at the
equator: 111319.490793 / 2 m. The unit has x forward, y left, z up. The laser scanner is 1 m in front of the
unit and 0.5 m above. Camera 0 has x right, y down, z forward, and is 0.3 m in front of the scanner.
"""

import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

CAMERAS = """S_rect_02: 3.200000e+01 2.400000e+01
R_rect_00: 1 0 0 0 1 0 0 0 1
P_rect_02: 100 0 16 6 0 100 12 0 0 0 1 0
P_rect_03: 100 0 16 -48 0 100 12 0 0 0 1 0
"""
UNIT = "calib_time: now\nR: 1 0 0 0 1 0 0 0 1\nT: -1 0 -0.5\n"
# From scanner to camera: forward is z, left is -x, up is -y.
SCANNER = "calib_time: now\nR: 0 -1 0 0 0 -1 1 0 0\nT: 0 0 -0.3\ndelta_f: 0 0\n"
DEGREE = 111319.49079327358 / 2


def measured(east=0.0, north=0.0, up=0.0, roll=0.0, pitch=0.0, yaw=0.0):
    """Format an OXTS file for a position in metres from 60° north, 8° east, at 100 m."""
    return (
        f"{60 + north / (2 * DEGREE):.13f} {8 + east / DEGREE:.13f} {100 + up} {roll} {pitch} {yaw} "
        + "0 " * 24
    )


@pytest.fixture
def drive(tmp_path, tiny):
    folder = tmp_path / "2011_09_26" / "2011_09_26_drive_0001_sync"
    for number in range(3):
        for side in ("image_02", "image_03"):
            tiny.color(folder / side / "data" / f"{number:010d}.png")
    (folder / "oxts" / "data").mkdir(parents=True)
    texts = [measured(), measured(yaw=np.pi / 2, east=3), measured(0, 4, 2, roll=0.3, pitch=0.2, yaw=0.1)]
    for number, text in enumerate(texts):
        (folder / "oxts" / "data" / f"{number:010d}.txt").write_text(text)
    for name, text in (("cam_to_cam", CAMERAS), ("imu_to_velo", UNIT), ("velo_to_cam", SCANNER)):
        (folder.parent / f"calib_{name}.txt").write_text(text)
    return folder


def test_poses_of_the_cameras(drive):
    """Camera 2 is 0.06 m to the left of camera 0, because P_rect_02 has +6 / 100."""
    scan = read_scan(drive)
    assert not scan.diagnostics
    assert scan.up.source == "layout kitti: z up"
    first, second, _ = (frame.world_from_camera for frame in scan.frames)
    # When facing east, left is north: 1 + 0.3 m in front of the unit, 0.5 m above.
    np.testing.assert_allclose(first[:3, 3], (1.3, 0.06, 0.5), atol=1e-6)
    # Right is south, down is down, forward is east.
    np.testing.assert_allclose(first[:3, :3].T, [(0, -1, 0), (0, 0, -1), (1, 0, 0)], atol=1e-12)
    # 3 m to the east and rotated to the left, the car faces north: left is west.
    np.testing.assert_allclose(second[:3, 3], (3 - 0.06, 1.3, 0.5), atol=1e-5)
    np.testing.assert_allclose(second[:3, :3].T, [(1, 0, 0), (0, 0, -1), (0, 1, 0)], atol=1e-12)


def test_a_known_point(drive, tiny):
    """A point 10 m in front of the second camera, 1 m to its left, at the height of its axis."""
    second = read_scan(drive).frames[1]
    point = (3 - 0.06 - 1, 1.3 + 10, 0.5)
    seen = tiny.pixel(point, np.linalg.inv(second.world_from_camera), second.camera)
    np.testing.assert_allclose(seen, (16 - 10, 12), atol=1e-3)


def test_roll_comes_before_pitch_before_yaw(drive):
    third = read_scan(drive).frames[2].world_from_camera
    sin, cos = np.sin, np.cos
    # The forward axis of unit and camera only depends on yaw and pitch.
    np.testing.assert_allclose(
        third[:3, 2], (cos(0.1) * cos(0.2), sin(0.1) * cos(0.2), -sin(0.2)), atol=1e-12
    )
    # The left axis of the unit rises with roll, by less if the unit is pitched.
    np.testing.assert_allclose(-third[2, 0], cos(0.2) * sin(0.3), atol=1e-12)
    # The unit is behind, below and to the right of camera 2, 4 m to the north and 2 m up.
    np.testing.assert_allclose((third @ (0.06, 0.5, -1.3, 1))[:3], (0, 4, 2), atol=1e-5)


def test_the_rectification_turns_the_camera(drive):
    calib = drive.parent / "calib_cam_to_cam.txt"
    # Rectification rotates camera 0 by 90° about its axis, so right becomes down.
    calib.write_text(CAMERAS.replace("R_rect_00: 1 0 0 0 1 0 0 0 1", "R_rect_00: 0 -1 0 1 0 0 0 0 1"))
    first = read_scan(drive).frames[0].world_from_camera
    np.testing.assert_allclose(first[:3, :3].T, [(0, 0, 1), (0, -1, 0), (1, 0, 0)], atol=1e-12)


def test_a_file_that_is_missing_costs_its_frame(drive):
    (drive / "oxts" / "data" / "0000000001.txt").unlink()
    scan = read_scan(drive)
    assert [frame.name for frame in scan.frames] == ["0000000000", "0000000002"]
    assert [one.name for one in scan.skipped_frames] == ["0000000001"]


def test_a_trajectory_that_is_named_wins(drive):
    rows = "".join(f"1 0 0 {n} 0 1 0 0 0 0 1 0\n" for n in range(3))
    (drive / "mine.txt").write_text(rows)
    scan = read_scan(drive, ScanParams(poses="mine.txt"))
    np.testing.assert_allclose(scan.frames[2].world_from_camera[:3, 3], (2 - 0.06, 0, 0))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("calib_imu_to_velo.txt", "no poses: oxts/data/ exists, but calib_imu_to_velo"),
        ("calib_velo_to_cam.txt", "no poses: oxts/data/ exists, but calib_velo_to_cam"),
    ],
)
def test_calibrations_that_are_missing(drive, name, words):
    (drive.parent / name).unlink()
    with pytest.raises(InputError, match=words):
        read_scan(drive)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("../calib_imu_to_velo.txt", "R: 1 0\nT: 0 0 0\n", "R must be 9 numbers"),
        ("../calib_imu_to_velo.txt", "T: 0 0 0\n", "rows `R"),
        ("../calib_velo_to_cam.txt", UNIT.replace("R: 1", "R: 2"), "not a rotation"),
        ("../calib_velo_to_cam.txt", UNIT.replace("-1 0 -0.5", "nan nan nan"), "not finite"),
        ("../calib_cam_to_cam.txt", CAMERAS.replace("R_rect_00", "R_rect_01"), "has no R_rect_00"),
        ("oxts/data/0000000001.txt", "60 8 100\n", "six numbers"),
        ("oxts/data/0000000001.txt", "nan 8 100 0 0 0\n", "six numbers"),
        ("oxts/data/0000000001.txt", "90 8 100 0 0 0\n", "latitude of 90"),
    ],
)
def test_damaged_files_are_reported(drive, name, text, words):
    (drive / name).write_text(text)
    with pytest.raises(InputError, match=words):
        read_scan(drive)
