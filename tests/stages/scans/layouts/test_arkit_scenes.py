from dataclasses import replace

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

# Names of depth files, and names of the other files with a difference of a millisecond.
DEPTHS = ("41069021_9.500", "41069021_10.250")
OTHERS = ("41069021_9.501", "41069021_10.249")
TRAJECTORY = (
    "0.5 0 0 0 9 9 9\n"
    "9.504 0 0 0 0 0 0\n"
    # camera_from_world of the second frame: -90° about y, and (3, -2, -1).
    f"10.247 0 {-np.pi / 2} 0 3 -2 -1\n"
)


@pytest.fixture
def scan_folder(tmp_path, tiny):
    for depth, other in zip(DEPTHS, OTHERS, strict=True):
        tiny.depth(tmp_path / "lowres_depth" / f"{depth}.png", 1000)
        tiny.color(tmp_path / "lowres_wide" / f"{depth}.png")
        (tmp_path / "lowres_wide_intrinsics").mkdir(exist_ok=True)
        (tmp_path / "lowres_wide_intrinsics" / f"{other}.pincam").write_text("32 24 100 100 16 12")
    (tmp_path / "lowres_wide.traj").write_text(TRAJECTORY)
    return tmp_path


def test_known_points_come_out_in_the_world(scan_folder, tiny):
    scan = read_scan(scan_folder)
    assert scan.layout == "arkitscenes"
    # Ordered by time, which differs from alphabetical order.
    assert [frame.name for frame in scan.frames] == list(DEPTHS)
    assert [frame.timestamp for frame in scan.frames] == [9_500_000_000, 10_250_000_000]
    for frame, point in zip(scan.frames, tiny.points, strict=True):
        np.testing.assert_allclose(tiny.seen(frame), point, atol=1e-6)


def test_a_pincam_of_another_size_is_scaled(scan_folder, tiny):
    for path in (scan_folder / "lowres_wide_intrinsics").iterdir():
        path.write_text("64 48 200 200 32.5 24.5\n")
    for frame, point in zip(read_scan(scan_folder).frames, tiny.points, strict=True):
        np.testing.assert_allclose(tiny.seen(frame), point, atol=1e-6)


def test_each_frame_has_its_own_camera(scan_folder):
    (scan_folder / "lowres_wide_intrinsics" / f"{OTHERS[1]}.pincam").write_text("32 24 110 120 15 11")
    camera = read_scan(scan_folder).frames[1].camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (110, 120, 15, 11)


def test_depth_of_low_confidence_is_left_out(scan_folder):
    (scan_folder / "confidence").mkdir()
    confidence = np.full((24, 32), 2, np.uint8)
    confidence[4:8], confidence[8:12] = 0, 1
    for name in DEPTHS:
        assert cv2.imwrite(str(scan_folder / "confidence" / f"{name}.png"), confidence)
    scan = read_scan(scan_folder)
    assert read_depth(scan.frames[0])[[5, 9, 15], 5].tolist() == [0, 2, 2]
    assert any("confidence" in text for text in map(str, scan.diagnostics))


def test_frames_without_a_pose_in_time_are_skipped(scan_folder):
    (scan_folder / "lowres_wide.traj").write_text(TRAJECTORY.replace("9.504", "9.506"))
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == [DEPTHS[1]]
    assert [(one.name, one.reason) for one in scan.skipped_frames] == [
        (DEPTHS[0], "the trajectory has no pose within 0.005 s")
    ]


@pytest.mark.parametrize(
    ("file", "reason"),
    [
        (f"lowres_wide/{DEPTHS[0]}.png", "its colour image is missing"),
        (f"lowres_wide_intrinsics/{OTHERS[0]}.pincam", "its .pincam is missing"),
    ],
)
def test_a_missing_file_costs_its_frame_only(scan_folder, file, reason):
    (scan_folder / file).unlink()
    scan = read_scan(scan_folder)
    assert len(scan.frames) == 1
    assert [(one.name, one.reason) for one in scan.skipped_frames] == [(DEPTHS[0], reason)]


def test_given_intrinsics_replace_missing_ones(scan_folder, tiny):
    for path in (scan_folder / "lowres_wide_intrinsics").iterdir():
        path.unlink()
    frames = read_scan(scan_folder, ScanParams(intrinsics=tiny.option)).frames
    np.testing.assert_allclose([tiny.seen(frame) for frame in frames], tiny.points, atol=1e-6)


def test_no_trajectory_is_no_poses(scan_folder):
    (scan_folder / "lowres_wide.traj").unlink()
    with pytest.raises(InputError, match=r"no poses: lowres_wide\.traj is missing"):
        read_scan(scan_folder)
    assert len(read_scan(scan_folder, complete=False).frames) == 2


@pytest.mark.parametrize(
    "text",
    ["", "32 24 100 100 16", "a b c d e f", "nan 24 100 100 16 12", "1e9 1e9 1 1 1 1", "32 24 0 0 16 12"],
)
def test_a_wrong_camera_is_refused(scan_folder, text):
    (scan_folder / "lowres_wide_intrinsics" / f"{OTHERS[0]}.pincam").write_text(text)
    with pytest.raises(InputError, match="pincam"):
        read_scan(scan_folder)


@pytest.mark.parametrize("text", ["", "1 2 3\n", "x\n", "9.5 1e300 0 0 0 0 0\n", "nan 0 0 0 0 0 0\n"])
def test_a_wrong_trajectory_is_refused(scan_folder, text):
    (scan_folder / "lowres_wide.traj").write_text(text)
    with pytest.raises(InputError, match=r"lowres_wide\.traj"):
        read_scan(scan_folder)


def test_lost_poses_are_skipped(scan_folder):
    (scan_folder / "lowres_wide.traj").write_text(TRAJECTORY.replace("9.504 0 0 0", "9.504 nan nan nan"))
    assert len(read_scan(scan_folder).frames) == 1


def test_without_any_pincam_the_camera_is_guessed(scan_folder):
    for path in (scan_folder / "lowres_wide_intrinsics").iterdir():
        path.unlink()
    scan = read_scan(scan_folder)
    assert [frame.camera.fx for frame in scan.frames] == [26.25, 26.25]
    assert any("is guessed" in text and "scan.intrinsics" in text for text in map(str, scan.diagnostics))


def test_poses_of_another_clock_are_assigned_in_order(scan_folder, tiny):
    turned = " ".join(map(str, tiny.second_quaternion))
    (scan_folder / "mine.tum").write_text(f"500.0 0 0 0 0 0 0 1\n500.5 1 2 3 {turned}\n")
    named = ScanParams(poses="mine.tum")
    with pytest.raises(InputError, match=r"none of its 2 poses .* as many poses as frames: scan\.poses"):
        read_scan(scan_folder, named)
    scan = read_scan(scan_folder, replace(named, poses_by_order=True))
    np.testing.assert_allclose([tiny.seen(frame) for frame in scan.frames], tiny.points, atol=1e-6)
