"""Stereo recordings without depth, and their rig from camera_info."""

import dataclasses

import numpy as np
import pytest
from recordings import Image, Recording, Stream, make_header, make_message, make_transform
from scipy.spatial.transform import Rotation
from tiny_recordings import INTERVAL, START, list_warnings

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_color, read_right
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

BASELINE = 0.05


def side(name, topic, grey, **changes):
    images = [
        Image(START + n * INTERVAL, np.full((24, 32), grey + n, np.uint8), "mono8", unit=None, frame=name)
        for n in range(2)
    ]
    stream = Stream(
        name, images, (100, 100, 16, 12), (32, 24), None, "plumb_bob", topic=topic, info="/camera_info"
    )
    return dataclasses.replace(stream, **changes)


def projection(baseline):
    return (90, 0, 15, -90 * baseline, 0, 90, 11, 0, 0, 0, 1, 0)


def pair(tmp_path, left, right, names=("/cam/left", "/cam/right"), topic="/image_rect", **others):
    streams = [side(names[1], topic, 70, **right), side(names[0], topic, 20, **left)]
    return Recording(streams, units=(), others=others).write_ros2(tmp_path / "take", "mcap")


@pytest.mark.parametrize("names", [("/cam/left", "/cam/right"), ("/cam/infra1", "/cam/infra2")])
def test_a_rectified_pair(tmp_path, names):
    file = pair(tmp_path, {"projection": projection(0)}, {"projection": projection(BASELINE)}, names)
    scan = read_scan(file, complete=False)
    assert scan.is_stereo
    assert not list_warnings(scan)
    assert scan.rig.is_rectified
    np.testing.assert_allclose(scan.rig.right_from_left[:3, 3], (-BASELINE, 0, 0))
    assert (scan.rig.left.fx, scan.rig.left.cx) == (90, 15)
    assert [read_color(one)[0, 0, 0] for one in scan.frames] == [20, 21]
    assert [read_right(one)[0, 0, 0] for one in scan.frames] == [70, 71]
    assert [one.timestamp for one in scan.frames] == [START, START + INTERVAL]


def test_a_pair_as_it_left_the_cameras(tmp_path):
    # Rectification rotates each camera: a point x of the left camera is at R_right^T (R_left x - baseline) in
    # the right camera.
    turns = [Rotation.from_rotvec((0, 0.02, 0)).as_matrix(), Rotation.from_rotvec((0.01, 0, 0)).as_matrix()]
    bent = (0.1, 0, 0, 0, 0)
    said = [
        {"rectification": turn.ravel(), "projection": projection(far), "distortion": bent}
        for turn, far in zip(turns, (0, BASELINE), strict=True)
    ]
    scan = read_scan(pair(tmp_path, *said, topic="/image_raw"), complete=False)
    point = np.array((0.2, 0.1, 2.0))
    expected = turns[1].T @ (turns[0] @ point - (BASELINE, 0, 0))
    np.testing.assert_allclose((scan.rig.right_from_left @ (*point, 1))[:3], expected, atol=1e-12)
    assert not scan.rig.is_rectified
    assert (scan.rig.left.fx, scan.rig.left.distortion) == (100, bent)


def test_a_fisheye_pair(tmp_path):
    said = {"model": "equidistant", "distortion": (0.1, 0, 0, 0)}
    file = pair(
        tmp_path,
        {**said, "projection": projection(0)},
        {**said, "projection": projection(BASELINE)},
        topic="/image_raw",
    )
    rig = read_scan(file, complete=False).rig
    assert (rig.left.fisheye, rig.right.fisheye, rig.baseline) == (True, True, pytest.approx(BASELINE))


def test_a_baseline_from_ros_transforms(tmp_path):
    place = make_message("geometry_msgs/Transform", **make_transform((BASELINE, 0, 0), (0, 0, 0, 1)))
    step = make_message(
        "geometry_msgs/TransformStamped",
        header=make_header(0, "/cam/infra1"),
        child_frame_id="/cam/infra2",
        transform=place,
    )
    tree = {"/tf_static": ("tf2_msgs/TFMessage", {"transforms": [step]})}
    names = ("/cam/infra1", "/cam/infra2")
    file = pair(tmp_path, {}, {}, names, "/image_rect_raw", **tree)
    np.testing.assert_allclose(
        read_scan(file, complete=False).rig.right_from_left[:3, 3], (-BASELINE, 0, 0), atol=1e-12
    )


def test_a_missing_baseline(tmp_path):
    file = pair(tmp_path, {}, {})
    with pytest.raises(InputError, match=r"the baseline between /cam/left/.* scan\.baseline"):
        read_scan(file, complete=False)
    rig = read_scan(file, ScanParams(baseline=0.07), complete=False).rig
    np.testing.assert_allclose(rig.right_from_left[:3, 3], (-0.07, 0, 0))


def test_given_parameters_win(tmp_path):
    file = pair(tmp_path, {"intrinsics": None}, {"intrinsics": None})
    with pytest.raises(InputError, match=r"the topic /cam/left/camera_info.*scan\.intrinsics"):
        read_scan(file, complete=False)
    rig = read_scan(file, ScanParams(intrinsics="80,81,15,11", baseline=0.07), complete=False).rig
    assert (rig.left.fx, rig.right.fy, rig.baseline, rig.is_rectified) == (80, 81, 0.07, True)
    (file.parent / "mine.json").write_text('{"fx": 70, "fy": 70, "cx": 15, "cy": 11, "baseline": 0.06}')
    rig = read_scan(file, ScanParams(calibration="mine.json"), complete=False).rig
    assert (rig.left.fx, rig.baseline) == (70, 0.06)
