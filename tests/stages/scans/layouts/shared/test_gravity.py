"""The up direction of an accelerometer is attached to the frames, independent of their poses."""

import numpy as np
import pytest
from recordings import Reading, Recording, make_transform
from scipy.spatial.transform import Rotation
from tiny_recordings import INTERVAL, LINKS, START, depth_stream, recording, ros_bag

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.scans.transforms.up_direction import find_up_direction

ACCEL = "/device_0/sensor_2/Accel_0/imu/data"
# In the second pose of the tiny world, y of the camera is also y of the world, which points down.
UP = np.array((0.0, -1.0, 0.0))


def readings(up=UP, *, length=9.81, count=12, shake=0.0, **more):
    """Make accelerometer samples over the time of two frames, with a shaking camera."""
    shaken = np.random.default_rng(4).normal(0, max(shake, 1e-12), (count, 3))
    times = np.linspace(START - INTERVAL // 2, START + 2 * INTERVAL, count).astype(int).tolist()
    return [
        Reading(time, length * np.asarray(up) + off, **more) for time, off in zip(times, shaken, strict=True)
    ]


def of_realsense(**more) -> Recording:
    return recording(readings={ACCEL: readings(**more)})


@pytest.mark.parametrize("kind", ["bag", "db3"])
def test_up_is_in_the_axes_of_the_depth_camera(tmp_path, kind, trajectory):
    made = of_realsense(shake=0.3)
    file = made.write(tmp_path / "take.bag") if kind == "bag" else made.write_db3(tmp_path / "take.db3")
    scan = read_scan(file, trajectory)
    assert len(scan.frames) == 2
    for frame in scan.frames:
        assert np.degrees(np.arccos(frame.up @ UP)) < 3
    known = find_up_direction(scan)
    assert known.source == "gravity of the IMU"
    assert known.direction @ UP > np.cos(np.radians(3))


def test_up_is_rotated_by_the_imu_extrinsics(tmp_path):
    # An IMU rolled by 90° relative to the camera: its x axis is the camera's y axis.
    made = of_realsense(up=(-1.0, 0.0, 0.0))
    quarter = tuple(Rotation.from_euler("z", 90, degrees=True).as_quat())
    made.streams = [depth_stream(from_reference=((0, 0, 0), quarter))]
    place = make_transform((0.01, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    made.others[f"{ACCEL.removesuffix('/imu/data')}/tf/1"] = ("geometry_msgs/Transform", place)
    scan = read_scan(made.write(tmp_path / "take.bag"), complete=False)
    np.testing.assert_allclose(scan.frames[0].up, UP, atol=1e-6)


def test_ros_transforms_give_the_imu_extrinsics(tmp_path):
    turn = Rotation.from_euler("xyz", (20, -50, 130), degrees=True)
    made = ros_bag(links=[*LINKS, ("depth_optical", "imu", (0.0, 0.1, 0.0), tuple(turn.as_quat()))])
    made.readings = {"/imu": readings(up=turn.inv().apply(UP)), "/gyro": readings(up=(1, 0, 0))}
    scan = read_scan(made.write(tmp_path / "take.bag"), complete=False)
    np.testing.assert_allclose(scan.frames[0].up, UP, atol=1e-6)
    # The pose of a single frame is the identity.
    assert find_up_direction(scan).source == "gravity of the IMU"


@pytest.mark.parametrize(
    ("made", "words"),
    [
        ({"length": 2.0}, "reads 2 m/s² (median), which is not gravity"),
        ({"variance": -1.0}, None),
        ({"up": (np.nan, 0, 0)}, None),
        ({"up": (1e300, 1e300, 0)}, None),
    ],
)
def test_implausible_gravity_is_not_used(tmp_path, made, words):
    scan = read_scan(of_realsense(**made).write(tmp_path / "take.bag"), complete=False)
    assert all(frame.up is None for frame in scan.frames)
    assert [words in text for text in map(str, scan.diagnostics)] == ([True] if words else [])


def test_an_imu_without_extrinsics_is_reported(tmp_path):
    made = ros_bag(links=LINKS)
    made.readings = {"/imu": readings()}
    scan = read_scan(made.write(tmp_path / "take.bag"), complete=False)
    assert scan.frames[0].up is None
    assert any(
        "the recording does not contain the orientation of /imu relative to the camera" in text
        for text in map(str, scan.diagnostics)
    )


def test_a_jolt_is_left_out(tmp_path):
    made = of_realsense()
    half = START + INTERVAL // 2
    jolts = [Reading(START - INTERVAL // 2 + n, (30.0, 0.0, 0.0)) for n in range(5)]
    made.readings = {ACCEL: jolts + [one for one in readings(count=40) if one.time > half]}
    scan = read_scan(made.write(tmp_path / "take.bag"), complete=False)
    assert all(frame.up is None or frame.up @ UP > 0.999 for frame in scan.frames)
    assert scan.frames[1].up is not None


def test_poses_contradicting_gravity_are_reported(tmp_path, trajectory):
    scan = read_scan(of_realsense().write(tmp_path / "take.bag"), trajectory)
    second = scan.frames[1]
    second.world_from_camera[:3, :3] = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    with collecting() as found:
        assert find_up_direction(scan) is None
    assert "is inconsistent with the poses" in str(found[0])


def test_poses_from_a_file_are_in_another_world_but_gravity_is_measured(tmp_path, trajectory):
    assert trajectory.poses is not None
    scan = read_scan(of_realsense().write(tmp_path / "take.bag"), ScanParams(poses=trajectory.poses))
    assert scan.up is None
    assert find_up_direction(scan) is not None
