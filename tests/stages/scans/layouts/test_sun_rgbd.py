import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan


def write_rotated(path, millimetres):
    path.parent.mkdir(parents=True, exist_ok=True)
    values = np.full((24, 32), millimetres, np.uint16)
    values[0, 0] = 0
    assert cv2.imwrite(str(path), np.uint16(values << 3) | (values >> 13))


def rows(pose):
    return "".join(" ".join(f"{value:g}" for value in row) + "\n" for row in pose[:3])


@pytest.fixture
def scan_folder(tmp_path, tiny):
    tiny.color(tmp_path / "image" / "0001170-000039183231.jpg")
    write_rotated(tmp_path / "depth" / "0001170-000039188214.png", 2000)
    (tmp_path / "intrinsics.txt").write_text("100 0 16 0 100 12 0 0 1")
    (tmp_path / "extrinsics").mkdir()
    # Tilt of the camera, not a pose.
    (tmp_path / "extrinsics" / "20150118235401.txt").write_text("1 0 0 0\n0 0.8 -0.6 0\n0 0.6 0.8 0\n")
    return tmp_path


def test_the_single_frame_is_the_world(scan_folder, tiny):
    scan = read_scan(scan_folder)
    assert scan.layout == "sun-rgbd"
    (frame,) = scan.frames
    np.testing.assert_allclose(tiny.seen(frame), tiny.points[0], atol=1e-6)
    assert any("the only frame has no pose" in text for text in map(str, scan.diagnostics))


def test_values_beyond_eight_metres_are_read(scan_folder):
    write_rotated(scan_folder / "depth" / "0001170-000039188214.png", 9001)
    np.testing.assert_allclose(read_depth(read_scan(scan_folder).frames[0])[5, 5], 9.001)


def test_sequences_take_the_latest_poses(scan_folder, tiny):
    tiny.color(scan_folder / "image" / "0001171-000039216598.jpg")
    write_rotated(scan_folder / "depth" / "0001171-000039221582.png", 2000)
    (scan_folder / "extrinsics" / "20160101000000.txt").write_text(rows(tiny.identity) + rows(tiny.second))
    frames = read_scan(scan_folder).frames
    np.testing.assert_allclose([tiny.seen(frame) for frame in frames], tiny.points, atol=1e-6)


def test_plain_values_are_reported_and_read(scan_folder):
    millimetres = np.arange(1000, 1768, dtype=np.uint16).reshape(24, 32)
    cv2.imwrite(str(scan_folder / "depth" / "0001170-000039188214.png"), millimetres)
    scan = read_scan(scan_folder)
    np.testing.assert_allclose(read_depth(scan.frames[0])[0, :3], (1.0, 1.001, 1.002))
    assert any("not stored with rotated bits" in text for text in map(str, scan.diagnostics))


def test_a_sequence_without_poses_is_reported(scan_folder, tiny):
    tiny.color(scan_folder / "image" / "0001171-000039216598.jpg")
    write_rotated(scan_folder / "depth" / "0001171-000039221582.png", 2000)
    (scan_folder / "extrinsics" / "20150118235401.txt").unlink()
    with pytest.raises(InputError, match=r"no poses: extrinsics/ has no pose file"):
        read_scan(scan_folder)


@pytest.mark.parametrize(
    "text", ["", "1 0 0 0\n0 1 0 0\n", "1 0 0\n0 1 0\n0 0 1\n", "1 0 0 0\n0 1 0 0\n0 0 2 0\n"]
)
def test_wrong_poses_are_refused(scan_folder, tiny, text):
    tiny.color(scan_folder / "image" / "0001171-000039216598.jpg")
    write_rotated(scan_folder / "depth" / "0001171-000039221582.png", 2000)
    (scan_folder / "extrinsics" / "20150118235401.txt").write_text(text)
    with pytest.raises(InputError, match=r"20150118235401\.txt"):
        read_scan(scan_folder)


@pytest.mark.parametrize("text", ["", "1 2 3", "100 0 nan 0 100 12 0 0 1"])
def test_wrong_intrinsics_are_refused(scan_folder, text):
    (scan_folder / "intrinsics.txt").write_text(text)
    with pytest.raises(InputError, match=r"intrinsics\.txt"):
        read_scan(scan_folder)
    assert read_scan(scan_folder, ScanParams(intrinsics="100,100,16,12")).frames


def test_a_real_frame(shared_data, tmp_path):
    source = shared_data / "rgbd" / "open3d_testdata" / "RGBD" / "other_formats"
    for name in ("image", "depth", "extrinsics"):
        (tmp_path / name).mkdir()
    (tmp_path / "image" / "1.jpg").symlink_to(source / "SUN_color.jpg")
    (tmp_path / "depth" / "1.png").symlink_to(source / "SUN_depth.png")
    (tmp_path / "intrinsics.txt").write_text("529.5 0 365 0 529.5 265 0 0 1")
    depth = read_depth(read_scan(tmp_path).frames[0])
    # Values of Open3D for the same file.
    np.testing.assert_allclose(np.percentile(depth, (50, 99)), (2.349, 8.626), atol=0.01)


def test_streams_of_a_sequence_are_paired_by_time_and_posed_by_image(scan_folder, tiny):
    for folder in ("image", "depth"):
        for path in (scan_folder / folder).iterdir():
            path.unlink()
    # A depth map is missing, so the numbers do not match; the last image has no depth map close in time.
    for name in (
        "0000001-000000000000",
        "0000002-000000033000",
        "0000003-000000066000",
        "0000004-000000900000",
    ):
        tiny.color(scan_folder / "image" / f"{name}.jpg")
    write_rotated(scan_folder / "depth" / "0000001-000000002000.png", 2000)
    write_rotated(scan_folder / "depth" / "0000002-000000064000.png", 2000)
    poses = (tiny.identity, tiny.identity @ np.diag((-1, -1, 1, 1.0)), tiny.second, tiny.identity)
    (scan_folder / "extrinsics" / "20160101000000.txt").write_text("".join(rows(pose) for pose in poses))
    scan = read_scan(scan_folder)
    assert [frame.color.name[:7] for frame in scan.frames] == ["0000001", "0000003"]
    np.testing.assert_allclose([tiny.seen(frame) for frame in scan.frames], tiny.points, atol=1e-6)
    assert [one.name[:7] for one in scan.skipped_frames] == ["0000002", "0000004"]
