import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_color, read_right
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

# P0 and P1: baseline 0.5 m. P2 and P3: the colour pair is 0.06 m left of camera 0, baseline 0.54 m.
CALIB = """P0: 100 0 16 0 0 100 12 0 0 0 1 0
P1: 100 0 16 -50 0 100 12 0 0 0 1 0
P2: 100 0 16 6 0 100 12 0 0 0 1 0
P3: 100 0 16 -48 0 100 12 0 0 0 1 0
Tr: 0 -1 0 0 0 0 -1 0 1 0 0 0
"""
POSES = "1 0 0 0 0 1 0 0 0 0 1 0\n0 0 1 1 0 1 0 2 -1 0 0 3\n"
BARE = "100 0 16 0 0 100 12 0 0 0 1 0\n100 0 16 -50 0 100 12 0 0 0 1 0"


@pytest.fixture
def scan_folder(tmp_path, tiny):
    for side in ("image_0", "image_1"):
        for number in (0, 1):
            tiny.color(tmp_path / side / f"{number:06d}.png")
    (tmp_path / "calib.txt").write_text(CALIB)
    (tmp_path / "poses.txt").write_text(POSES)
    return tmp_path


def test_known_points_fall_on_known_pixels_of_both_images(scan_folder, tiny):
    scan = read_scan(scan_folder)
    assert (scan.layout, scan.rig.is_rectified) == ("kitti", True)
    assert scan.rig.baseline == pytest.approx(0.5)
    for frame, point in zip(scan.frames, tiny.points, strict=True):
        camera_from_world = np.linalg.inv(frame.world_from_camera)
        np.testing.assert_allclose(tiny.pixel(point, camera_from_world, frame.camera), (26, 17))
        # Disparity f b / z = 100 * 0.5 / 2.
        right = tiny.pixel(point, scan.rig.right_from_left @ camera_from_world, scan.rig.right)
        np.testing.assert_allclose(right, (26 - 25, 17))


def test_colour_cameras_are_preferred_and_their_offset_counts(scan_folder, tiny):
    for side in ("image_2", "image_3"):
        for number in (0, 1):
            tiny.color(scan_folder / side / f"{number:06d}.png")
    scan = read_scan(scan_folder)
    assert scan.frames[0].color.parent.name == "image_2"
    assert scan.rig.baseline == pytest.approx(0.54)
    # K [I | t] with t = 6 / 100: a point is 0.06 m farther right in camera 2, which is to the left.
    np.testing.assert_allclose(scan.frames[0].world_from_camera[:3, 3], (-0.06, 0, 0), atol=1e-12)
    # Frame 1 faces world +x; its x axis is world -z, so 0.06 m to its left is +z.
    np.testing.assert_allclose(scan.frames[1].world_from_camera[:3, 3], (1, 2, 3.06), atol=1e-12)


def test_bare_rows_and_other_folder_names(scan_folder):
    (scan_folder / "calib.txt").write_text(BARE)
    (scan_folder / "image_0").rename(scan_folder / "image_l")
    (scan_folder / "image_1").rename(scan_folder / "image_r")
    scan = read_scan(scan_folder)
    assert scan.layout == "kitti"
    assert scan.rig.baseline == pytest.approx(0.5)
    assert scan.frames[0].right.parent.name == "image_r"


def test_poses_where_the_data_set_keeps_them(scan_folder, tmp_path):
    sequence = tmp_path / "dataset" / "sequences" / "07"
    sequence.mkdir(parents=True)
    for name in ("image_0", "image_1", "calib.txt"):
        (scan_folder / name).rename(sequence / name)
    (tmp_path / "dataset" / "poses").mkdir()
    (scan_folder / "poses.txt").rename(tmp_path / "dataset" / "poses" / "07.txt")
    np.testing.assert_allclose(read_scan(sequence).frames[1].world_from_camera[:3, 3], (1, 2, 3))


def test_times_become_nanoseconds(scan_folder):
    (scan_folder / "times.txt").write_text("0.0\n1.036224e-01\n")
    assert [frame.timestamp for frame in read_scan(scan_folder).frames] == [0, 103622400]


def test_repeated_and_falling_times_are_warned_of(scan_folder):
    (scan_folder / "times.txt").write_text("0.2\n0.1\n")
    assert any("earlier" in text for text in map(str, read_scan(scan_folder).diagnostics))


def test_a_trimmed_sequence_finds_its_poses_by_number(scan_folder):
    for side in ("image_0", "image_1"):
        (scan_folder / side / "000000.png").rename(scan_folder / side / "000002.png")
    (scan_folder / "poses.txt").write_text(POSES + "1 0 0 7 0 1 0 7 0 0 1 7\n")
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == ["000001", "000002"]
    np.testing.assert_allclose([f.world_from_camera[:3, 3] for f in scan.frames], [(1, 2, 3), (7, 7, 7)])


def test_fewer_poses_than_frames_stops(scan_folder):
    (scan_folder / "poses.txt").write_text(POSES.splitlines()[0])
    with pytest.raises(InputError, match=r"poses\.txt.*1 poses.*2 frames"):
        read_scan(scan_folder)


def test_no_poses(scan_folder):
    (scan_folder / "poses.txt").unlink()
    with pytest.raises(InputError, match=r"no poses: poses\.txt"):
        read_scan(scan_folder)


def test_no_calibration(scan_folder):
    (scan_folder / "calib.txt").unlink()
    with pytest.raises(InputError, match=r"calib\.txt"):
        read_scan(scan_folder)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("P0: 1 2 3\n", r"line 1 \(P0\) must be 12 finite numbers"),
        ("P0: 100 0 16 0 0 100 12 0 0 0 1 0\n", "no two projection matrices"),
        (CALIB.replace("-50", "50"), "not right of the first"),
        (CALIB.replace("P1: 100", "P1: 0"), "focal length"),
        (CALIB.replace("P1: 100", "P1: nan"), r"P1"),
    ],
)
def test_damaged_calibrations_are_reported(scan_folder, text, message):
    (scan_folder / "calib.txt").write_text(text)
    with pytest.raises(InputError, match=message):
        read_scan(scan_folder)


def test_a_pair_that_lacks_a_side_is_left_out(scan_folder):
    (scan_folder / "image_1" / "000000.png").unlink()
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == ["000001"]
    # Poses are assigned by frame number.
    np.testing.assert_allclose(scan.frames[0].world_from_camera[:3, 3], (1, 2, 3))


def test_other_poses_can_be_named(scan_folder):
    (scan_folder / "poses.txt").rename(scan_folder / "mine.kitti")
    assert len(read_scan(scan_folder, ScanParams(poses="mine.kitti")).frames) == 2


def test_excerpt(shared_data):
    scan = read_scan(shared_data / "stereo" / "kitti_sequence_1")
    assert (scan.layout, len(scan.frames)) == ("kitti", 41)
    assert scan.rig.baseline == pytest.approx(0.5372, abs=1e-4)
    assert (scan.rig.left.fx, scan.rig.left.width) == (707.0912, 1226)
    travelled = np.diff([frame.world_from_camera[:3, 3] for frame in scan.frames], axis=0)
    np.testing.assert_allclose(np.linalg.norm(travelled, axis=1), 1.2, atol=0.02)
    assert read_color(scan.frames[0]).shape == read_right(scan.frames[0]).shape == (370, 1226, 3)


RAW = """calib_time: 09-Jan-2012 13:57:47
S_02: 6.4e+01 4.8e+01
K_02: 99 0 30 0 99 20 0 0 1
S_rect_02: 3.200000e+01 2.400000e+01
P_rect_02: 100 0 16 6 0 100 12 0 0 0 1 0
S_rect_03: 3.200000e+01 2.400000e+01
P_rect_03: 100 0 16 -48 0 100 12 0 0 0 1 0
"""


@pytest.fixture
def drive(tmp_path, tiny):
    folder = tmp_path / "2011_09_26" / "2011_09_26_drive_0001_sync"
    for side in ("image_02", "image_03"):
        for number in (0, 1):
            tiny.color(folder / side / "data" / f"{number:010d}.png")
        (folder / side / "timestamps.txt").write_text(
            "2011-09-26 13:02:25.964389445\n2011-09-26 13:02:26.064389445\n"
        )
    (folder.parent / "calib_cam_to_cam.txt").write_text(RAW)
    (folder / "mine.txt").write_text(POSES)
    return folder


def test_raw_recordings(drive, tiny):
    with pytest.raises(InputError, match="no poses"):
        read_scan(drive)
    scan = read_scan(drive, ScanParams(poses="mine.txt"))
    assert scan.layout == "kitti"
    assert scan.rig.baseline == pytest.approx(0.54)
    # 2011-09-26 is day 15243 of the epoch; 13:02:25 is second 46945 of it.
    first = (15243 * 86400 + 46945) * 10**9 + 964389445
    assert [frame.timestamp for frame in scan.frames] == [first, first + 10**8]
    # Poses are of camera 0, 0.06 m right of camera 2, where the point is therefore 6 / 2 pixels farther
    # right.
    camera_from_world = np.linalg.inv(scan.frames[0].world_from_camera)
    np.testing.assert_allclose(tiny.pixel(tiny.points[0], camera_from_world, scan.rig.left), (29, 17))


def test_raw_recordings_that_are_not_rectified_are_refused(drive):
    calib = drive.parent / "calib_cam_to_cam.txt"
    calib.write_text(
        RAW.replace("S_rect_02: 3.2", "S_rect_02: 1.2").replace("S_rect_03: 3.2", "S_rect_03: 1.2")
    )
    with pytest.raises(InputError, match=r"calib_cam_to_cam\.txt.*12×24.*32×24.*not rectified"):
        read_scan(drive, ScanParams(poses="mine.txt"))


@pytest.mark.parametrize(
    "text", ["yesterday\n", "2011-09-26 13:02:25.9x\n2011-09-26 13:02:26.0\n", "2011\n" * 2]
)
def test_damaged_dates_are_reported(drive, text):
    (drive / "image_02" / "timestamps.txt").write_text(text)
    with pytest.raises(InputError, match=r"timestamps\.txt"):
        read_scan(drive, ScanParams(poses="mine.txt"))


@pytest.mark.parametrize("number", range(4))
def test_images_of_one_camera_are_views_with_its_projection(scan_folder, tiny, number):
    for side in ("image_0", "image_1"):
        (scan_folder / side).rename(scan_folder.parent / f"{scan_folder.name}_{side}")
    for at in (0, 1):
        tiny.color(scan_folder / f"image_{number}" / f"{at:06d}.png")
    scan = read_scan(scan_folder)
    assert (scan.layout, scan.is_stereo, [one.depth for one in scan.frames]) == ("kitti", False, [None, None])
    # K [I | t]: camera 1 is 0.5 m right of camera 0, camera 2 is 0.06 m left of it, camera 3 is 0.48 m right
    # of it.
    stands_right = (0, 0.5, -0.06, 0.48)[number]
    np.testing.assert_allclose(scan.frames[0].world_from_camera[:3, 3], (stands_right, 0, 0), atol=1e-12)
    np.testing.assert_allclose(scan.frames[1].world_from_camera[:3, 3], (1, 2, 3 - stands_right), atol=1e-12)
    assert (scan.frames[0].camera.fx, scan.frames[0].camera.cx) == (100, 16)


def test_images_of_one_camera_without_its_projection_are_plain_views(scan_folder):
    (scan_folder / "image_1").rename(scan_folder.parent / f"{scan_folder.name}_other")
    (scan_folder / "calib.txt").write_text("P2: 100 0 16 6 0 100 12 0 0 0 1 0\n")
    scan = read_scan(scan_folder, complete=False)
    assert (scan.layout, len(scan.frames)) == ("plain-views", 2)
