"""Masks in a folder given by the user, for any layout."""

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.inspecting.unused_files import find_unused_files
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan


@pytest.fixture
def scan_folder(tmp_path, tiny, matrix_text):
    for number, pose in ((2, tiny.identity), (10, tiny.second)):
        stem = f"frame-{number:06d}"
        tiny.color(tmp_path / f"{stem}.color.png")
        tiny.depth(tmp_path / f"{stem}.depth.png", 1000)
        (tmp_path / f"{stem}.pose.txt").write_text(matrix_text(pose))
    (tmp_path / "camera-intrinsics.txt").write_text("100 0 16\n0 100 12\n0 0 1\n")
    (tmp_path / "masks").mkdir()
    return tmp_path


def put(folder, name, column):
    mask = np.full((24, 32), 255, np.uint8)
    mask[:, column] = 0
    assert cv2.imwrite(str(folder / "masks" / name), mask)


@pytest.mark.parametrize(
    "names",
    [
        ("frame-000002.png", "frame-000010.png"),
        ("frame-000002.color.png", "frame-000010.color.png"),
        ("frame-000002_mask.png", "frame-000010_mask.png"),
        ("2.png", "10.png"),
    ],
)
def test_masks_are_found_by_name_or_number(scan_folder, names):
    for name, column in zip(names, (5, 6), strict=True):
        put(scan_folder, name, column)
    scan = read_scan(scan_folder, ScanParams(masks="masks"))
    for frame, column in zip(scan.frames, (5, 6), strict=True):
        depth = read_depth(frame)
        assert (depth[8, column], depth[8, 11 - column] > 0) == (0, True)
    assert find_unused_files(scan) == ()
    # Masks are only used on request, and inspect names the option.
    assert read_scan(scan_folder).frames[0].mask is None


def test_nearly_black_of_jpeg_is_black(scan_folder):
    mask = np.full((24, 32), 250, np.uint8)
    mask[:, :16] = 6
    assert cv2.imwrite(str(scan_folder / "masks" / "2.jpg"), mask)
    depth = read_depth(read_scan(scan_folder, ScanParams(masks="masks")).frames[0])
    assert (depth[8, 4], depth[8, 28] > 0) == (0, True)


def test_a_frame_without_a_mask_is_reported(scan_folder):
    put(scan_folder, "2.png", 5)
    scan = read_scan(scan_folder, ScanParams(masks="masks"))
    assert "1 frames have no mask in masks/: frame-000010" in map(str, scan.diagnostics)
    assert [frame.mask is None for frame in scan.frames] == [False, True]


@pytest.mark.parametrize(
    ("names", "place", "message"),
    [
        ((), "nothing", "the mask folder does not exist"),
        (
            ("7.png",),
            "masks",
            "none of its 1 images has the name or the number of a frame, such as frame-000002",
        ),
        (
            ("a 2.png", "b 2.png"),
            "masks",
            "frame frame-000002 has 2 masks, such as a 2.png and b 2.png; one is",
        ),
    ],
)
def test_invalid_masks_are_reported(scan_folder, names, place, message):
    for name in names:
        put(scan_folder, name, 5)
    with pytest.raises(InputError, match=message):
        read_scan(scan_folder, ScanParams(masks=place))
