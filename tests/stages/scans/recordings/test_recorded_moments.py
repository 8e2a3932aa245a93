"""Streams with separate clocks: assignment of images and poses by time."""

import numpy as np
import pytest
from recordings import Image
from tiny_recordings import (
    INTERVAL,
    START,
    color_image,
    color_stream,
    depth_map,
    depth_stream,
    list_warnings,
    recording,
)

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan


def test_simultaneous_images_are_paired_despite_dropped_frames(tmp_path):
    depths = [Image(START + n * INTERVAL, depth_map(1 + n / 10), "mono16") for n in (0, 1, 2, 4, 5)]
    # The colour camera is slightly ahead and lost other images; recorded in another order.
    colors = [
        Image(START + n * INTERVAL - 5_000_000, color_image(10 * n), "rgb8", recorded=START + at)
        for at, n in enumerate((3, 0, 2, 1, 5))
    ]
    made = recording(streams=[depth_stream(images=depths), color_stream(images=colors)])
    scan = read_scan(made.write(tmp_path / "take.bag"), complete=False)
    seen = [(round(10 * read_depth(one)[9, 9] - 10), read_color(one)[0, 0, 0] // 10) for one in scan.frames]
    assert seen == [(0, 0), (1, 1), (2, 2), (5, 5)]
    assert [text for text in list_warnings(scan) if "4 of 5 depth maps and 5 colour images" in text]


def test_streams_of_other_rates(tmp_path):
    # The fourth depth map was lost, and the next one is from another time than the second colour image.
    depths = [Image(START + n * INTERVAL // 3, depth_map(1 + n / 10), "mono16") for n in range(12) if n != 3]
    colors = [Image(START + n * INTERVAL + 1_000_000, color_image(n), "rgb8") for n in range(4)]
    made = recording(streams=[depth_stream(images=depths), color_stream(images=colors)])
    scan = read_scan(made.write(tmp_path / "take.bag"), complete=False)
    assert [one.name for one in scan.frames] == ["000000", "000005", "000008"]


def test_clocks_that_do_not_agree(tmp_path):
    depths = [Image(n * INTERVAL, depth_map(), "mono16", recorded=START + n * INTERVAL) for n in range(3)]
    colors = [Image(START + n * INTERVAL, color_image(n), "rgb8") for n in range(3)]
    made = recording(streams=[depth_stream(images=depths), color_stream(images=colors)])
    scan = read_scan(made.write(tmp_path / "take.bag"), complete=False)
    assert [read_color(one)[0, 0, 0] for one in scan.frames] == [0, 1, 2]
    assert [one.timestamp for one in scan.frames] == [START + n * INTERVAL for n in range(3)]
    assert any("clocks" in text for text in list_warnings(scan))


def test_poses_of_another_time_and_poses_by_number(tmp_path, tiny, matrix_text):
    file = recording().write(tmp_path / "take.bag")
    (tmp_path / "early.tum").write_text("5 0 0 0 0 0 0 1\n6 1 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match=r"early\.tum: none of its 2 poses is within 0\.02 s"):
        read_scan(file, ScanParams(poses="early.tum"))
    (tmp_path / "mine.log").write_text(
        "0 0 1\n" + matrix_text(tiny.identity) + "1 1 2\n" + matrix_text(tiny.second)
    )
    for one, point in zip(read_scan(file, ScanParams(poses="mine.log")).frames, tiny.points, strict=True):
        np.testing.assert_allclose(tiny.seen(one), point, atol=1e-6)
