"""Calibrations for another image size are scaled if the aspect ratio agrees, otherwise refused."""

import json

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.calibration.camera_files import read_camera
from scanloom.stages.scans.calibration.rig_calibration import read_rig
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

# For images of double the size; pixel centres are at integers.
LARGE = [[200, 0, 32.5], [0, 200, 24.5], [0, 0, 1]]
SMALL = [[100, 0, 16], [0, 100, 12], [0, 0, 1]]
SIZES = {
    "plain.json": {"K": LARGE, "width": 64, "height": 48},
    "opencv.json": {"camera_matrix": LARGE, "image_width": 64, "image_height": 48},
    "listed.json": {"K": LARGE, "image_size": [64, 48]},
    "open3d.json": {"intrinsic_matrix": np.transpose(LARGE).ravel().tolist(), "width": 64, "height": 48},
    "kalibr.json": {
        "cam0": {"intrinsics": [200, 200, 32.5, 24.5], "resolution": [64, 48], "camera_model": "pinhole"}
    },
    "orb.json": {
        **{f"Camera.{key}": value for key, value in zip(("fx", "fy"), (200, 200), strict=True)},
        "Camera.cx": 32.5,
        "Camera.cy": 24.5,
        "Camera.width": 64,
        "Camera.height": 48,
    },
}


@pytest.mark.parametrize("name", SIZES)
def test_a_camera_for_larger_images_is_scaled_and_reported(tmp_path, name):
    (tmp_path / name).write_text(json.dumps(SIZES[name]))
    with collecting() as told:
        camera = read_camera(tmp_path / name, 32, 24)
    np.testing.assert_allclose(camera.matrix, SMALL)
    said = (
        f"{tmp_path / name}: it is for images of 64×48 px; its camera is scaled to these images of 32×24 px"
    )
    assert [str(one) for one in told] == [said]


RIGS = {
    "opencv.json": {"K1": LARGE, "K2": LARGE, "T": [-0.5, 0, 0], "image_size": [64, 48]},
    "rectified.json": {
        "P1": np.column_stack([LARGE, [0, 0, 0]]).tolist(),
        "P2": np.column_stack([LARGE, [-100, 0, 0]]).tolist(),
        "image_width": 64,
        "image_height": 48,
    },
    "sides.json": {
        **{side: {"K": LARGE, "width": 64, "height": 48} for side in ("left", "right")},
        "baseline": 0.5,
    },
    "kalibr.json": {
        f"cam{k}": {
            "intrinsics": [200, 200, 32.5, 24.5],
            "resolution": [64, 48],
            **({"T_cn_cnm1": [[1, 0, 0, -0.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]} if k else {}),
        }
        for k in (0, 1)
    },
}


@pytest.mark.parametrize("name", RIGS)
def test_a_rig_for_larger_images_is_scaled_and_reported(tmp_path, name):
    (tmp_path / name).write_text(json.dumps(RIGS[name]))
    with collecting() as told:
        rig = read_rig(tmp_path / name, 32, 24)
    np.testing.assert_allclose([rig.left.matrix, rig.right.matrix], [SMALL, SMALL])
    assert rig.baseline == pytest.approx(0.5)
    assert [one.code for one in told] == ["camera.calibration-scaled"]


def test_another_shape_is_refused_in_a_sentence(tmp_path):
    (tmp_path / "rig.json").write_text(json.dumps(RIGS["opencv.json"] | {"image_size": [64, 40]}))
    with pytest.raises(InputError, match=r"of 64×40 px, but these are 32×24 px\. The aspect ratio differs"):
        read_rig(tmp_path / "rig.json", 32, 24)


@pytest.mark.parametrize(("width", "height"), [(1920, 1088), (1080, 1920), (1912, 1080)])
def test_cropped_and_turned_images_are_refused(tmp_path, width, height):
    table = {"fx": 1500, "fy": 1500, "cx": 959, "cy": 539, "width": 1920, "height": 1080}
    (tmp_path / "a.json").write_text(json.dumps(table))
    with pytest.raises(InputError, match="the images were cropped or rotated"):
        read_camera(tmp_path / "a.json", width, height)


def test_swapped_image_sides_are_recognised_by_the_principal_point(tmp_path):
    table = {"K": [[616.7, 0, 324.8], [0, 616.9, 238.0], [0, 0, 1]], "resolution": [480, 640]}
    (tmp_path / "a.json").write_text(json.dumps(table))
    camera = read_camera(tmp_path / "a.json", 640, 480)
    assert (camera.width, camera.height, camera.cx) == (640, 480, 324.8)
    table["K"][0][2], table["K"][1][2] = 238.0, 324.8
    (tmp_path / "a.json").write_text(json.dumps(table))
    with pytest.raises(InputError, match="the images were cropped or rotated"):
        read_camera(tmp_path / "a.json", 640, 480)


def test_a_principal_point_for_another_size_is_reported(tmp_path):
    (tmp_path / "K.txt").write_text("200 0 32.5 0 200 24.5 0 0 1")
    with collecting() as told:
        read_camera(tmp_path / "K.txt", 32, 24)
    (said,) = map(str, told)
    assert "its principal point (32.5, 24.5) is far from the centre of images of 32×24 px" in said
    assert "such as 66×50" in said


@pytest.fixture
def scan_folder(tmp_path, tiny):
    for number in range(2):
        tiny.color(tmp_path / "color" / f"{number}.png")
        tiny.depth(tmp_path / "depth" / f"{number}.png", 1000)
    (tmp_path / "trajectory.txt").write_text(
        "".join(" ".join(map(str, pose.ravel())) + "\n" for pose in (tiny.identity, tiny.second))
    )
    return tmp_path


@pytest.mark.parametrize("name", ["intrinsic.json", "of the camera.json"])
def test_a_scan_is_read_with_the_scaled_camera(scan_folder, tiny, name):
    (scan_folder / name).write_text(json.dumps(SIZES["plain.json"]))
    scan = read_scan(scan_folder)
    np.testing.assert_allclose([tiny.seen(frame) for frame in scan.frames], tiny.points, atol=1e-6)
    said = "it is for images of 64×48 px; its camera is scaled to these images of 32×24 px"
    said = f"{scan_folder / name}: {said}"
    assert said in map(str, scan.diagnostics)


def test_a_file_for_this_size_is_preferred(scan_folder):
    (scan_folder / "a.json").write_text(
        json.dumps(SIZES["plain.json"] | {"K": np.multiply(LARGE, 2).tolist()})
    )
    (scan_folder / "b.json").write_text(json.dumps({"K": SMALL, "width": 32, "height": 24}))
    scan = read_scan(scan_folder)
    assert scan.frames[0].camera.fx == 100
    assert [str(one) for one in scan.diagnostics] == [
        "the camera is read from b.json, which was found next to the images"
    ]


def test_a_camera_file_given_by_the_user_is_scaled(scan_folder, tiny, tmp_path_factory):
    named = tmp_path_factory.mktemp("beside") / "mine.json"
    named.write_text(json.dumps(SIZES["plain.json"]))
    scan = read_scan(scan_folder, ScanParams(calibration=str(named)))
    np.testing.assert_allclose(tiny.seen(scan.frames[0]), tiny.points[0], atol=1e-6)
    assert any("mine.json: it is for images of 64×48" in text for text in map(str, scan.diagnostics))


def test_the_real_box_made_smaller_has_the_scaled_camera(shared_data, tmp_path):
    real = shared_data / "real" / "realsense_box_open3d_json"
    for kind in ("color", "depth"):
        (tmp_path / kind).mkdir()
        image = cv2.imread(str(real / kind / "000000.png"), cv2.IMREAD_UNCHANGED)
        assert cv2.imwrite(str(tmp_path / kind / "000000.png"), np.ascontiguousarray(image[::2, ::2]))
    name = "cam_params_realsense.json"
    (tmp_path / name).write_bytes((real / name).read_bytes())
    camera = read_scan(tmp_path).frames[0].camera
    assert (camera.width, camera.fx) == (320, pytest.approx(617.25 / 2, abs=0.01))


def halved(source, target):
    target.parent.mkdir(parents=True, exist_ok=True)
    image = cv2.imread(str(source), cv2.IMREAD_UNCHANGED)
    assert cv2.imwrite(str(target), cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))


def test_a_reduced_real_pair_with_its_calibration(shared_data, tmp_path):
    real = shared_data / "stereo" / "middlebury2014_motorcycle"
    for name in ("im0.png", "im1.png"):
        halved(real / name, tmp_path / name)
    (tmp_path / "calib.txt").write_bytes((real / "calib.txt").read_bytes())
    large, small = (read_scan(place, complete=False).rig for place in (real, tmp_path))
    assert small.baseline == large.baseline
    assert small.left.fx == pytest.approx(large.left.fx / 2, rel=2e-3)
    # The disparity offset is in pixels, and so is the given range.
    offsets = [rig.right.cx - rig.left.cx for rig in (large, small)]
    assert offsets[1] == pytest.approx(offsets[0] / 2, rel=2e-3)
    assert small.disparity_count == large.disparity_count // 2


def test_a_reduced_real_street_with_its_calibration(shared_data, tmp_path):
    real = shared_data / "real" / "kitti_stereo_2015"
    for name in ("image_2/000002_10.png", "image_3/000002_10.png"):
        halved(real / name, tmp_path / name)
    place = tmp_path / "calib_cam_to_cam" / "000002.txt"
    place.parent.mkdir()
    place.write_bytes((real / "calib_cam_to_cam" / "000002.txt").read_bytes())
    chosen = ScanParams(first=0, last=0)
    large, small = (read_scan(folder, chosen, complete=False) for folder in (real, tmp_path))
    assert small.rig.left.fx == pytest.approx(large.rig.left.fx / 2, rel=2e-3)
    assert small.rig.baseline == large.rig.baseline
    assert any("000002.txt: it is for images of 1242×375" in text for text in map(str, small.diagnostics))
