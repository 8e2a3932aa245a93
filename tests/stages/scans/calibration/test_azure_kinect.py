"""Factory calibration of an Azure Kinect: the same rays for every camera mode."""

import json
import math

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.calibration.azure_kinect import read_color_from_depth
from scanloom.stages.scans.calibration.camera_files import read_camera
from scanloom.stages.scans.reader import read_scan

# Values relative to the sensor size, with a separate lens for each camera.
DEPTH = [0.51, 0.515, 0.49, 0.491, 0.5, -0.02, -0.003, 0.9, 0.09, -0.01, 0, 0, -7e-5, 2e-5]
COLOR = [0.499, 0.504, 0.478, 0.6375, 0.35, -2.4, 1.4, 0.23, -2.2, 1.3, 0, 0, -1.3e-4, 4e-4]
TILT = math.radians(5.5)
TURN = [1, 0, 0, 0, math.cos(TILT), math.sin(TILT), 0, -math.sin(TILT), math.cos(TILT)]


def camera(location, parameters, turn=(1, 0, 0, 0, 1, 0, 0, 0, 1), shift=(0, 0, 0)):
    return {
        "Intrinsics": {"ModelParameterCount": 14, "ModelParameters": parameters},
        "Location": f"CALIBRATION_CameraLocation{location}",
        "Rt": {"Rotation": list(turn), "Translation": list(shift)},
    }


def document(*cameras):
    cameras = cameras or (camera("D0", DEPTH), camera("PV0", COLOR, TURN, (-0.032, -0.002, 0.004)))
    return {"CalibrationInformation": {"Cameras": list(cameras), "InertialSensors": []}}


@pytest.fixture
def path(tmp_path):
    (tmp_path / "calibration.json").write_text(json.dumps(document()))
    return tmp_path / "calibration.json"


def on_sensor(path, width, height, corner, side):
    """Project a fixed ray to relative sensor coordinates by the calibration for an image size."""
    found = read_camera(path, width, height)
    ray = np.array([[[0.11, -0.07, 1.0]]])
    seen = cv2.projectPoints(ray, np.zeros(3), np.zeros(3), found.matrix, np.array(found.distortion))[0]
    # Pixel centres are integers in images; sensor coordinates start at 0.
    return (seen.ravel() + 0.5 + corner) / side


def test_a_ray_has_the_same_sensor_position_in_every_mode(path):
    wide = on_sensor(path, 1024, 1024, (0, 0), (1024, 1024))
    for size, corner, side in (
        ((512, 512), (0, 0), (512, 512)),
        ((640, 576), (192, 180), (1024, 1024)),
        ((320, 288), (96, 90), (512, 512)),
    ):
        np.testing.assert_allclose(on_sensor(path, *size, corner, side), wide, atol=1e-9)
    tall = on_sensor(path, 4096, 3072, (0, 0), (4096, 3072))
    for width in (1280, 1920, 2560, 3840):
        cut = (0, width * 3 / 8 - width * 9 / 32)
        found = on_sensor(path, width, width * 9 // 16, cut, (width, width * 3 / 4))
        np.testing.assert_allclose(found, tall, atol=1e-9)
    # Width and height differ, and each camera has separate values.
    assert np.abs(tall - wide).min() > 1e-3


def test_relative_values_and_lenses_differ_per_camera(path):
    depth = read_camera(path, 640, 576)
    assert (depth.cx, depth.cy) == pytest.approx((0.51 * 1024 - 192.5, 0.515 * 1024 - 180.5))
    assert (depth.fx, depth.fy) == pytest.approx((0.49 * 1024, 0.491 * 1024))
    # OpenCV's order: k1 k2 p1 p2 k3 k4 k5 k6.
    assert depth.distortion == (0.5, -0.02, 2e-5, -7e-5, -0.003, 0.9, 0.09, -0.01)


def test_depth_and_colour_of_a_recording_have_a_camera_each(tmp_path, path, tiny, matrix_text):
    for name, size in (("color", (720, 1280, 3)), ("depth", (576, 640))):
        (tmp_path / name).mkdir()
        kind = np.uint8 if len(size) == 3 else np.uint16
        for number in range(2):
            assert cv2.imwrite(str(tmp_path / name / f"{number}.png"), np.full(size, 200, kind))
    (tmp_path / "trajectory.log").write_text(
        "0 0 1\n" + matrix_text(tiny.identity) + "1 1 2\n" + matrix_text(tiny.second)
    )
    scan = read_scan(tmp_path)
    frame = scan.frames[0]
    assert frame.camera == read_camera(path, 640, 576)
    assert frame.color_camera == read_camera(path, 1280, 720)
    expected = np.eye(4)
    expected[:3, :3], expected[:3, 3] = np.reshape(TURN, (3, 3)), (-0.032, -0.002, 0.004)
    np.testing.assert_allclose(frame.color_from_depth, expected, atol=1e-12)


def test_depth_brought_to_colour_has_colour_s_camera_and_place(path):
    camera = read_camera(path, 1280, 720)
    assert camera.fx == pytest.approx(0.478 * 1280)
    assert read_color_from_depth(path, camera) is None


@pytest.mark.parametrize(
    ("content", "size", "message"),
    [
        (document(), (800, 800), "has no images of 800×800"),
        (document(camera("D0", DEPTH)), (1280, 720), "has no camera CALIBRATION_CameraLocationPV0"),
        (document(camera("D0", DEPTH[:13])), (640, 576), "has 13 ModelParameters; 14"),
        (document(camera("D0", "no")), (640, 576), "CALIBRATION_CameraLocationD0"),
        ({"CalibrationInformation": {"Cameras": 7}}, (640, 576), "has no camera"),
        (document({"Location": "CALIBRATION_CameraLocationD0"}), (640, 576), "has 0 ModelParameters"),
    ],
)
def test_invalid_calibrations_are_one_sentence(path, content, size, message):
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=message):
        read_camera(path, *size)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"Rt": None}, "has no extrinsics"),
        ({"Rt": {"Rotation": TURN, "Translation": [0, 0]}}, "must be a rotation of 9 numbers"),
        ({"Rt": {"Rotation": [2 * x for x in TURN], "Translation": [0, 0, 0]}}, "not rigid"),
    ],
)
def test_a_colour_camera_without_a_place_is_refused(path, changes, message):
    depth = read_camera(path, 640, 576)
    path.write_text(json.dumps(document(camera("D0", DEPTH), camera("PV0", COLOR) | changes)))
    with pytest.raises(InputError, match=message):
        read_color_from_depth(path, depth)
