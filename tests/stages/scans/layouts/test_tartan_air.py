import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

HALF = 0.5**0.5
# By hand: the first camera looks along world x (NED), so the known camera point (0.2, 0.1, 2), right, down
# and ahead, is (2, 0.2, 0.1). The second is turned by 90 degrees about z (down), from north to east, at
# (1, 2, 3): ahead is +y, right is -x.
POSES = f"0 0 0 0 0 0 1\n1 2 3 0 0 {HALF} {HALF}\n"
POINTS = ((2.0, 0.2, 0.1), (0.8, 4.0, 3.1))


@pytest.fixture
def scan_folder(tmp_path, tiny):
    (tmp_path / "depth_left").mkdir()
    for number in (0, 1):
        tiny.color(tmp_path / "image_left" / f"{number:06d}_left.png")
        depth = np.full((24, 32), 2, np.float32)
        depth[0, :2] = np.inf, 20000
        np.save(tmp_path / "depth_left" / f"{number:06d}_left_depth.npy", depth)
    (tmp_path / "pose_left.txt").write_text(POSES)
    return tmp_path


def test_known_points_come_out_in_the_world(scan_folder, tiny):
    scan = read_scan(scan_folder, ScanParams(intrinsics=tiny.option))
    assert scan.layout == "tartanair"
    assert not scan.is_stereo
    for frame, point in zip(scan.frames, POINTS, strict=True):
        np.testing.assert_allclose(tiny.seen(frame), point, atol=1e-6)
        assert read_depth(frame)[0, :3].tolist() == [0, 0, 2]


def test_the_camera_is_the_known_one_of_the_data_set(scan_folder):
    camera = read_scan(scan_folder).frames[0].camera
    numbers = (camera.fx, camera.fy, camera.cx, camera.cy)
    np.testing.assert_allclose(numbers, (16, 16, 15.525, 11.525))


def test_right_images_replace_missing_depth(scan_folder, tiny):
    for path in (scan_folder / "depth_left").iterdir():
        path.unlink()
    (scan_folder / "depth_left").rmdir()
    for number in (0, 1):
        tiny.color(scan_folder / "image_right" / f"{number:06d}_right.png")
    scan = read_scan(scan_folder)
    assert scan.is_stereo
    assert scan.rig.is_rectified
    assert scan.rig.right_from_left[0, 3] == -0.25
    frame = scan.frames[1]
    assert frame.right.name == "000001_right.png"
    assert frame.depth is None
    np.testing.assert_allclose((frame.world_from_camera @ (0.2, 0.1, 2, 1))[:3], POINTS[1], atol=1e-6)
    assert read_scan(scan_folder, ScanParams(baseline=0.5)).rig.baseline == 0.5


def test_depth_is_used_where_both_are_there(scan_folder, tiny):
    for number in (0, 1):
        tiny.color(scan_folder / "image_right" / f"{number:06d}_right.png")
    assert not read_scan(scan_folder).is_stereo


def test_neither_depth_nor_right_images(scan_folder):
    for path in (scan_folder / "depth_left").iterdir():
        path.unlink()
    (scan_folder / "depth_left").rmdir()
    with pytest.raises(InputError, match="depth_left/ or image_right/ is required"):
        read_scan(scan_folder)


def test_a_user_trajectory_has_opencv_axes(scan_folder, tiny, matrix_text):
    (scan_folder / "mine.log").write_text(
        "0 0 1\n" + matrix_text(tiny.identity) + "1 1 2\n" + matrix_text(tiny.second)
    )
    frames = read_scan(scan_folder, ScanParams(intrinsics=tiny.option, poses="mine.log")).frames
    np.testing.assert_allclose([tiny.seen(frame) for frame in frames], tiny.points, atol=1e-6)


@pytest.fixture
def second_version(tmp_path, tiny):
    (tmp_path / "depth_lcam_front").mkdir()
    for number in (0, 1):
        tiny.color(tmp_path / "image_lcam_front" / f"{number:06d}_lcam_front.png")
        depth = np.full((24, 32), 2, "<f4")
        depth[0, :4] = np.inf, 20000, 1.1, 0
        # The lowest byte is blue, the first channel in OpenCV.
        bytes_of = depth.view(np.uint8).reshape(24, 32, 4)
        path = tmp_path / "depth_lcam_front" / f"{number:06d}_lcam_front_depth.png"
        assert cv2.imwrite(str(path), bytes_of)
    (tmp_path / "pose_lcam_front.txt").write_text(POSES)
    return tmp_path


def test_the_second_version_packs_depth_in_four_channels(second_version, tiny):
    scan = read_scan(second_version, ScanParams(intrinsics=tiny.option))
    assert scan.layout == "tartanair"
    for frame, point in zip(scan.frames, POINTS, strict=True):
        np.testing.assert_allclose(tiny.seen(frame), point, atol=1e-6)
        np.testing.assert_array_equal(read_depth(frame)[0, :5], np.float32([0, 0, 1.1, 0, 2]))


def test_the_second_version_has_another_camera(second_version):
    for path in (second_version / "image_lcam_front").iterdir():
        cv2.imwrite(str(path), np.zeros((640, 640, 3), np.uint8))
    camera = read_scan(second_version).frames[0].camera
    assert (camera.width, camera.fx, camera.fy, camera.cx, camera.cy) == (640, 320, 320, 319.5, 319.5)


def test_pairs_of_the_second_version(second_version, tiny):
    for path in (second_version / "depth_lcam_front").iterdir():
        path.unlink()
    (second_version / "depth_lcam_front").rmdir()
    for number in (0, 1):
        tiny.color(second_version / "image_rcam_front" / f"{number:06d}_rcam_front.png")
    scan = read_scan(second_version)
    assert scan.rig.right_from_left[0, 3] == -0.25
    assert scan.frames[1].right.name == "000001_rcam_front.png"


@pytest.mark.parametrize("image", [np.zeros((24, 32), np.uint16), np.zeros((24, 32, 3), np.uint8)])
def test_depth_that_is_not_packed_is_refused(second_version, image):
    cv2.imwrite(str(second_version / "depth_lcam_front" / "000000_lcam_front_depth.png"), image)
    with pytest.raises(InputError, match=r"000000_lcam_front_depth\.png.*four 8-bit channels"):
        read_depth(read_scan(second_version).frames[0])


@pytest.mark.parametrize("text", ["", "1 2 3\n", "0 0 0 0 0 0 1\n", "0 0 0 0 0 0 1\n0 0 0 9 9 9 9\n", "x\n"])
def test_wrong_poses_are_refused(scan_folder, text):
    (scan_folder / "pose_left.txt").write_text(text)
    with pytest.raises(InputError, match=r"pose_left\.txt"):
        read_scan(scan_folder)


@pytest.mark.parametrize("data", [b"", b"\x93NUMPY", b"\x93NUMPY\x01\x00\xff\xff"])
def test_a_damaged_depth_map_costs_its_frame_only(scan_folder, data):
    (scan_folder / "depth_left" / "000000_left_depth.npy").write_bytes(data)
    first, second = read_scan(scan_folder).frames
    with pytest.raises(InputError, match=r"000000_left_depth\.npy"):
        read_depth(first)
    assert read_depth(second)[5, 5] == 2
