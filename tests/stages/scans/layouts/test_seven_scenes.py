import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.aligned_color import read_color_aligned_to_depth
from scanloom.stages.scans.model.images import read_color, read_depth
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
    return tmp_path


def test_known_points_come_out_in_the_world(scan_folder, tiny):
    scan = read_scan(scan_folder)
    assert scan.layout == "7scenes"
    assert [frame.name for frame in scan.frames] == ["frame-000002", "frame-000010"]
    for frame, point in zip(scan.frames, tiny.points, strict=True):
        np.testing.assert_allclose(tiny.seen(frame), point, atol=1e-6)


def test_both_marks_of_missing_depth_read_as_zero(scan_folder):
    depth = read_depth(read_scan(scan_folder).frames[0])
    assert depth[0, 0] == 0
    assert depth[0, 1] == 0
    assert depth[0, 2] == 2


def test_colour_is_rgb(scan_folder):
    assert tuple(read_color(read_scan(scan_folder).frames[0])[0, 0]) == (200, 0, 0)


def test_without_intrinsics_the_default_is_used_and_reported(scan_folder):
    (scan_folder / "camera-intrinsics.txt").unlink()
    scan = read_scan(scan_folder)
    assert scan.frames[0].camera.matrix.tolist() == [[585, 0, 320], [0, 585, 240], [0, 0, 1]]
    assert any("585" in text and "scan.intrinsics" in text for text in map(str, scan.diagnostics))
    assert any("not registered" in text for text in map(str, scan.diagnostics))


def test_intrinsics_of_the_whole_scene_are_found(scan_folder, tmp_path):
    sequence = tmp_path / "seq-01"
    sequence.mkdir()
    for path in scan_folder.glob("frame-*"):
        path.rename(sequence / path.name)
    assert read_scan(sequence).frames[0].camera.fx == 100


@pytest.mark.parametrize(("kinds", "focal"), [(("color",), 100.0), (("color", "depth"), 90.0)])
def test_intrinsics_named_by_the_camera_they_are_of(scan_folder, kinds, focal):
    (scan_folder / "camera-intrinsics.txt").unlink()
    for kind in kinds:
        f = {"color": 100, "depth": 90}[kind]
        (scan_folder / f"camera-intrinsics.{kind}.txt").write_text(f"{f} 0 16\n0 {f} 12\n0 0 1\n")
    scan = read_scan(scan_folder)
    assert scan.frames[0].camera.fx == focal
    assert scan.diagnostics == ()


def test_stated_intrinsics_and_scale_win(scan_folder):
    scan = read_scan(scan_folder, ScanParams(intrinsics="50, 60, 15, 11", depth_scale=2000))
    camera = scan.frames[0].camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (50, 60, 15, 11)
    assert read_depth(scan.frames[0])[5, 5] == 1.0


def test_bundlefusion_info_gives_camera_and_scale(scan_folder, tiny):
    (scan_folder / "camera-intrinsics.txt").unlink()
    (scan_folder / "info.txt").write_text(
        "m_versionNumber = 4\nm_depthShift = 500\n"
        "m_calibrationDepthIntrinsic = 100 0 16 0 0 100 12 0 0 0 1 0 0 0 0 1\n"
    )
    for number in (2, 10):
        tiny.depth(scan_folder / f"frame-{number:06d}.depth.png", 500)
    for frame, point in zip(read_scan(scan_folder).frames, tiny.points, strict=True):
        np.testing.assert_allclose(tiny.seen(frame), point, atol=1e-6)


@pytest.mark.parametrize("name", ["info.txt", "_info.txt"])
def test_larger_colour_of_bundlefusion_has_its_own_camera(scan_folder, name):
    # The known pixel (26, 17) is at 300 · (0.1, 0.05) + (50, 33) = (80, 48) in the colour images.
    image = np.zeros((72, 96, 3), np.uint8)
    image[44:53, 76:85] = 255
    for number in (2, 10):
        cv2.imwrite(str(scan_folder / f"frame-{number:06d}.color.png"), image)
    (scan_folder / name).write_text(
        "m_colorWidth = 96\nm_colorHeight = 72\nm_depthWidth = 32\nm_depthHeight = 24\nm_depthShift = 1000\n"
        "m_calibrationColorIntrinsic = 300 0 50 0 0 300 33 0 0 0 1 0 0 0 0 1\n"
        "m_calibrationDepthIntrinsic = 100 0 16 0 0 100 12 0 0 0 1 0 0 0 0 1\n"
    )
    frame = read_scan(scan_folder).frames[0]
    color = read_color_aligned_to_depth(frame, read_depth(frame))
    rows, columns = np.nonzero(color[:, :, 0] > 128)
    assert (rows.mean(), columns.mean()) == (17, 26)


def test_registered_colour_needs_no_separate_camera(scan_folder):
    (scan_folder / "info.txt").write_text(
        "m_colorWidth = 32\nm_colorHeight = 24\n"
        "m_calibrationColorIntrinsic = 100 0 16 0 0 100 12 0 0 0 1 0 0 0 0 1\n"
        "m_calibrationDepthIntrinsic = 100 0 16 0 0 100 12 0 0 0 1 0 0 0 0 1\n"
    )
    assert read_scan(scan_folder).frames[0].color_camera is None


@pytest.mark.parametrize(
    "text",
    [
        "",
        "m_calibrationDepthIntrinsic = 100 0 16",
        "m_calibrationDepthIntrinsic = 100 0 16 0 0 100 12 0\nm_depthShift = 0",
        "m_calibrationDepthIntrinsic = 100 0 16 0 0 100 12 0\nm_depthShift = nan",
        "m_calibrationDepthIntrinsic = 100 0 16 0 0 100 12 0\nm_colorWidth = x\nm_colorHeight = 3",
    ],
)
def test_a_wrong_info_file_is_refused(scan_folder, text):
    (scan_folder / "info.txt").write_text(text)
    with pytest.raises(InputError, match=r"info\.txt"):
        read_scan(scan_folder)


def test_lost_poses_are_skipped_and_counted(scan_folder, matrix_text):
    (scan_folder / "frame-000002.pose.txt").write_text(matrix_text(np.full((4, 4), -np.inf)))
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == ["frame-000010"]
    assert [one.name for one in scan.skipped_frames] == ["frame-000002"]
    assert "lost" in scan.skipped_frames[0].reason


def test_a_missing_pose_file_skips_its_frame_only(scan_folder):
    (scan_folder / "frame-000002.pose.txt").unlink()
    scan = read_scan(scan_folder)
    assert len(scan.frames) == 1
    assert scan.skipped_frames[0].reason == "frame-000002.pose.txt is missing"


def test_no_pose_at_all_is_an_error(scan_folder):
    for path in scan_folder.glob("*.pose.txt"):
        path.unlink()
    with pytest.raises(InputError, match=r"no poses.*pose\.txt"):
        read_scan(scan_folder)


def test_all_poses_lost_is_an_error(scan_folder, matrix_text):
    for path in scan_folder.glob("*.pose.txt"):
        path.write_text(matrix_text(np.full((4, 4), -np.inf)))
    with pytest.raises(InputError, match="none of its 2 frames"):
        read_scan(scan_folder)


def test_constant_poses_are_no_poses(scan_folder, matrix_text):
    for path in scan_folder.glob("*.pose.txt"):
        path.write_text(matrix_text(np.eye(4)))
    with pytest.raises(InputError, match="no poses: all 2 frames"):
        read_scan(scan_folder)


def test_a_pose_that_is_not_rigid_names_its_file(scan_folder, matrix_text):
    (scan_folder / "frame-000010.pose.txt").write_text(matrix_text(np.diag((2.0, 1, 1, 1))))
    with pytest.raises(InputError, match=r"frame-000010\.pose\.txt.*not rigid"):
        read_scan(scan_folder)


def test_a_mirrored_pose_is_refused(scan_folder, matrix_text):
    (scan_folder / "frame-000010.pose.txt").write_text(matrix_text(np.diag((-1.0, 1, 1, 1))))
    with pytest.raises(InputError, match="mirrors"):
        read_scan(scan_folder)


def test_an_eight_bit_depth_map_is_refused_when_read(scan_folder):
    cv2.imwrite(str(scan_folder / "frame-000002.depth.png"), np.full((24, 32), 80, np.uint8))
    frame = read_scan(scan_folder).frames[0]
    with pytest.raises(InputError, match=r"frame-000002\.depth\.png.*8 bits"):
        read_depth(frame)


def test_one_damaged_depth_map_costs_only_its_frame(scan_folder):
    (scan_folder / "frame-000002.depth.png").write_bytes(b"not an image")
    scan = read_scan(scan_folder)
    assert (scan.frames[0].camera.width, scan.frames[0].camera.height) == (32, 24)
    with pytest.raises(InputError, match="does not decode"):
        read_depth(scan.frames[0])


def test_selection_is_by_position(scan_folder):
    assert [f.name for f in read_scan(scan_folder, ScanParams(first=1)).frames] == ["frame-000010"]
    assert [f.name for f in read_scan(scan_folder, ScanParams(last=0)).frames] == ["frame-000002"]
    assert [f.name for f in read_scan(scan_folder, ScanParams(every=2)).frames] == ["frame-000002"]


def test_red_kitchen(shared_data):
    scan = read_scan(shared_data / "rgbd" / "7scenes_redkitchen")
    assert len(scan.frames) == 100
    assert scan.frames[-1].name == "frame-000495"
    assert (scan.frames[0].camera.fx, scan.frames[0].camera.cx) == (585, 320)
    depth = read_depth(scan.frames[0])
    assert 0.3 < np.median(depth[depth > 0]) < 5
    assert depth.max() < 10


def test_tabletop_box_has_a_camera_file(shared_data):
    scan = read_scan(shared_data / "rgbd" / "tabletop_box_realsense")
    assert len(scan.frames) == 25
    assert scan.frames[0].camera.fx == pytest.approx(615.195, abs=1e-3)
    assert scan.frames[0].camera.cy == pytest.approx(247.519, abs=1e-3)


def test_one_damaged_pose_of_many_costs_only_its_frame(scan_folder, tiny, matrix_text):
    for number in range(20, 40):
        stem = f"frame-{number:06d}"
        tiny.color(scan_folder / f"{stem}.color.png")
        tiny.depth(scan_folder / f"{stem}.depth.png", 1000)
        (scan_folder / f"{stem}.pose.txt").write_text(matrix_text(tiny.second))
    (scan_folder / "frame-000025.pose.txt").write_text("1 0 0 0\n0 1 0")
    scan = read_scan(scan_folder)
    assert len(scan.frames) == 21
    (left,) = scan.skipped_frames
    assert left.name == "frame-000025"
    assert "its pose is damaged" in left.reason
    assert "it holds 7 numbers" in left.reason
    for number in (26, 27):
        (scan_folder / f"frame-{number:06d}.pose.txt").write_text("")
    with pytest.raises(InputError, match=r"frame-000025\.pose\.txt.*it holds 7 numbers"):
        read_scan(scan_folder)


def test_a_frame_without_its_depth_map_is_reported(scan_folder):
    (scan_folder / "frame-000010.depth.png").unlink()
    (left,) = read_scan(scan_folder).skipped_frames
    assert (left.name, left.reason) == ("frame-000010", "its depth map is missing")
