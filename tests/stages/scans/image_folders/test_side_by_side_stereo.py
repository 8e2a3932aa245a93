"""Side-by-side stereo images: detection and reading."""

import json

import cv2
import numpy as np
import pytest

from scanloom.stages.scans.image_folders.side_by_side_stereo import is_side_by_side
from scanloom.stages.scans.model.images import read_color, read_right
from scanloom.stages.scans.reader import read_scan

WIDTH, HEIGHT, SHIFT = 160, 90, 9
CAMERA = {"fx": 150, "fy": 150, "cx": 80, "cy": 45, "baseline": 0.12}


def scene(seed):
    """Make an image wider than one of a pair by the disparity."""
    coarse = np.random.default_rng(seed).integers(0, 255, (12, 22, 3), np.uint8)
    return cv2.resize(coarse, (WIDTH + SHIFT, HEIGHT), interpolation=cv2.INTER_CUBIC)


@pytest.fixture
def scan_folder(tmp_path):
    for number in range(2):
        whole = scene(number)
        pair = np.hstack([whole[:, :WIDTH], whole[:, SHIFT:]])
        assert cv2.imwrite(str(tmp_path / f"{number}.png"), pair[:, :, ::-1])
    (tmp_path / "calibration.json").write_text(json.dumps(CAMERA))
    (tmp_path / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n")
    return tmp_path


@pytest.mark.parametrize("place", [".", "images"])
def test_each_half_is_an_image_of_the_pair(scan_folder, place):
    (scan_folder / place).mkdir(exist_ok=True)
    for number in range(2):
        (scan_folder / f"{number}.png").rename(scan_folder / place / f"{number}.png")
    scan = read_scan(scan_folder)
    assert (scan.layout, scan.rig.baseline, [one.name for one in scan.frames]) == (
        "plain-stereo",
        0.12,
        ["0", "1"],
    )
    assert (scan.frames[0].camera.width, scan.frames[0].camera.height) == (WIDTH, HEIGHT)
    for number, frame in enumerate(scan.frames):
        np.testing.assert_array_equal(read_color(frame), scene(number)[:, :WIDTH])
        np.testing.assert_array_equal(read_right(frame), scene(number)[:, SHIFT:])


def test_panoramas_are_no_pairs(scan_folder):
    for number in range(2):
        wide = np.hstack([scene(number)[:, :WIDTH], scene(number + 10)[:, :WIDTH]])
        assert cv2.imwrite(str(scan_folder / f"{number}.png"), wide)
    assert read_scan(scan_folder, complete=False).layout == "plain-views"


def test_real_pairs_are_and_real_photos_are_not(shared_data, tmp_path):
    """Photos of a street are as wide as two images, and similar in both halves."""
    street = shared_data / "real" / "kitti_stereo_2015"
    assert not is_side_by_side(sorted((street / "image_2").iterdir()))
    rig = shared_data / "stereo" / "euroc_V1_01_easy_static" / "mav0"
    wholes = []
    for left in sorted((rig / "cam0" / "data").glob("*.png"))[:4]:
        right = rig / "cam1" / "data" / left.name
        wholes.append(tmp_path / left.name)
        assert cv2.imwrite(str(wholes[-1]), np.hstack([cv2.imread(str(left)), cv2.imread(str(right))]))
    assert is_side_by_side(wholes)
