from dataclasses import replace

import cv2
import numpy as np
import pytest

from scanloom.stages.adjusting.silhouette_offset import estimate_photo_offset, observe_silhouettes
from scanloom.stages.adjusting.view import get_color_camera, get_color_from_depth
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.aligned_color import read_color_aligned_to_depth
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

DEPTHS = ("d-10.000000-100.pgm", "d-10.500000-600.pgm", "d-20.000000-900.pgm")
COLORS = ("r-10.030000-101.ppm", "r-10.490000-590.ppm", "r-10.600000-700.ppm")
DISPARITY = 914
METRES = 351.3 / (1092.5 - DISPARITY)


def write_disparities(path, values):
    """Write a PGM file like the data set's recorder: low byte first."""
    height, width = values.shape
    path.write_bytes(f"P5 {width} {height} 65535\n".encode() + values.astype("<u2").tobytes())


@pytest.fixture
def scan_folder(tmp_path, tiny):
    for name in COLORS:
        tiny.color(tmp_path / name)
    values = np.full((24, 32), DISPARITY, np.uint16)
    values[0, :4] = 2047, 0, 599, 1060
    for name in DEPTHS:
        write_disparities(tmp_path / name, values)
    (tmp_path / "a-10.000000-100.dump").touch()
    (tmp_path / "INDEX.txt").touch()
    return tmp_path


def test_disparities_become_metres(scan_folder, tiny):
    scan = read_scan(scan_folder, ScanParams(intrinsics=tiny.option), complete=False)
    assert scan.layout == "nyu"
    depth = read_depth(scan.frames[0])
    np.testing.assert_allclose(depth[5, 5], METRES, rtol=1e-6)
    # No return, below the minimum range, and 10.8 m away.
    assert depth[0, :5].tolist() == [0, 0, 0, 0, depth[5, 5]]


def test_streams_are_paired_by_time(scan_folder):
    scan = read_scan(scan_folder, complete=False)
    found = [(frame.name[:4], frame.color.name[:7]) for frame in scan.frames]
    assert found == [("d-10", "r-10.03"), ("d-10", "r-10.49")]
    assert [frame.timestamp for frame in scan.frames] == [10_000_000_000, 10_500_000_000]
    assert [one.reason for one in scan.skipped_frames] == ["no colour image within 0.05 s"]


def test_known_points_with_a_user_trajectory(scan_folder, tiny):
    x, y, z, w = tiny.second_quaternion
    (scan_folder / "mine.tum").write_text(f"10.0 0 0 0 0 0 0 1\n10.5 1 2 3 {x} {y} {z} {w}\n")
    frames = read_scan(scan_folder, ScanParams(intrinsics=tiny.option, poses="mine.tum")).frames
    for frame, pose in zip(frames, (tiny.identity, tiny.second), strict=True):
        point = pose @ (0.1 * METRES, 0.05 * METRES, METRES, 1)
        np.testing.assert_allclose(tiny.seen(frame), point[:3], atol=1e-6)


def test_missing_poses_are_reported(scan_folder):
    with pytest.raises(InputError, match=r"no poses: the data set contains no poses.*scan\.poses"):
        read_scan(scan_folder)


def test_the_colour_camera_is_to_the_right(scan_folder):
    frame = read_scan(scan_folder, complete=False).frames[0]
    x, y, z = (frame.color_from_depth @ (0, 0, 2, 1))[:3]
    # A point on the axis of the depth camera is 25 mm left of the colour camera's axis, which is rotated by
    # 4.3 mrad.
    np.testing.assert_allclose((x, y, z), (-0.0251 - 2 * 0.00432, 0.0076, 2), atol=1e-3)


@pytest.mark.parametrize(
    "data", [b"", b"P5 32 24 65535\n12", b"P5 9999999 9999999 65535\n", b"P5 1 1 255\n1"]
)
def test_a_damaged_depth_map_costs_its_frame_only(scan_folder, data):
    (scan_folder / DEPTHS[0]).write_bytes(data)
    first, second = read_scan(scan_folder, complete=False).frames
    with pytest.raises(InputError, match=r"d-10\.000000-100\.pgm"):
        read_depth(first)
    assert read_depth(second)[5, 5] > 0


def test_one_stream_alone_is_no_scan(scan_folder):
    for name in COLORS:
        (scan_folder / name).unlink()
    with pytest.raises(InputError, match="unknown layout"):
        read_scan(scan_folder)
    with pytest.raises(InputError, match=r"d-.*\.pgm and r-.*\.ppm are required"):
        read_scan(scan_folder, ScanParams(layout="nyu"))


def test_depth_of_a_real_frame_is_aligned_with_its_colour(shared_data, tmp_path):
    source = shared_data / "rgbd" / "open3d_testdata" / "RGBD" / "other_formats"
    (tmp_path / "d-10.000000-100.pgm").symlink_to(source / "NYU_depth.pgm")
    (tmp_path / "r-10.010000-101.ppm").symlink_to(source / "NYU_color.ppm")
    scan = read_scan(tmp_path)
    frame = scan.frames[0]
    depth = read_depth(frame)
    assert 1.5 < np.median(depth[depth > 0]) < 4
    assert any("the only frame has no pose" in text for text in map(str, scan.diagnostics))
    # The same frame twice.
    found = estimate_photo_offset(
        observe_silhouettes([frame], [0]) * 2, get_color_camera(frame), get_color_from_depth(frame)
    )
    assert np.hypot(*found.shift_px) < 2
    unregistered = cv2.imread(str(source / "NYU_color.ppm"))[:, :, ::-1]
    # Without the extrinsics, the correlation of colour edges and depth edges is less than half.
    assert correlation(read_color_aligned_to_depth(frame, depth), depth) > 2 * correlation(
        unregistered, depth
    )


def correlation(color, depth):
    """Compute the Pearson correlation of colour edges and depth discontinuities."""
    gray = cv2.cvtColor(np.ascontiguousarray(color), cv2.COLOR_RGB2GRAY).astype(np.float32)
    edges = cv2.magnitude(cv2.Sobel(gray, cv2.CV_32F, 1, 0), cv2.Sobel(gray, cv2.CV_32F, 0, 1))
    logs = np.log(np.where(depth > 0, depth, 10))
    jumps = cv2.magnitude(cv2.Sobel(logs, cv2.CV_32F, 1, 0), cv2.Sobel(logs, cv2.CV_32F, 0, 1)) > 0.3
    known = cv2.erode((depth > 0).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    return np.corrcoef(np.minimum(edges[known], 200), jumps[known])[0, 1]


def test_poses_of_another_clock_are_assigned_in_order(scan_folder, tiny):
    turned = " ".join(map(str, tiny.second_quaternion))
    (scan_folder / "mine.tum").write_text(f"500.0 0 0 0 0 0 0 1\n500.5 1 2 3 {turned}\n")
    named = ScanParams(poses="mine.tum", intrinsics=tiny.option)
    with pytest.raises(InputError, match=r"none of its 2 poses .* as many poses as frames: scan\.poses"):
        read_scan(scan_folder, named)
    scan = read_scan(scan_folder, replace(named, poses_by_order=True))
    for frame, pose in zip(scan.frames, (tiny.identity, tiny.second), strict=True):
        np.testing.assert_allclose(frame.world_from_camera, pose, atol=1e-9)
