from dataclasses import replace

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.image_folders.depth_units import infer_depth_scale
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.world import WorldUp
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan


@pytest.fixture
def scan_folder(tmp_path, tiny):
    folder = tmp_path / "rgbd_dataset_freiburg3_tiny"
    # The clock of the depth camera is 10 ms behind; the third colour frame has no depth close in time.
    color, depth = ("10.000000", "10.500000", "11.000000"), ("10.010000", "10.510000", "12.000000")
    for name in color:
        tiny.color(folder / "rgb" / f"{name}.png")
    for name in depth:
        tiny.depth(folder / "depth" / f"{name}.png", 5000)
    (folder / "rgb.txt").write_text("# color\n" + "".join(f"{n} rgb/{n}.png\n" for n in color))
    (folder / "depth.txt").write_text("# depth\n" + "".join(f"{n} depth/{n}.png\n" for n in depth))
    x, y, z, w = tiny.second_quaternion
    (folder / "groundtruth.txt").write_text(
        "# timestamp tx ty tz qx qy qz qw\n"
        "10.0100 0 0 0 0 0 0 1\n"
        "10.0150 0 0 0 0 0 0 1\n"
        f"10.5000 1 2 2 {x} {y} {z} {w}\n"
        f"10.5200 1 2 4 {x} {y} {z} {w}\n"
    )
    return folder


def test_known_points_come_out_in_the_world(scan_folder, tiny):
    # The second pose is halfway between two poses of the trajectory: (1, 2, 3).
    scan = read_scan(scan_folder, ScanParams(intrinsics=tiny.option))
    assert scan.layout == "tum"
    assert [tuple(np.round(tiny.seen(frame), 6)) for frame in scan.frames] == list(tiny.points)


def test_z_is_up_where_the_data_set_is_named(scan_folder, tmp_path):
    assert read_scan(scan_folder).up == WorldUp((0.0, 0.0, 1.0), "layout tum: z up")
    assert read_scan(scan_folder, ScanParams(poses="groundtruth.txt")).up is None
    mine = scan_folder.rename(tmp_path / "mine")
    assert read_scan(mine).up is None
    poses = (mine / "groundtruth.txt").read_text()
    (mine / "groundtruth.txt").write_text(f"# file: 'rgbd_dataset_freiburg2_desk.bag'\n{poses}")
    assert read_scan(mine).up is not None


def test_frames_without_a_partner_in_time_are_skipped(scan_folder):
    scan = read_scan(scan_folder)
    assert [one.name for one in scan.skipped_frames] == ["11.000000"]
    assert "0.02 s" in scan.skipped_frames[0].reason


def test_frames_without_a_pose_in_time_are_skipped(scan_folder):
    lines = (scan_folder / "groundtruth.txt").read_text().splitlines()
    (scan_folder / "groundtruth.txt").write_text("\n".join(lines[:3]))
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == ["10.000000"]
    assert any(one.reason.startswith("the trajectory has no pose within") for one in scan.skipped_frames)


def test_an_excerpt_may_keep_the_lists_of_the_whole(scan_folder):
    (scan_folder / "depth" / "10.010000.png").unlink()
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == ["10.500000"]
    assert ("10.000000", "10.010000.png is missing") in [
        (one.name, one.reason) for one in scan.skipped_frames
    ]


def test_a_folder_of_another_name_is_found_and_reported(scan_folder, tiny):
    (scan_folder / "depth").rename(scan_folder / "depths")
    scan = read_scan(scan_folder, ScanParams(intrinsics=tiny.option))
    assert [tuple(np.round(tiny.seen(frame), 6)) for frame in scan.frames] == list(tiny.points)
    assert any(
        "folder depth/ does not exist: the listed images are read from depths/" in text
        for text in map(str, scan.diagnostics)
    )


def test_two_candidate_folders_are_ambiguous(scan_folder, tiny):
    (scan_folder / "depth").rename(scan_folder / "depths")
    tiny.depth(scan_folder / "filled" / "10.010000.png", 5000)
    with pytest.raises(InputError, match=r"depth/10\.010000\.png: the image cannot be opened"):
        read_scan(scan_folder)


def test_each_depth_frame_is_used_once(scan_folder, tiny):
    tiny.color(scan_folder / "rgb" / "10.015000.png")
    with (scan_folder / "rgb.txt").open("a") as file:
        file.write("10.015000 rgb/10.015000.png\n")
    scan = read_scan(scan_folder)
    used = [frame.depth for frame in scan.frames]
    assert len(set(used)) == len(used) == 2
    # The colour frame 5 ms away gets this depth, not the one 10 ms away.
    assert "10.015000" in [frame.name for frame in scan.frames]


def test_the_camera_follows_the_folder_name(scan_folder):
    scan = read_scan(scan_folder)
    camera = scan.frames[0].camera
    # A twentieth of the resolution of the data set; pixel centres are at integers.
    expected = (535.4 / 20, 539.2 / 20, (320.1 + 0.5) / 20 - 0.5, (247.6 + 0.5) / 20 - 0.5)
    np.testing.assert_allclose((camera.fx, camera.fy, camera.cx, camera.cy), expected)
    assert camera.distortion == ()
    assert any("freiburg3" in text for text in map(str, scan.diagnostics))


FREIBURG_1 = (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)


def test_freiburg1_keeps_its_distortion(scan_folder):
    moved = scan_folder.rename(scan_folder.with_name("rgbd_dataset_freiburg1_room"))
    assert read_scan(moved).frames[0].camera.distortion == FREIBURG_1


def test_lists_have_priority_over_folder_names(scan_folder):
    rgb = scan_folder / "rgb.txt"
    listed = rgb.read_text()
    rgb.write_text("# color images\n# file: 'rgbd_dataset_freiburg1_xyz.bag'\n" + listed)
    scan = read_scan(scan_folder)
    assert scan.frames[0].camera.distortion == FREIBURG_1
    assert "the camera of freiburg1 is used, according to the recording name in the file lists" in map(
        str, scan.diagnostics
    )
    rgb.write_text("# color images\n# file: 'lab.bag'\n" + listed)
    assert read_scan(scan_folder).frames[0].camera.fx == 26.25


@pytest.mark.parametrize("name", ["freiburg1", "fr1_desk"])
def test_a_stranger_in_a_folder_of_the_data_sets_name(scan_folder, name):
    scan = read_scan(scan_folder.rename(scan_folder.with_name(name)))
    assert scan.frames[0].camera.fx == 26.25
    assert scan.up is None
    assert any(
        "the lens distortion of the data set is not applied" in text for text in map(str, scan.diagnostics)
    )


def test_orb_slam_settings_next_to_the_images(scan_folder, tiny):
    moved = scan_folder.rename(scan_folder.with_name("desk"))
    for stamp in ("10.010000", "10.510000"):
        if (image := moved / "depth" / f"{stamp}.png").exists():
            tiny.depth(image, 4000)
    (moved / "mine.yaml").write_text(
        "%YAML:1.0\nCamera.fx: 100.0\nCamera.fy: 100.0\nCamera.cx: 16.0\nCamera.cy: 12.0\n"
        "Camera.k1: 0.0\nDepthMapFactor: 4000.0\n"
    )
    scan = read_scan(moved)
    assert (scan.frames[0].camera.fx, scan.frames[0].depth_scale) == (100, 4000)
    said = "the camera is read from mine.yaml, which was found next to the images"
    assert [str(one) for one in scan.diagnostics] == [said]


def test_real_recordings_are_known_by_their_lists(shared_data, tmp_path):
    source = shared_data / "real" / "rgbd_dataset_freiburg1_rpy"
    (tmp_path / "mine").symlink_to(source, target_is_directory=True)
    assert read_scan(source).frames[0].camera.distortion == FREIBURG_1
    keyframes = read_scan(shared_data / "real" / "freiburg3_cabinet_keyframes", complete=False)
    assert keyframes.frames[0].camera.fx == 535.4
    assert "the camera is read from TUM3.yaml, which was found next to the images" in map(
        str, keyframes.diagnostics
    )


def test_an_unknown_camera_is_reported(scan_folder):
    moved = scan_folder.rename(scan_folder.with_name("desk"))
    scan = read_scan(moved)
    assert scan.frames[0].camera.fx == 26.25
    assert any("scan.intrinsics" in text for text in map(str, scan.diagnostics))
    assert any("scan.depth_scale=1000" in text for text in map(str, scan.diagnostics))
    stated = read_scan(moved, ScanParams(depth_scale=1000, intrinsics="100,100,16,12"))
    assert not stated.diagnostics


def test_implausibly_near_depth_is_read_as_millimetres(scan_folder):
    # 0.5 to 1.5 m in millimetres would be 0.1 to 0.3 m in TUM's units.
    moved = scan_folder.rename(scan_folder.with_name("desk"))
    ramp = np.linspace(500, 1500, 32 * 24).reshape(24, 32).astype(np.uint16)
    for image in (moved / "depth").iterdir():
        cv2.imwrite(str(image), ramp)
    scan = read_scan(moved, ScanParams(intrinsics="100,100,16,12"))
    assert scan.frames[0].depth_scale == 1000
    (said,) = map(str, scan.diagnostics)
    assert "scan.depth_scale=5000" in said
    stated = read_scan(moved, ScanParams(depth_scale=5000, intrinsics="100,100,16,12"))
    assert (stated.frames[0].depth_scale, stated.diagnostics) == (5000, ())


def test_whole_millimetres_times_five_are_known(scan_folder):
    moved = scan_folder.rename(scan_folder.with_name("desk"))
    ramp = 5 * np.linspace(500, 1500, 32 * 24).reshape(24, 32).astype(np.uint16)
    for image in (moved / "depth").iterdir():
        cv2.imwrite(str(image), ramp)
    scan = read_scan(moved, ScanParams(intrinsics="100,100,16,12"))
    assert (scan.frames[0].depth_scale, scan.diagnostics) == (5000, ())


def test_poses_with_times_for_images_with_counters(scan_folder, tiny):
    """Packed keyframes: the lists contain counters, and the poses contain times of the recording."""
    (scan_folder / "groundtruth.txt").rename(scan_folder / "truth_cam_poses.txt")
    poses = (scan_folder / "truth_cam_poses.txt").read_text().splitlines()
    (scan_folder / "truth_cam_poses.txt").write_text(
        "\n".join([poses[1], poses[3].replace(" 2 2 ", " 2 3 ")])
    )
    for name in ("rgb", "depth"):
        images = sorted((scan_folder / name).iterdir())[:2]
        listed = "".join(f"{k} {name}/{image.name}\n" for k, image in enumerate(images))
        (scan_folder / f"{name}.txt").write_text(listed)
    scan = read_scan(scan_folder, ScanParams(intrinsics=tiny.option))
    assert [tuple(np.round(tiny.seen(frame), 6)) for frame in scan.frames] == list(tiny.points)
    (said,) = (text for text in map(str, scan.diagnostics) if "truth_cam_poses.txt" in text)
    assert "which was found in the scan folder. The image timestamps only count frames" in said
    assert scan.missing == ()


def test_poses_of_another_time_are_not_used(scan_folder):
    text = (scan_folder / "groundtruth.txt").read_text().splitlines()
    (scan_folder / "groundtruth.txt").unlink()
    (scan_folder / "other.txt").write_text("\n".join(line.replace("10.", "500.") for line in text[1:3]))
    scan = read_scan(scan_folder, complete=False)
    assert [frame.world_from_camera for frame in scan.frames] == [None, None]
    assert any("groundtruth.txt is missing" in lacking for lacking in map(str, scan.missing))


def test_the_unit_of_real_depth_is_detected(shared_data):
    desk = read_scan(shared_data / "rgbd" / "realsense_desk_tum_layout", complete=False)
    assert desk.frames[0].depth_scale == 1000
    rpy = sorted((shared_data / "real" / "rgbd_dataset_freiburg1_rpy" / "depth").iterdir())
    assert infer_depth_scale(rpy) is None
    cabinet = sorted((shared_data / "real" / "freiburg3_cabinet_keyframes" / "depth_imgs").iterdir())
    assert infer_depth_scale(cabinet) == 5000


def test_scale_can_be_stated(scan_folder):
    depth = read_depth(read_scan(scan_folder, ScanParams(depth_scale=10000)).frames[0])
    assert depth[5, 5] == 1.0


def test_without_lists_the_names_are_the_times(scan_folder, tiny):
    for name in ("rgb.txt", "depth.txt"):
        (scan_folder / name).unlink()
    scan = read_scan(scan_folder, ScanParams(intrinsics=tiny.option))
    assert scan.layout == "tum"
    assert [tuple(np.round(tiny.seen(frame), 6)) for frame in scan.frames] == list(tiny.points)
    assert [one.name for one in scan.skipped_frames] == ["11.000000"]
    assert any("timestamps in their names" in text for text in map(str, scan.diagnostics))


def test_associations_replace_missing_lists(scan_folder, tiny):
    for name in ("rgb.txt", "depth.txt"):
        (scan_folder / name).unlink()
    (scan_folder / "depth").rename(scan_folder / "depths")
    (scan_folder / "associations.txt").write_text(
        "10.00 rgb/10.000000.png 10.01 depths/10.010000.png\n"
        "10.51 depths/10.510000.png 10.50 rgb/10.500000.png\n"
    )
    scan = read_scan(scan_folder, ScanParams(intrinsics=tiny.option))
    assert [tuple(np.round(tiny.seen(frame), 6)) for frame in scan.frames] == list(tiny.points)
    assert [frame.timestamp for frame in scan.frames] == [10_000_000_000, 10_500_000_000]


def test_non_increasing_times_are_reported_and_the_order_kept(scan_folder):
    lines = (scan_folder / "rgb.txt").read_text().splitlines()
    (scan_folder / "rgb.txt").write_text("\n".join((lines[2], lines[1])))
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == ["10.500000", "10.000000"]
    assert any("stay in the order of their files" in text for text in map(str, scan.diagnostics))


@pytest.mark.parametrize("text", ["now rgb/1.png\n", "1e99 rgb/1.png\n", "1\n", "1 ../../1.png\n", "\n"])
def test_damaged_lists_are_reported(scan_folder, text):
    (scan_folder / "rgb.txt").write_text(text)
    with pytest.raises(InputError, match=r"rgb\.txt"):
        read_scan(scan_folder)


def test_lists_of_files_that_are_not_there(scan_folder):
    (scan_folder / "rgb.txt").write_text("10.0 rgb/a.png\n10.5 rgb/b.png\n")
    with pytest.raises(InputError, match=r"none of its 2 frames can be used \(frame a: a\.png is missing\)"):
        read_scan(scan_folder)


def test_poses_without_times_cannot_be_paired(scan_folder):
    (scan_folder / "groundtruth.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    with pytest.raises(InputError, match=r"groundtruth\.txt.*no timestamps"):
        read_scan(scan_folder)


def test_desk_excerpt_lacks_poses(shared_data):
    with pytest.raises(InputError, match=r"realsense_desk_tum_layout.*no poses: groundtruth\.txt"):
        read_scan(shared_data / "rgbd" / "realsense_desk_tum_layout")


def test_poses_of_another_clock_are_offered_to_be_paired_by_order(scan_folder, tiny):
    turned = " ".join(map(str, tiny.second_quaternion))
    (scan_folder / "mine.txt").write_text(f"500.0 0 0 0 0 0 0 1\n500.5 1 2 3 {turned}\n")
    named = ScanParams(poses="mine.txt", intrinsics=tiny.option)
    said = r"cover 500\.000 to 500\.500 s, the frames 10\.010 to 10\.510 s\. There are as many"
    with pytest.raises(InputError, match=said):
        read_scan(scan_folder, named)
    scan = read_scan(scan_folder, replace(named, poses_by_order=True))
    assert [tuple(np.round(tiny.seen(frame), 6)) for frame in scan.frames] == list(tiny.points)
    with (scan_folder / "mine.txt").open("a") as file:
        file.write("501.0 0 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match=r"10\.510 s\.$"):
        read_scan(scan_folder, named)


def test_real_key_frames_whose_poses_have_other_times(shared_data):
    folder = shared_data / "real" / "freiburg3_cabinet_keyframes"
    named = ScanParams(poses="truth_cam_poses.txt")
    with pytest.raises(InputError, match=r"none of its 58 poses .* as many poses as frames: scan\.poses"):
        read_scan(folder, named)
    assert len(read_scan(folder, replace(named, poses_by_order=True)).frames) == 58


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (" rgb/", ",rgb/"),
        ("rgb/", "rgb\\"),
        ("rgb/", "/home/me/recording/rgb/"),
        ("rgb/", "C:\\recording\\rgb\\"),
        ("\n", "\r\n"),
    ],
)
def test_lists_of_other_systems_are_read(scan_folder, tiny, old, new):
    # Lists written by another program on another machine.
    path = scan_folder / "rgb.txt"
    known = read_scan(scan_folder, ScanParams(intrinsics=tiny.option))
    assert old in path.read_text()
    path.write_bytes(path.read_text().replace(old, new).encode("utf-16"))
    found = read_scan(scan_folder, ScanParams(intrinsics=tiny.option))
    assert [frame.color for frame in found.frames] == [frame.color for frame in known.frames]


def without_depth(folder):
    (folder / "depth.txt").unlink()
    (folder / "depth").rename(folder.parent / "elsewhere")
    return folder


def test_a_recording_without_depth_is_read_as_views(scan_folder):
    scan = read_scan(without_depth(scan_folder))
    assert (scan.layout, [one.depth for one in scan.frames]) == ("tum", [None, None])
    assert [one.name for one in scan.frames] == ["10.000000", "10.500000"]
    assert [(one.name, one.reason) for one in scan.skipped_frames] == [
        ("11.000000", "the trajectory has no pose within 0.02 s")
    ]
    # Reduced from 640x480 to 32x24 pixels.
    assert scan.frames[0].camera.fx == pytest.approx(535.4 / 20)
    assert "the camera of freiburg3 is used, according to the folder name" in map(str, scan.diagnostics)
    np.testing.assert_allclose(scan.frames[1].world_from_camera[:3, 3], (1, 2, 2), atol=1e-9)
    assert scan.up is not None
    (scan_folder / "groundtruth.txt").unlink()
    with pytest.raises(InputError, match=r"no poses: groundtruth\.txt is missing"):
        read_scan(scan_folder)


def test_a_list_of_depth_alone_is_no_recording_of_views(scan_folder):
    (scan_folder / "depth").rename(scan_folder.parent / "elsewhere")
    with pytest.raises(InputError, match="depth"):
        read_scan(scan_folder)


def test_a_photo_that_is_gone_is_skipped(scan_folder):
    (without_depth(scan_folder) / "rgb" / "10.000000.png").unlink()
    scan = read_scan(scan_folder)
    assert [one.name for one in scan.frames] == ["10.500000"]
    assert "10.000000" in [one.name for one in scan.skipped_frames]


def test_real_photos_of_a_recording_without_their_depth(shared_data, tmp_path):
    real = shared_data / "real" / "rgbd_dataset_freiburg1_rpy"
    for name in ("rgb", "rgb.txt", "groundtruth.txt"):
        (tmp_path / name).symlink_to(real / name)
    scan = read_scan(tmp_path)
    assert (len(scan.frames), scan.frames[0].camera.fx) == (24, 517.3)
    assert "the camera of freiburg1 is used, according to the recording name in the file lists" in map(
        str, scan.diagnostics
    )
