import json

import cv2
import numpy as np
import pytest

from scanloom.stages.scans.image_folders.rotated_bits import decode_rotated, is_rotated
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan


def rotated(depth):
    return np.asarray((depth << 3) | (depth >> 13), np.uint16)


def room(nearest, farthest, seed=1):
    """Make a slope with a step, noise, and pixels without depth."""
    slope = np.tile(np.linspace(nearest, farthest, 160), (120, 1))
    slope[30:60, 40:90] -= (farthest - nearest) / 4
    depth = np.clip(slope + np.random.default_rng(seed).normal(0, 2, slope.shape), 1, 65535).astype(np.uint16)
    depth[:5] = 0
    return depth


@pytest.mark.parametrize(("nearest", "farthest"), [(500, 4000), (3000, 9000), (6000, 30000)])
@pytest.mark.parametrize("stated", [False, True])
def test_rotated_and_plain_values_are_distinguished(nearest, farthest, stated):
    depth = room(nearest, farthest)
    np.testing.assert_array_equal(decode_rotated(rotated(depth)), depth)
    assert not is_rotated(depth, is_scale_stated=stated)
    # Without wrapped values, multiples of eight may be intended as a scale.
    assert is_rotated(rotated(depth), is_scale_stated=stated) == (farthest > 8192 or not stated)


def test_values_that_are_rounded_are_not_rotated():
    assert not is_rotated(np.asarray(room(500, 4000) // 16 * 16, np.uint16), is_scale_stated=False)
    assert not is_rotated(np.full((120, 160), 2000, np.uint16), is_scale_stated=False)


def write_scan(folder, nearest, farthest):
    """Write three frames with rotated depth; return the original values of the last one."""
    for place in ("color", "depth"):
        (folder / place).mkdir()
    for number in range(3):
        depth = room(nearest, farthest, number)
        assert cv2.imwrite(str(folder / "depth" / f"{number}.png"), rotated(depth))
        assert cv2.imwrite(str(folder / "color" / f"{number}.png"), np.zeros((120, 160, 3), np.uint8))
    return depth


def test_rotated_bits_of_a_scan_are_restored_and_reported(tmp_path):
    depth = write_scan(tmp_path, 900, 12000)
    scan = read_scan(tmp_path, complete=False)
    np.testing.assert_allclose(read_depth(scan.frames[2]), depth / 1000, atol=1e-6)
    assert any("set scan.depth_scale=10000" in text for text in map(str, scan.diagnostics))
    tenths = read_scan(tmp_path, ScanParams(depth_scale=10000), complete=False)
    np.testing.assert_allclose(read_depth(tenths.frames[2]), depth / 10000, atol=1e-6)


@pytest.mark.parametrize(("stated", "is_turned"), [(10000, True), (8000, False), (1000, False)])
def test_tenths_of_millimetres_are_of_values_turned_back(tmp_path, stated, is_turned):
    """Below 8192 units, multiples of eight may be intended, but steps of 0.8 mm hardly."""
    depth = write_scan(tmp_path, 2500, 7000)
    scan = read_scan(tmp_path, ScanParams(depth_scale=stated), complete=False)
    values = depth if is_turned else rotated(depth)
    np.testing.assert_allclose(read_depth(scan.frames[2]), values / stated, atol=1e-6)
    told = [text for text in map(str, scan.diagnostics) if "are decoded" in text]
    assert len(told) == is_turned
    assert all(text.endswith("with 10000 units per metre") for text in told)


def test_depth_of_scan_json_is_never_rotated(tmp_path):
    depth = write_scan(tmp_path, 2500, 7000)
    camera = {"width": 160, "height": 120, "fx": 150, "fy": 150, "cx": 80, "cy": 60}
    frames = [
        {
            "name": str(number),
            "color": f"color/{number}.png",
            "depth": f"depth/{number}.png",
            "world_from_camera": np.eye(4).tolist(),
        }
        for number in range(3)
    ]
    content = {"version": 1, "camera": camera, "depth_scale": 10000, "depth_missing": [], "frames": frames}
    (tmp_path / "scan.json").write_text(json.dumps(content))
    for options in (ScanParams(), ScanParams(depth_scale=10000)):
        scan = read_scan(tmp_path, options, complete=False)
        np.testing.assert_allclose(read_depth(scan.frames[2]), rotated(depth) / 10000, atol=1e-6)


def test_real_depth_maps(shared_data):
    formats = shared_data / "rgbd" / "open3d_testdata" / "RGBD" / "other_formats"
    sun, tum = (cv2.imread(str(formats / f"{name}_depth.png"), -1) for name in ("SUN", "TUM"))
    assert is_rotated(sun, is_scale_stated=False)
    assert not is_rotated(tum, is_scale_stated=False)
