import json

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan


@pytest.fixture
def scan_folder(tmp_path, tiny, matrix_text):
    for number in (2, 10):
        tiny.color(tmp_path / "color" / f"{number}.jpg")
        tiny.depth(tmp_path / "depth" / f"{number}.png", 1000)
    (tmp_path / "trajectory.log").write_text(
        "0 0 1\n" + matrix_text(tiny.identity) + "1 1 2\n" + matrix_text(tiny.second)
    )
    # Column-major, like Open3D.
    (tmp_path / "intrinsic.json").write_text(
        json.dumps({"width": 32, "height": 24, "intrinsic_matrix": [100, 0, 0, 0, 100, 0, 16, 12, 1]})
    )
    return tmp_path


def points(folder, tiny, **options):
    return [tiny.seen(frame) for frame in read_scan(folder, ScanParams(**options)).frames]


def test_known_points_come_out_in_the_world(scan_folder, tiny):
    assert read_scan(scan_folder).layout == "redwood"
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


def test_json_trajectory_is_world_to_camera_column_major(scan_folder, tiny):
    (scan_folder / "trajectory.log").unlink()
    # camera_from_world of the second frame by hand: R^T = [[0,0,-1],[0,1,0],[1,0,0]], -R^T t = (3, -2, -1).
    extrinsics = [
        [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
        [0, 0, 1, 0, 0, 1, 0, 0, -1, 0, 0, 0, 3, -2, -1, 1],
    ]
    (scan_folder / "trajectory.json").write_text(
        json.dumps(
            {"class_name": "PinholeCameraTrajectory", "parameters": [{"extrinsic": e} for e in extrinsics]}
        )
    )
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


# Units per metre, and metres per unit.
@pytest.mark.parametrize("stated", [4000, 0.00025])
def test_depth_scale_of_the_intrinsic_file_is_used(scan_folder, tiny, stated):
    document = json.loads((scan_folder / "intrinsic.json").read_text())
    (scan_folder / "intrinsic.json").write_text(json.dumps(document | {"depth_scale": stated}))
    for number in (2, 10):
        tiny.depth(scan_folder / "depth" / f"{number}.png", 4000)
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


def test_depth_in_fifths_of_millimetres_is_reported(scan_folder):
    ramp = 5 * np.linspace(500, 1500, 32 * 24).reshape(24, 32).astype(np.uint16)
    for image in (scan_folder / "depth").iterdir():
        cv2.imwrite(str(image), ramp)
    scan = read_scan(scan_folder)
    assert scan.frames[0].depth_scale == 5000
    assert any(
        "multiples of five" in text and "scan.depth_scale=1000" in text for text in map(str, scan.diagnostics)
    )
    stated = read_scan(scan_folder, ScanParams(depth_scale=1000))
    assert (stated.frames[0].depth_scale, stated.diagnostics) == (1000, ())


def test_camera_of_another_size_is_refused(scan_folder):
    document = json.loads((scan_folder / "intrinsic.json").read_text())
    (scan_folder / "intrinsic.json").write_text(json.dumps(document | {"width": 640, "height": 400}))
    with pytest.raises(InputError, match=r"intrinsic\.json.*640×400.*32×24"):
        read_scan(scan_folder)


def test_without_intrinsics_the_default_is_used_and_reported(scan_folder):
    (scan_folder / "intrinsic.json").unlink()
    scan = read_scan(scan_folder)
    camera = scan.frames[0].camera
    # 525 pixels at a width of 640.
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (26.25, 26.25, 15.5, 11.5)
    assert any(
        "26.25,26.25,15.5,11.5 is guessed" in t and "scan.intrinsics" in t for t in map(str, scan.diagnostics)
    )


def test_fewer_poses_than_frames_stops(scan_folder, matrix_text):
    (scan_folder / "trajectory.log").write_text("0 0 1\n" + matrix_text(np.eye(4)))
    with pytest.raises(InputError, match=r"trajectory\.log.*1 poses.*2 frames"):
        read_scan(scan_folder)


def test_a_frame_without_colour_is_left_out(scan_folder, tiny):
    tiny.depth(scan_folder / "depth" / "11.png", 1000)
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == ["2", "10"]
    assert scan.skipped_frames[0].name == "11"


def test_unequal_counts_without_common_numbers_stop(scan_folder, tiny):
    for path in (scan_folder / "color").iterdir():
        path.rename(path.with_name(f"9{path.name}"))
    tiny.color(scan_folder / "color" / "95.jpg")
    with pytest.raises(InputError, match="2 images and color/ has 3"):
        read_scan(scan_folder)


def test_the_only_trajectory_is_found_by_any_name(scan_folder, tiny):
    (scan_folder / "trajectory.log").rename(scan_folder / "lounge_trajectory.log")
    (scan_folder / "odometry.log").write_text("")
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


def test_the_trajectory_may_be_in_the_parent_folder(scan_folder, tiny):
    inside = scan_folder / "rgbd"
    inside.mkdir()
    (scan_folder / "color").rename(inside / "image")
    (scan_folder / "depth").rename(inside / "depth")
    np.testing.assert_allclose(points(inside, tiny), tiny.points, atol=1e-6)


def test_no_trajectory_is_an_error(scan_folder):
    (scan_folder / "trajectory.log").unlink()
    with pytest.raises(InputError, match=r"no poses: trajectory\.log"):
        read_scan(scan_folder)


def test_open3d_test_data(shared_data):
    scan = read_scan(shared_data / "rgbd" / "open3d_testdata" / "RGBD")
    assert (scan.layout, len(scan.frames)) == ("redwood", 5)
    assert (scan.frames[0].camera.fx, scan.frames[0].camera.cx) == (525, 319.5)
    np.testing.assert_allclose(
        scan.frames[0].world_from_camera[:3, 3], (-0.31057997, 0.57301224, 2.12648002), atol=1e-7
    )
    assert any("camera_primesense.json" in text for text in map(str, scan.diagnostics))


def test_grey_images_may_be_in_a_folder_mono(scan_folder, tiny):
    (scan_folder / "color").rename(scan_folder / "mono")
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


def test_other_names_of_the_folders(scan_folder, tiny):
    (scan_folder / "depth").rename(scan_folder / "depth_images")
    (scan_folder / "color").rename(scan_folder / "images")
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


def test_colour_and_depth_side_by_side_in_the_order_of_their_numbers(scan_folder, tiny):
    for number in (2, 10):
        (scan_folder / "color" / f"{number}.jpg").rename(scan_folder / f"rgb_{number}.jpg")
        (scan_folder / "depth" / f"{number}.png").rename(scan_folder / f"depth_{number}.png")
    for name in ("color", "depth"):
        (scan_folder / name).rmdir()
    scan = read_scan(scan_folder)
    assert [(f.color.name, f.depth.name) for f in scan.frames] == [
        ("rgb_2.jpg", "depth_2.png"),
        ("rgb_10.jpg", "depth_10.png"),
    ]
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


def test_pictures_of_depth_are_no_depth(scan_folder, tiny):
    for number in (2, 10):
        tiny.color(scan_folder / "depth" / f"colorized_{number}.png")
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)
    for number in (2, 10):
        (scan_folder / "color" / f"{number}.jpg").rename(scan_folder / f"rgb_{number}.jpg")
        (scan_folder / "depth" / f"{number}.png").rename(scan_folder / f"depth_{number}.png")
        picture = scan_folder / f"depthColorized_{number}.png"
        (scan_folder / "depth" / f"colorized_{number}.png").rename(picture)
    for name in ("color", "depth"):
        (scan_folder / name).rmdir()
    scan = read_scan(scan_folder)
    assert [f.color.name for f in scan.frames] == ["rgb_2.jpg", "rgb_10.jpg"]
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


def test_a_real_recording_side_by_side(shared_data):
    scan = read_scan(shared_data / "rgbd" / "turntable_d435_data1", complete=False)
    assert (scan.layout, len(scan.frames)) == ("redwood", 6)
    assert [frame.color.name for frame in scan.frames] == [f"rgb_{i}.png" for i in range(6)]
    assert scan.frames[0].camera.fx == 525


def test_images_that_share_no_numbers_are_paired_in_order_and_reported(scan_folder, tiny):
    for old, new in (("2", "a"), ("10", "b")):
        (scan_folder / "color" / f"{old}.jpg").rename(scan_folder / "color" / f"{new}.jpg")
    scan = read_scan(scan_folder)
    assert [(f.color.name, f.depth.name) for f in scan.frames] == [("a.jpg", "2.png"), ("b.jpg", "10.png")]
    assert any("depth/ and color/ share no numbers" in text for text in map(str, scan.diagnostics))
    tiny.color(scan_folder / "color" / "c.jpg")
    with pytest.raises(InputError, match="2 images and color/ has 3"):
        read_scan(scan_folder)


def test_images_with_equal_numbers_give_no_warning(scan_folder):
    assert not any("share no numbers" in text for text in map(str, read_scan(scan_folder).diagnostics))


def test_a_camera_file_of_any_name_next_to_the_images(scan_folder, tiny):
    (scan_folder / "intrinsic.json").rename(scan_folder / "cam_params_mine.json")
    # A pose file also contains a matrix.
    (scan_folder / "world.txt").write_text("0 0 1 1\n0 1 0 2\n-1 0 0 3\n0 0 0 1\n")
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)
    said = "the camera is read from cam_params_mine.json, which was found next to the images"
    assert said in map(str, read_scan(scan_folder).diagnostics)


def test_results_of_adjust_are_not_used_as_calibration(scan_folder):
    camera = {"width": 32, "height": 24, "fx": 90, "fy": 90, "cx": 16, "cy": 12}
    (scan_folder / "intrinsic.json").rename(scan_folder / "mine.json")
    (scan_folder / "cameras.json").write_text(json.dumps({"accepted": True, "color_camera": camera}))
    assert read_scan(scan_folder).frames[0].camera.fx == 100
    with pytest.raises(InputError, match=r"this is the cameras\.json of `adjust`"):
        read_scan(scan_folder, ScanParams(calibration="cameras.json"))


def test_two_different_camera_files_are_ambiguous(scan_folder):
    document = json.loads((scan_folder / "intrinsic.json").read_text())
    (scan_folder / "intrinsic.json").rename(scan_folder / "a.json")
    document["intrinsic_matrix"][0] = 200
    (scan_folder / "b.json").write_text(json.dumps(document))
    scan = read_scan(scan_folder)
    assert scan.frames[0].camera.fx == 26.25
    assert any(
        text.startswith("a.json, b.json state different cameras") for text in map(str, scan.diagnostics)
    )


def test_a_real_camera_file_of_another_name(shared_data):
    scan = read_scan(shared_data / "real" / "realsense_box_open3d_json", complete=False)
    camera = scan.frames[0].camera
    expected = (617.25, 617.549, 317.392, 245.980)
    np.testing.assert_allclose((camera.fx, camera.fy, camera.cx, camera.cy), expected, atol=1e-3)


def test_a_pose_file_of_seven_columns_is_assigned_in_frame_order(scan_folder, tiny):
    (scan_folder / "trajectory.log").unlink()
    turned = " ".join(map(str, tiny.second_quaternion))
    (scan_folder / "gt.txt").write_text(f"# tx ty tz qx qy qz qw\n0 0 0 0 0 0 1\n1 2 3 {turned}\n")
    np.testing.assert_allclose(points(scan_folder, tiny, poses="gt.txt"), tiny.points, atol=1e-6)


def test_pose_files_do_not_hide_the_camera_file(scan_folder, tiny, matrix_text):
    (scan_folder / "intrinsic.json").rename(scan_folder / "mine.json")
    for number in range(70):
        (scan_folder / f"pose{number}.txt").write_text(matrix_text(tiny.second))
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('{"intrinsic_matrix": [100, 0, 0, 0, 100, 0, 16, 12', "the file is not valid JSON"),
        ('{"fx": 100, "fy": 100, "cx": 31, "cy": 23}', "its principal point is far from the centre"),
        ('{"fx": 100, "fy": 100, "cx": 16, "cy": 12, "width": 32, "height": 20}', "for images of 32×20"),
    ],
)
def test_an_unused_camera_file_is_reported(scan_folder, text, reason):
    (scan_folder / "intrinsic.json").unlink()
    (scan_folder / "mine.json").write_text(text)
    scan = read_scan(scan_folder)
    assert scan.frames[0].camera.is_guess
    (said,) = (one for one in map(str, scan.diagnostics) if one.startswith(f"{scan_folder / 'mine.json'}: "))
    assert "looks like a calibration but is not used" in said
    assert reason in said


@pytest.mark.parametrize("name", ["CMakeLists.txt", "requirements.txt"])
def test_texts_of_programs_state_no_camera(scan_folder, name):
    (scan_folder / "intrinsic.json").unlink()
    (scan_folder / name).write_text("# Focal + PCL 1.10\nif(PCL_VERSION VERSION_EQUAL 1.10)\n")
    said = " ".join(map(str, read_scan(scan_folder, complete=False).diagnostics))
    assert "has no intrinsics" in said
    assert name not in said


@pytest.mark.parametrize(("levels", "least"), [((0, 50, 100), 50), ((0, 1, 2), 1)])
def test_confidence_maps_exclude_the_lowest_level(scan_folder, levels, least):
    names = [path.name for path in sorted((scan_folder / "depth").iterdir())]
    (scan_folder / "confidence").mkdir()
    for name in names:
        trust = np.full((24, 32), levels[2], np.uint8)
        trust[5, 5:7] = levels[:2]
        assert cv2.imwrite(str(scan_folder / "confidence" / name), trust)
    scan = read_scan(scan_folder)
    assert [frame.min_confidence for frame in scan.frames] == [least] * len(names)
    depth = read_depth(scan.frames[0])
    assert (depth[5, 5] == 0, depth[5, 6] > 0) == (True, True)
    assert any(f"depth of confidence {least} or higher" in text for text in map(str, scan.diagnostics))
    best = read_depth(read_scan(scan_folder, ScanParams(min_confidence=levels[2])).frames[0])
    assert best[5, 6] == 0


def test_confidence_without_levels_is_asked_about(scan_folder):
    names = [path.name for path in sorted((scan_folder / "depth").iterdir())]
    (scan_folder / "confidence").mkdir()
    for name in names:
        trust = np.arange(24 * 32).reshape(24, 32).astype(np.uint8)
        assert cv2.imwrite(str(scan_folder / "confidence" / name), trust)
    scan = read_scan(scan_folder)
    assert scan.frames[0].confidence is None
    assert any("0 to 255: set scan.min_confidence=VALUE" in text for text in map(str, scan.diagnostics))
    asked = read_scan(scan_folder, ScanParams(min_confidence=200))
    assert read_depth(asked.frames[0])[0, 10] == 0


def test_a_real_phone_states_its_confidence(shared_data):
    scan = read_scan(shared_data / "real" / "phone_desk_no_calibration", complete=False)
    assert {frame.min_confidence for frame in scan.frames} == {50}
    assert any("levels 0, 50, 100" in text for text in map(str, scan.diagnostics))


@pytest.mark.parametrize("name", ["pose.txt", "of the camera.txt", "way.tum"])
def test_pose_files_are_found_under_any_name(scan_folder, tiny, name):
    # SLAMBench's form: a line per frame, in order, without times.
    (scan_folder / "trajectory.log").unlink()
    turned = " ".join(map(str, tiny.second_quaternion))
    times = ("0 ", "1 ") if name.endswith("tum") else ("", "")
    (scan_folder / name).write_text(f"{times[0]}0 0 0 0 0 0 1\n{times[1]}1 2 3 {turned}\n")
    (scan_folder / "notes.txt").write_text("we walked around\n")
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)
    warnings = [str(one) for one in read_scan(scan_folder).diagnostics]
    assert warnings == [f"the poses are read from {name}, which was found in the scan folder"]
    # Two candidates, or one with another number of poses, are ambiguous.
    (scan_folder / "other.txt").write_text("0 0 0 0 0 0 1\n" * 2)
    assert read_scan(scan_folder, complete=False).missing
    (scan_folder / "other.txt").unlink()
    (scan_folder / name).write_text("0 0 0 0 0 0 1\n" * 3)
    assert read_scan(scan_folder, complete=False).missing


def test_camera_and_poses_as_array_files(scan_folder, tiny):
    for name in ("trajectory.log", "intrinsic.json"):
        (scan_folder / name).unlink(missing_ok=True)
    np.save(scan_folder / "K.npy", np.array([[100.0, 0, 16], [0, 100, 12], [0, 0, 1]]))
    np.save(scan_folder / "poses.npy", np.stack([tiny.identity, tiny.second]))
    np.testing.assert_allclose(points(scan_folder, tiny), tiny.points, atol=1e-6)
    assert [str(one) for one in read_scan(scan_folder).diagnostics] == [
        "the poses are read from poses.npy, which was found in the scan folder",
        "the camera is read from K.npy, which was found next to the images",
    ]
    # Other arrays are ignored without a warning.
    np.save(scan_folder / "other.npy", np.zeros((7, 2)))
    assert len(read_scan(scan_folder).diagnostics) == 2


@pytest.mark.parametrize(
    ("size", "focal", "device"),
    [
        ((512, 424), 365, "a Kinect v2"),
        ((640, 576), 504, "an Azure Kinect"),
        ((256, 192), 187, "a phone's LiDAR"),
    ],
)
def test_without_intrinsics_the_device_is_guessed_from_the_depth_size(tmp_path, tiny, size, focal, device):
    for folder in ("color", "depth"):
        (tmp_path / folder).mkdir()
    for i in range(2):
        tiny.color(tmp_path / "color" / f"{i}.png")
        cv2.imwrite(str(tmp_path / "depth" / f"{i}.png"), np.full(size[::-1], 1500, np.uint16))
    scan = read_scan(tmp_path, complete=False)
    assert (scan.frames[0].camera.fx, scan.frames[0].camera.is_guess) == (focal, True)
    assert any(f"is guessed (the camera of {device}" in text for text in map(str, scan.diagnostics))
