import shutil

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.aligned_color import read_color_aligned_to_depth
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

# The colour camera has the same view at three times the resolution and an off-centre principal point: the
# known pixel (26, 17) is at 300 · (0.1, 0.05) + (50, 33) = (80, 48) in its images.
COLOR_MATRIX = "300 0 50 0\n0 300 33 0\n0 0 1 0\n0 0 0 1\n"
COLOR_SIZE = (96, 72)


def marked_color(path, at=(80, 48)):
    """Write a black image with a green patch at the known pixel."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = np.zeros((COLOR_SIZE[1], COLOR_SIZE[0], 3), np.uint8)
    image[at[1] - 4 : at[1] + 5, at[0] - 4 : at[0] + 5] = (0, 255, 0)
    assert cv2.imwrite(str(path), image)


@pytest.fixture
def scan_folder(tmp_path, tiny, matrix_text):
    for number, pose in ((2, tiny.identity), (10, tiny.second)):
        marked_color(tmp_path / "color" / f"{number}.png")
        tiny.depth(tmp_path / "depth" / f"{number}.png", 1000)
        (tmp_path / "pose").mkdir(exist_ok=True)
        (tmp_path / "pose" / f"{number}.txt").write_text(matrix_text(pose))
    (tmp_path / "intrinsic").mkdir()
    (tmp_path / "intrinsic" / "intrinsic_depth.txt").write_text("100 0 16 0\n0 100 12 0\n0 0 1 0\n0 0 0 1\n")
    (tmp_path / "intrinsic" / "intrinsic_color.txt").write_text(COLOR_MATRIX)
    for stream in ("color", "depth"):
        (tmp_path / "intrinsic" / f"extrinsic_{stream}.txt").write_text(matrix_text(tiny.identity))
    return tmp_path


def test_known_points_come_out_in_the_world(scan_folder, tiny):
    scan = read_scan(scan_folder)
    assert scan.layout == "scannet"
    assert [frame.name for frame in scan.frames] == ["2", "10"]
    assert not scan.diagnostics
    for frame, point in zip(scan.frames, tiny.points, strict=True):
        np.testing.assert_allclose(tiny.seen(frame), point, atol=1e-6)


def test_z_is_up_only_in_original_scannet_folders(scan_folder, tmp_path):
    assert read_scan(scan_folder).up is None
    (scan_folder / "scene0000_00.txt").touch()
    assert read_scan(scan_folder).up.source == "layout scannet: z up"
    (scan_folder / "scene0000_00.txt").unlink()
    named = tmp_path.with_name("scene0707_01")
    scan_folder.rename(named)
    assert read_scan(named).up.direction == (0.0, 0.0, 1.0)


def test_a_colour_folder_of_another_name_is_read(scan_folder, tiny):
    (scan_folder / "color").rename(scan_folder / "rgb")
    scan = read_scan(scan_folder)
    assert scan.layout == "scannet"
    np.testing.assert_allclose([tiny.seen(frame) for frame in scan.frames], tiny.points, atol=1e-6)


def test_colour_is_found_through_its_own_camera(scan_folder):
    frame = read_scan(scan_folder).frames[0]
    color = read_color_aligned_to_depth(frame, read_depth(frame))
    assert color.shape == (24, 32, 3)
    rows, columns = np.nonzero(color[:, :, 1] > 128)
    assert (rows.mean(), columns.mean()) == (17, 26)


def test_intrinsics_of_the_larger_original_are_scaled(scan_folder):
    # Like colour reduced from 1296×968 to 96×72: the numbers are 13.5 and 13.444 times as large.
    (scan_folder / "intrinsic" / "intrinsic_color.txt").write_text(
        "4050 0 681.25\n0 4033.3333 449.88889\n0 0 1\n"
    )
    scan = read_scan(scan_folder)
    camera = scan.frames[0].color_camera
    np.testing.assert_allclose(
        (camera.fx, camera.fy, camera.cx, camera.cy),
        (300, 300, 681.75 / 13.5 - 0.5, 450.38889 / (968 / 72) - 0.5),
        atol=1e-3,
    )
    assert any("1296×968" in text for text in map(str, scan.diagnostics))


def test_without_a_colour_camera_colour_is_aligned_with_depth(scan_folder):
    (scan_folder / "intrinsic" / "intrinsic_color.txt").unlink()
    scan = read_scan(scan_folder)
    assert scan.frames[0].color_camera is None
    assert any("intrinsic_color" in text for text in map(str, scan.diagnostics))


@pytest.mark.parametrize("value", [-np.inf, np.nan])
def test_lost_poses_are_skipped_and_counted(scan_folder, matrix_text, value):
    (scan_folder / "pose" / "2.txt").write_text(matrix_text(np.full((4, 4), value)))
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == ["10"]
    assert "lost" in scan.skipped_frames[0].reason


def test_a_missing_pose_or_colour_skips_its_frame_only(scan_folder, tiny):
    (scan_folder / "pose" / "2.txt").unlink()
    tiny.depth(scan_folder / "depth" / "11.png", 1000)
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == ["10"]
    assert {one.name: one.reason for one in scan.skipped_frames} == {
        "2": "pose/2.txt is missing",
        "11": "color/ has no image with this number",
    }


def test_poses_can_be_given(scan_folder, tiny, matrix_text):
    for path in (scan_folder / "pose").iterdir():
        path.unlink()
    with pytest.raises(InputError, match=r"no poses: files like pose/2\.txt"):
        read_scan(scan_folder)
    (scan_folder / "mine.log").write_text(
        "0 0 1\n" + matrix_text(tiny.identity) + "1 1 2\n" + matrix_text(tiny.second)
    )
    frames = read_scan(scan_folder, ScanParams(poses="mine.log")).frames
    np.testing.assert_allclose([tiny.seen(frame) for frame in frames], tiny.points, atol=1e-6)


def test_intrinsics_that_are_missing_are_guessed_or_stated(scan_folder, tiny):
    (scan_folder / "intrinsic" / "intrinsic_depth.txt").unlink()
    scan = read_scan(scan_folder)
    assert scan.frames[0].camera.fx == 26.25
    assert any("is guessed" in text and "scan.intrinsics" in text for text in map(str, scan.diagnostics))
    frames = read_scan(scan_folder, ScanParams(intrinsics=tiny.option)).frames
    np.testing.assert_allclose([tiny.seen(frame) for frame in frames], tiny.points, atol=1e-6)


def test_extrinsics_that_are_not_the_identity_are_reported(scan_folder, tiny, matrix_text):
    (scan_folder / "intrinsic" / "extrinsic_color.txt").write_text(matrix_text(tiny.second))
    assert any("extrinsic_color" in text for text in map(str, read_scan(scan_folder).diagnostics))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "1 2 3",
        "a b c",
        "0 0 16\n0 100 12\n0 0 1\n",
        "nan 0 16 0 100 12 0 0 1",
        "1e308 0 16 0 100 12 0 0 1",
    ],
)
def test_wrong_intrinsics_are_refused(scan_folder, text):
    (scan_folder / "intrinsic" / "intrinsic_depth.txt").write_text(text)
    with pytest.raises(InputError, match=r"intrinsic_depth\.txt"):
        read_scan(scan_folder)


@pytest.mark.parametrize("text", ["", "1 2 3", "x", "1 0 0 nan 0 1 0 0 0 0 1 0"])
def test_a_wrong_pose_names_its_file(scan_folder, text):
    (scan_folder / "pose" / "10.txt").write_text(text)
    with pytest.raises(InputError, match=r"10\.txt"):
        read_scan(scan_folder)


def test_without_depth_the_images_are_single_views(scan_folder, tiny):
    shutil.rmtree(scan_folder / "depth")
    for path in (scan_folder / "intrinsic").glob("*color*"):
        path.unlink()
    for image in (scan_folder / "color").iterdir():
        tiny.color(image)
    scan = read_scan(scan_folder)
    assert (scan.layout, scan.is_metric) == ("scannet", True)
    tiny.assert_views(scan)


def test_real_views_without_depth(shared_data):
    scan = read_scan(shared_data / "real" / "scannet_views_no_depth")
    assert (scan.layout, scan.is_views, len(scan.frames)) == ("scannet", True, 4)
    assert scan.frames[0].camera.fx == pytest.approx(577.5907, abs=1e-4)
