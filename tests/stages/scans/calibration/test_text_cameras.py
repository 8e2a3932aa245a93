"""Cameras from text with names and numbers, from the output of calibrators, and from NumPy arrays."""

import numpy as np
import pytest

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.documents import read_document
from scanloom.stages.scans.calibration.camera_files import read_camera, read_depth_scale
from scanloom.stages.scans.calibration.rig_calibration import read_rig

K = [[100, 0, 16], [0, 110, 12], [0, 0, 1]]

RS_ENUMERATE = """
 Intrinsic of "Depth" / 64x48 / {Z16}
  Width:       64
  Height:      48
  PPX:         32.5
  PPY:         24.25
  Fx:          90.5
  Fy:          91
  Distortion:  Brown Conrady
  Coeffs:      0  0  0  0  0
  FOV (deg):   79.5 x 64

 Intrinsic of "Color" / 64x48 / {YUYV/RGB8}
  Width:       64
  Height:      48
  PPX:         30.5
  PPY:         22.5
  Fx:          100.5
  Fy:          101
  Distortion:  Inverse Brown Conrady
  Coeffs:      0.1  -0.2  0  0  0

 Intrinsic of "Color" / 128x72 / {YUYV/RGB8}
  Width:       128
  Height:      72
  PPX:         64
  PPY:         36
  Fx:          200
  Fy:          201
  Distortion:  Inverse Brown Conrady
  Coeffs:      0  0  0  0  0

 Extrinsic from "Depth"  To  "Color" :
 Rotation Matrix:
   0.99  0  0
"""


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("camera.txt", "fx: 90.5\nfy: 91\ncx: 30.5\ncy: 22.5\n"),
        ("camera.txt", "# of the depth\nFx = 90.5\nFy = 91\nPPX (cx) = 30.5\nPPY (cy) = 22.5\nnote: none\n"),
        ("camera.csv", "fx,90.5\nfy,91\ncx,30.5\ncy,22.5\n"),
        ("camera.ini", "[depth]\nffx=90.5\nffy=91\ncx=30.5\ncy=22.5\n"),
        ("camera.txt", "fx 90.5\nfy 91\ncx 30.5\ncy 22.5\n"),
        ("camera.txt", "width: 128\nheight: 96\nfx: 181\nfy: 182\ncx: 61.5\ncy: 45.5\n"),
    ],
)
def test_a_text_of_names_and_numbers(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    with collecting() as told:
        camera = read_camera(tmp_path / name, 64, 48)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (90.5, 91, 30.5, 22.5)
    assert [one.code for one in told] == ["camera.calibration-scaled"] * ("width: 128" in text)


def test_a_text_may_state_a_baseline_and_a_unit_of_depth(tmp_path):
    (tmp_path / "pair.txt").write_text("fx: 90.5\nfy: 90.5\ncx: 30.5\ncy: 22.5\nbaseline: 0.12\n")
    assert read_rig(tmp_path / "pair.txt", 64, 48).baseline == 0.12
    (tmp_path / "depth.txt").write_text("fx: 90.5\nfy: 91\ncx: 30.5\ncy: 22.5\ndepth_scale: 5000\n")
    assert read_depth_scale(tmp_path / "depth.txt") == 5000


def test_output_of_the_realsense_tool(tmp_path):
    file = tmp_path / "rs-enumerate-devices.txt"
    file.write_text(RS_ENUMERATE)
    with collecting() as heard:
        color = read_camera(file, 64, 48)
    assert (color.fx, color.cx, color.distortion[:2]) == (100.5, 30.5, (0.1, -0.2))
    assert any("is used" in text for text in map(str, heard))
    with collecting():
        large = read_camera(file, 128, 72)
    assert (large.fx, large.distortion) == (200, ())


def test_a_printed_fisheye_stays_one(tmp_path):
    lens = "  Fx: 100\n  Fy: 101\n  PPX: 30\n  PPY: 22\n  Distortion: {}\n  Coeffs: 0.1 0.2 0.3 0.4 0\n"
    (tmp_path / "rs.txt").write_text(lens.format("Kannala Brandt4"))
    camera = read_camera(tmp_path / "rs.txt", 64, 48)
    assert (camera.fisheye, camera.distortion) == (True, (0.1, 0.2, 0.3, 0.4))
    (tmp_path / "rs.txt").write_text(lens.format("F-Theta"))
    with pytest.raises(InputError, match="the lens model f-theta is not supported"):
        read_camera(tmp_path / "rs.txt", 64, 48)


@pytest.mark.parametrize(
    "text", ["fx: much\nfy: 3\n", "[rgb]\nfx=1\n[ir]\nfy=2\n", "some words\n", "[image]\nwidth\nten\n"]
)
def test_a_text_without_a_camera_is_reported(tmp_path, text):
    (tmp_path / "camera.txt").write_text(text)
    with pytest.raises(InputError, match="a camera matrix of 3 rows of 3 numbers is expected"):
        read_camera(tmp_path / "camera.txt", 64, 48)


def test_printed_output_of_the_ros_calibrator_equals_its_yaml(shared_data):
    files = shared_data / "real" / "calibrations"
    sides = {side: read_document(files / f"ros_{side}.yaml") for side in ("left", "right")}
    with collecting() as found:
        written = read_rig(files / "ros_right.yaml", 1280, 1024, document=sides)
        printed = read_rig(files / "ros_ost.txt", 1280, 1024)
    assert all("image_raw" in str(one) for one in found)
    assert (printed.left, printed.right) == (written.left, written.right)
    assert (printed.right_from_left == written.right_from_left).all()


def test_a_printed_calibration_of_one_camera(tmp_path):
    size, rows = "[image]\n\nwidth\n64\n\nheight\n48\n", "90.5 0 30.5\n0 91 22.5\n0 0 1\n"
    text = f"# oST version 5.0 parameters\n\n{size}\n[head]\n\ncamera matrix\n{rows}"
    (tmp_path / "ost.txt").write_text(text + "\ndistortion\n0.1 -0.2 0 0 0\n")
    camera = read_camera(tmp_path / "ost.txt", 64, 48)
    assert (camera.fx, camera.cy, camera.distortion[:2]) == (90.5, 22.5, (0.1, -0.2))
    (tmp_path / "ost.txt").write_text(text.replace("0 0 1", "0 0"))
    with pytest.raises(InputError, match=r"camera matrix must be 3x3|not a matrix of numbers"):
        read_camera(tmp_path / "ost.txt", 64, 48)


@pytest.mark.parametrize("matrix", [np.array(K), np.eye(4), np.eye(3, 4), np.array([100.0, 110, 16, 12])])
def test_a_matrix_as_an_array(tmp_path, matrix):
    if matrix.ndim == 2:
        matrix = matrix.astype(np.float64)
        matrix[:3, :3] = K
    np.save(tmp_path / "K.npy", matrix)
    camera = read_camera(tmp_path / "K.npy", 32, 24)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (100, 110, 16, 12)
    rig = read_rig(tmp_path / "K.npy", 32, 24, baseline=0.2)
    assert (rig.left.fx, rig.baseline) == (100, 0.2)


@pytest.mark.parametrize(
    "array", [np.zeros(5), np.array(["a"] * 9), np.zeros((3, 3), complex), np.zeros((30, 30))]
)
def test_an_array_that_is_not_a_matrix_is_reported(tmp_path, array):
    np.save(tmp_path / "K.npy", array)
    with pytest.raises(InputError, match="a camera matrix of 3 rows of 3 numbers is expected"):
        read_camera(tmp_path / "K.npy", 32, 24)
    (tmp_path / "K.npy").write_bytes(b"\x93NUMPY nothing")
    with pytest.raises(InputError, match=r"K\.npy: the camera matrix cannot be read"):
        read_camera(tmp_path / "K.npy", 32, 24)
