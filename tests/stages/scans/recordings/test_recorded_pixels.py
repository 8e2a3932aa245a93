"""Images of recordings in all pixel encodings."""

import numpy as np
import pytest
from recordings import Image
from tiny_recordings import START, color_image, color_stream, depth_map, depth_stream, recording

from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan


@pytest.mark.parametrize(
    ("encoding", "order"),
    [("rgb8", (0, 1, 2)), ("bgr8", (2, 1, 0)), ("rgba8", (0, 1, 2, 0)), ("bgra8", (2, 1, 0, 0))],
)
def test_orders_of_colours(tmp_path, encoding, order):
    pixels = np.ascontiguousarray(color_image()[:, :, order])
    images = [Image(START, pixels, encoding, padding=5)]
    file = recording(streams=[depth_stream(1), color_stream(images=images)]).write(tmp_path / "take.bag")
    np.testing.assert_array_equal(read_color(read_scan(file, complete=False).frames[0]), color_image())


@pytest.mark.parametrize("encoding", ["mono8", "8UC1"])
def test_grey_images(tmp_path, encoding):
    images = [Image(START, np.arange(64 * 48, dtype=np.uint16).reshape(64, 48).astype(np.uint8), encoding)]
    file = recording(streams=[depth_stream(1), color_stream(images=images)]).write(tmp_path / "take.bag")
    color = read_color(read_scan(file, complete=False).frames[0])
    np.testing.assert_array_equal(color, np.repeat(images[0].pixels[:, :, None], 3, axis=2))


@pytest.mark.parametrize(("encoding", "places"), [("yuv422", "uyvy"), ("UYVY", "uyvy"), ("YUYV", "yuyv")])
def test_colours_in_half_resolution(tmp_path, encoding, places):
    # Red in video colour space: luma 81, chroma 90 and 240.
    row = [{"u": 90, "v": 240}.get(letter, 81) for letter in places] * 24
    images = [Image(START, np.tile(np.array(row, np.uint8).reshape(1, 48, 2), (64, 1, 1)), encoding)]
    file = recording(streams=[depth_stream(1), color_stream(images=images)]).write(tmp_path / "take.bag")
    color = read_color(read_scan(file, complete=False).frames[0]).reshape(-1, 3)
    np.testing.assert_allclose(color, np.tile((255, 0, 0), (64 * 48, 1)), atol=3)


@pytest.mark.parametrize(
    ("pixels", "encoding", "big_endian", "scale"),
    [
        (depth_map(), "16UC1", False, None),
        (depth_map(), "mono16", True, None),
        (np.full((24, 32), 2, np.float32), "32FC1", False, 1),
    ],
)
def test_forms_of_depth(tmp_path, pixels, encoding, big_endian, scale):
    images = [Image(START, pixels, encoding, big_endian=big_endian, padding=6)]
    file = recording(streams=[depth_stream(images=images), color_stream(1)]).write(tmp_path / "take.bag")
    scan = read_scan(file, ScanParams(depth_scale=scale), complete=False)
    assert read_depth(scan.frames[0])[17, 26] == pytest.approx(2)
