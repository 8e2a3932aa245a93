from dataclasses import replace

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_color, read_right
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

FIRST, SECOND = 1403715273262142976, 1403715273462142976
SENSOR = """%YAML:1.0
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [0.0, 0.0, 1.0, {x},
         -1.0, 0.0, 0.0, {y},
         0.0, -1.0, 0.0, 0.0,
         0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [32, 24]
camera_model: pinhole
intrinsics: [100.0, 100.0, 16.0, 12.0] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.1, 0.01, 0.001, -0.002]
"""


@pytest.fixture
def scan_folder(tmp_path, tiny):
    # The body has x forward, y left, z up; the left camera is 0.1 m ahead, the right camera 0.5 m to the
    # side.
    for name, x, y in (("cam0", 0.1, 0.0), ("cam1", 0.1, -0.5)):
        folder = tmp_path / "mav0" / name
        for time in (FIRST, SECOND):
            tiny.color(folder / "data" / f"{time}.png")
        (folder / "sensor.yaml").write_text(SENSOR.format(x=x, y=y))
        (folder / "data.csv").write_text(
            f"#timestamp [ns],filename\n{FIRST},{FIRST}.png\n{SECOND},{SECOND}.png\n"
        )
    truth = tmp_path / "mav0" / "state_groundtruth_estimate0"
    truth.mkdir()
    # The first pose is the identity; the second is at (1, 2, 3), rotated by 90° about z (w x y z).
    half = 0.5**0.5
    (truth / "data.csv").write_text(
        "#timestamp, p_RS_R_x [m], ...\n"
        f"{FIRST},0,0,0,1,0,0,0,0,0,0\n"
        f"{SECOND},1,2,3,{half},0,0,{half},0,0,0\n"
    )
    return tmp_path


def test_known_points_fall_on_known_pixels_of_both_images(scan_folder, tiny):
    scan = read_scan(scan_folder)
    assert (scan.layout, scan.rig.is_rectified) == ("euroc", False)
    assert [frame.timestamp for frame in scan.frames] == [FIRST, SECOND]
    assert scan.rig.baseline == pytest.approx(0.5)
    assert scan.rig.left.distortion == (-0.1, 0.01, 0.001, -0.002)
    # The camera point (0.2, 0.1, 2) is the body point (2 + 0.1, -0.2, -0.1).
    known = ((2.1, -0.2, -0.1), (1 + 0.2, 2 + 2.1, 3 - 0.1))
    for frame, point in zip(scan.frames, known, strict=True):
        camera_from_world = np.linalg.inv(frame.world_from_camera)
        np.testing.assert_allclose(tiny.pixel(point, camera_from_world, frame.camera), (26, 17))
        right = tiny.pixel(point, scan.rig.right_from_left @ camera_from_world, scan.rig.right)
        np.testing.assert_allclose(right, (1, 17), atol=1e-9)


def test_the_mav0_folder_itself_is_a_scan(scan_folder):
    assert len(read_scan(scan_folder / "mav0").frames) == 2


def test_unequal_counts_pair_by_time(scan_folder):
    (scan_folder / "mav0" / "cam1" / "data.csv").write_text(f"#t,f\n{SECOND},{SECOND}.png\n")
    scan = read_scan(scan_folder)
    assert [frame.timestamp for frame in scan.frames] == [SECOND]
    assert [one.name for one in scan.skipped_frames] == [str(FIRST)]


def test_a_frame_far_from_any_pose_is_skipped(scan_folder):
    path = scan_folder / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    path.write_text("\n".join(path.read_text().splitlines()[:2]))
    scan = read_scan(scan_folder)
    assert [frame.timestamp for frame in scan.frames] == [FIRST]
    assert "no pose" in scan.skipped_frames[0].reason


def test_no_ground_truth(scan_folder):
    (scan_folder / "mav0" / "state_groundtruth_estimate0" / "data.csv").unlink()
    with pytest.raises(InputError, match="no poses: state_groundtruth_estimate0"):
        read_scan(scan_folder)


def test_no_second_camera(scan_folder):
    (scan_folder / "mav0" / "cam1" / "data.csv").unlink()
    with pytest.raises(InputError, match=r"cam1/data\.csv"):
        read_scan(scan_folder)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("radial-tangential", "omnidirectional", "lens model omnidirectional is not supported"),
        ("camera_model: pinhole", "camera_model: omni", "camera_model omni is not supported"),
        ("[32, 24]", "[640, 400]", "640"),
        ("1.0, 0.1", "5.0, 0.1", "T_BS.*not rigid"),
        ("[100.0, 100.0, 16.0, 12.0]", "[100.0]", "intrinsics must be 4"),
        ("rate_hz: 20", "rate_hz: [", "does not parse"),
        ("T_BS", "T_XX", "T_BS is not a 4x4"),
    ],
)
def test_damaged_sensor_files_are_reported(scan_folder, old, new, message):
    path = scan_folder / "mav0" / "cam0" / "sensor.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=message):
        read_scan(scan_folder)


def test_vicon_room_excerpt(shared_data):
    scan = read_scan(shared_data / "stereo" / "euroc_V1_01_easy_static")
    assert (scan.layout, len(scan.frames)) == ("euroc", 10)
    assert scan.rig.baseline == pytest.approx(0.1101, abs=1e-4)
    # The right camera is on the right, and both face the same direction.
    assert scan.rig.right_from_left[0, 3] == pytest.approx(-0.11, abs=0.001)
    assert np.trace(scan.rig.right_from_left[:3, :3]) > 2.99
    # The drone is level in a room with z up: the camera faces sideways with its y axis down.
    assert scan.frames[0].world_from_camera[2, 1] < -0.9


CHAIN = """cam0:
  T_cam_imu:
  - [0.0, -1.0, 0.0, 0.0]
  - [0.0, 0.0, -1.0, 0.0]
  - [1.0, 0.0, 0.0, -0.1]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]
  distortion_model: equidistant
  intrinsics: [100.0, 100.0, 16.0, 12.0]
  resolution: [32, 24]
cam1:
  T_cam_imu:
  - [0.0, -1.0, 0.0, -0.5]
  - [0.0, 0.0, -1.0, 0.0]
  - [1.0, 0.0, 0.0, -0.1]
  - [0.0, 0.0, 0.0, 1.0]
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.5]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]
  distortion_model: equidistant
  intrinsics: [100.0, 100.0, 16.0, 12.0]
  resolution: [32, 24]
"""


@pytest.fixture
def tum_vi(scan_folder):
    for name in ("cam0", "cam1"):
        (scan_folder / "mav0" / name / "sensor.yaml").unlink()
        for path in (scan_folder / "mav0" / name / "data").iterdir():
            assert cv2.imwrite(str(path), np.full((24, 32), 0x1234, np.uint16))
    (scan_folder / "mav0" / "state_groundtruth_estimate0").rename(scan_folder / "mav0" / "mocap0")
    (scan_folder / "dso").mkdir()
    (scan_folder / "dso" / "camchain.yaml").write_text(CHAIN)
    return scan_folder


@pytest.mark.parametrize("chain", [CHAIN, CHAIN.replace("T_cn_cnm1", "left_out")])
def test_tum_vi_has_fisheye_cameras_and_wide_images(tum_vi, chain):
    (tum_vi / "dso" / "camchain.yaml").write_text(chain)
    scan = read_scan(tum_vi)
    assert scan.layout == "euroc"
    assert scan.rig.left.fisheye
    assert not scan.rig.is_rectified
    np.testing.assert_allclose(scan.rig.right_from_left[:3, 3], (-0.5, 0, 0), atol=1e-12)
    # The same points as with sensor.yaml; a fisheye projects the point 0.2 m right and 0.1 m down at 2 m
    # farther inside.
    known = ((2.1, -0.2, -0.1), (1 + 0.2, 2 + 2.1, 3 - 0.1))
    for frame, point in zip(scan.frames, known, strict=True):
        camera_from_world = np.linalg.inv(frame.world_from_camera)
        np.testing.assert_allclose((camera_from_world @ (*point, 1))[:3], (0.2, 0.1, 2), atol=1e-9)
        assert read_color(frame)[5, 5].tolist() == read_right(frame)[5, 5].tolist() == [0x12] * 3


def test_a_narrow_image_among_wide_ones_is_reported(tum_vi):
    cv2.imwrite(str(tum_vi / "mav0" / "cam0" / "data" / f"{SECOND}.png"), np.zeros((24, 32), np.uint8))
    with pytest.raises(InputError, match=r"16-bit greyscale image is expected"):
        read_color(read_scan(tum_vi).frames[1])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("T_cam_imu", "T_imu", r"camchain\.yaml.*T_cam_imu"),
        ("equidistant", "omni", r"camchain\.yaml.*lens model omni"),
        ("pinhole", "omni", r"camchain\.yaml.*camera_model omni"),
        ("coeffs: [0.0, ", "coeffs: [", r"camchain\.yaml.*4 distortion coefficients, not 3"),
        ("[32, 24]", "[64, 40]", r"camchain\.yaml.*aspect ratio differs"),
    ],
)
def test_a_wrong_chain_is_reported(tum_vi, old, new, message):
    (tum_vi / "dso" / "camchain.yaml").write_text(CHAIN.replace(old, new))
    with pytest.raises(InputError, match=message):
        read_scan(tum_vi)


def test_a_stated_camera_wins_over_the_chain(tum_vi):
    rig = read_scan(tum_vi, ScanParams(intrinsics="90,90,15,11", baseline=0.25)).rig
    assert (rig.left.fx, rig.right.cx, rig.left.fisheye) == (90, 15, False)
    assert rig.baseline == pytest.approx(0.25)


# -- gravity ---------------------------------------------------------------------------------------------

IMU = """sensor_type: imu
T_BS:
  cols: 4
  rows: 4
  data: [0.0, 0.0, 1.0, 0.0,
         0.0, 1.0, 0.0, 0.0,
         -1.0, 0.0, 0.0, 0.0,
         0.0, 0.0, 0.0, 1.0]
"""


def write_readings(folder, reading=(-9.7, 0.3, 0.1)):
    """Make samples of an IMU whose x axis points down in the body frame, where z is up."""
    (folder / "mav0" / "imu0").mkdir()
    (folder / "mav0" / "imu0" / "sensor.yaml").write_text(IMU)
    values = ",".join(map(str, reading))
    rows = [f"{time},0.1,0.2,0.3,{values}" for time in range(FIRST - 10_000_000, SECOND, 5_000_000)]
    (folder / "mav0" / "imu0" / "data.csv").write_text("#timestamp [ns],w_RS_S_x,...\n" + "\n".join(rows))


def test_the_accelerometer_gives_up_for_user_poses(scan_folder):
    write_readings(scan_folder)
    scan = read_scan(scan_folder)
    assert scan.up.source == "layout euroc: z up"
    # The cameras are level, so y is down.
    for frame in scan.frames:
        assert frame.up @ (0, -1, 0) > np.cos(np.radians(3))
    for path in (scan_folder / "mav0" / "state_groundtruth_estimate0").iterdir():
        path.unlink()
    bare = read_scan(scan_folder, complete=False)
    assert bare.up is None
    assert bare.frames[0].up @ (0, -1, 0) > np.cos(np.radians(3))


def test_implausible_gravity_is_reported_and_not_used(scan_folder):
    write_readings(scan_folder, (0.01, 0.02, 0.0))
    scan = read_scan(scan_folder)
    assert any("imu0 reads" in text and "not gravity" in text for text in map(str, scan.diagnostics))


def test_a_damaged_line_of_readings_is_named(scan_folder):
    write_readings(scan_folder)
    path = scan_folder / "mav0" / "imu0" / "data.csv"
    path.write_text(path.read_text() + "\n12,0.1,none\n")
    with pytest.raises(
        InputError, match=r"imu0/data\.csv: line \d+ is not a timestamp \(ns\), three angular rates"
    ):
        read_scan(scan_folder)


def test_the_excerpt_without_readings_takes_up_from_its_poses(shared_data):
    scan = read_scan(shared_data / "stereo/euroc_V1_01_easy_static")
    for frame in scan.frames:
        np.testing.assert_allclose(frame.world_from_camera[:3, :3] @ frame.up, (0, 0, 1), atol=1e-9)


def test_poses_of_another_clock_are_assigned_in_order(scan_folder, tiny):
    turned = " ".join(map(str, tiny.second_quaternion))
    (scan_folder / "mine.tum").write_text(f"500.0 0 0 0 0 0 0 1\n500.5 1 2 3 {turned}\n")
    named = ScanParams(poses="mine.tum")
    with pytest.raises(InputError, match=r"none of its 2 poses .* as many poses as frames: scan\.poses"):
        read_scan(scan_folder, named)
    scan = read_scan(scan_folder, replace(named, poses_by_order=True))
    # Like EuRoC's trajectories, these are poses of the body; the camera is 0.1 m ahead.
    body_from_camera = np.array([[0, 0, 1, 0.1], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    for frame, body in zip(scan.frames, (tiny.identity, tiny.second), strict=True):
        np.testing.assert_allclose(frame.world_from_camera, body @ body_from_camera, atol=1e-9)


@pytest.mark.parametrize("name", ["../../../../etc/passwd", "/etc/passwd", "a\0b.png"])
def test_lists_do_not_lead_outside(scan_folder, name):
    (scan_folder / "mav0" / "cam0" / "data.csv").write_text(f"{FIRST},{name}\n")
    with pytest.raises(InputError, match=r"line 1: .* is not a path inside the folder"):
        read_scan(scan_folder)


@pytest.mark.parametrize("text", ["", "# nothing\n"])
def test_an_empty_trajectory_is_reported(scan_folder, text):
    (scan_folder / "mav0" / "state_groundtruth_estimate0" / "data.csv").write_text(text)
    with pytest.raises(InputError, match="the trajectory file holds no poses"):
        read_scan(scan_folder)


def test_a_camera_without_its_sensor_file_is_reported(scan_folder):
    (scan_folder / "mav0" / "cam0" / "sensor.yaml").unlink()
    with pytest.raises(InputError, match=r"cam0/sensor\.yaml: the file cannot be read"):
        read_scan(scan_folder)
