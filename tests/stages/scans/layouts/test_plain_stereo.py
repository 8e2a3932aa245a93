import json
import re
from pathlib import Path

import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.inspecting.unused_files import find_unused_files
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

CAMERA = {"fx": 100, "fy": 100, "cx": 16, "cy": 12}


@pytest.fixture
def scan_folder(tmp_path, tiny):
    for side in ("left", "right"):
        for number in (2, 10):
            tiny.color(tmp_path / side / f"{side}{number}.png")
    (tmp_path / "calibration.json").write_text(json.dumps({**CAMERA, "baseline": 0.5}))
    (tmp_path / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n0 0 1 1 0 1 0 2 -1 0 0 3\n")
    return tmp_path


def assert_known_pixels(scan, tiny):
    assert scan.layout == "plain-stereo"
    assert len(scan.frames) == 2
    for frame, point in zip(scan.frames, tiny.points, strict=True):
        camera_from_world = np.linalg.inv(frame.world_from_camera)
        np.testing.assert_allclose(tiny.pixel(point, camera_from_world, frame.camera), (26, 17), atol=1e-6)
        right = tiny.pixel(point, scan.rig.right_from_left @ camera_from_world, scan.rig.right)
        np.testing.assert_allclose(right, (1, 17), atol=1e-6)


def test_known_points_fall_on_known_pixels(scan_folder, tiny):
    scan = read_scan(scan_folder)
    assert scan.rig.is_rectified
    assert [frame.name for frame in scan.frames] == ["left2", "left10"]
    assert_known_pixels(scan, tiny)


def test_pairs_side_by_side_in_one_folder(scan_folder, tiny):
    for side in ("left", "right"):
        for number in (2, 10):
            (scan_folder / side / f"{side}{number}.png").rename(scan_folder / f"{side}{number}.png")
        (scan_folder / side).rmdir()
    scan = read_scan(scan_folder)
    assert [(f.color.name, f.right.name) for f in scan.frames] == [
        ("left2.png", "right2.png"),
        ("left10.png", "right10.png"),
    ]
    assert_known_pixels(scan, tiny)


def test_an_incomplete_calibration_of_a_rig_is_reported(shared_data):
    folder = shared_data / "stereo" / "opencv_chessboard_rig"
    scan = read_scan(folder, complete=False)
    assert len(scan.frames) == 13
    with pytest.raises(InputError, match=r"no calibration: .*scan\.calibration=FILE"):
        read_scan(folder)


def trajectory_texts(tiny, matrix_text):
    x, y, z, w = tiny.second_quaternion
    flat = " ".join(f"{value:g}" for value in tiny.second.ravel())
    extrinsics = [np.linalg.inv(pose).T.ravel().tolist() for pose in (tiny.identity, tiny.second)]
    return {
        "poses.txt": f"1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n{flat}\n",
        "poses.tum": f"# t tx ty tz qx qy qz qw\n0.0 0 0 0 0 0 0 1\n0.1 1 2 3 {x} {y} {z} {w}\n",
        "trajectory.log": "0 0 1\n" + matrix_text(tiny.identity) + "1 1 2\n" + matrix_text(tiny.second),
        "poses.json": json.dumps([tiny.identity.tolist(), tiny.second.tolist()]),
        "trajectory.json": json.dumps({"parameters": [{"extrinsic": e} for e in extrinsics]}),
    }


@pytest.mark.parametrize(
    "name", ["poses.txt", "poses.tum", "trajectory.log", "poses.json", "trajectory.json"]
)
def test_every_form_of_trajectory(scan_folder, tiny, matrix_text, name):
    (scan_folder / "poses.txt").unlink()
    (scan_folder / name).write_text(trajectory_texts(tiny, matrix_text)[name])
    assert_known_pixels(read_scan(scan_folder), tiny)


def test_timed_poses_are_interpolated_at_frame_times(scan_folder, tiny):
    (scan_folder / "poses.txt").unlink()
    x, y, z, w = tiny.second_quaternion
    (scan_folder / "times.txt").write_text("5.0\n5.1\n")
    (scan_folder / "poses.tum").write_text(
        f"4.99 0 0 -1 0 0 0 1\n5.01 0 0 1 0 0 0 1\n5.09 1 2 2 {x} {y} {z} {w}\n5.11 1 2 4 {x} {y} {z} {w}\n"
    )
    assert_known_pixels(read_scan(scan_folder), tiny)


def test_a_missing_calibration_is_an_error_with_a_remedy(scan_folder, tiny):
    (scan_folder / "calibration.json").unlink()
    with pytest.raises(InputError, match=r"no calibration: calibration\.json is missing.*scan\.calibration"):
        read_scan(scan_folder)
    assert_known_pixels(read_scan(scan_folder, ScanParams(intrinsics=tiny.option, baseline=0.5)), tiny)


def test_a_named_calibration_is_used(scan_folder, tiny, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("rigs") / "mine.json"
    (scan_folder / "calibration.json").rename(elsewhere)
    assert_known_pixels(read_scan(scan_folder, ScanParams(calibration=str(elsewhere))), tiny)


def test_a_stated_baseline_scales_the_rig(scan_folder):
    assert read_scan(scan_folder, ScanParams(baseline=0.125)).rig.baseline == pytest.approx(0.125)


def test_no_poses(scan_folder):
    (scan_folder / "poses.txt").unlink()
    with pytest.raises(InputError, match=r"no poses: the folder has none of poses\.txt"):
        read_scan(scan_folder)


def test_a_single_pair_needs_no_pose(scan_folder):
    (scan_folder / "poses.txt").unlink()
    for side in ("left", "right"):
        (scan_folder / side / f"{side}10.png").unlink()
    scan = read_scan(scan_folder)
    np.testing.assert_array_equal(scan.frames[0].world_from_camera, np.eye(4))


def test_an_empty_side(scan_folder):
    for path in (scan_folder / "right").iterdir():
        path.unlink()
    with pytest.raises(InputError, match="no images in right/"):
        read_scan(scan_folder)


def test_a_pair_without_partner_is_left_out_with_its_pose(scan_folder):
    (scan_folder / "right" / "right2.png").unlink()
    (scan_folder / "poses.txt").write_text("0 0 1 1 0 1 0 2 -1 0 0 3\n")
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == ["left10"]
    assert scan.skipped_frames[0].name == "left2"


def test_opencv_stereo_sample_files(scan_folder, tiny):
    (scan_folder / "calibration.json").unlink()
    matrix = (
        "!!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
        "   data: [ 100., 0., 16., 0., 100., 12.,\n       0., 0., 1. ]\n"
    )
    bent = "!!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ 1.e-02, 0., 0., 0., 0. ]\n"
    (scan_folder / "intrinsics.yml").write_text(
        f"%YAML:1.0\n---\nM1: {matrix}D1: {bent}M2: {matrix}D2: {bent}"
    )
    (scan_folder / "extrinsics.yml").write_text(
        "%YAML:1.0\n---\nR: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
        "   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]\n"
        "T: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [ -5.0e-01, 0., 0. ]\n"
    )
    scan = read_scan(scan_folder)
    assert not scan.rig.is_rectified
    assert scan.rig.left.distortion == (0.01, 0, 0, 0, 0)
    assert_known_pixels(scan, tiny)


def test_sides_of_different_size_are_reported(scan_folder, tiny):
    for number in (2, 10):
        tiny.color(scan_folder / "right" / f"right{number}.png", (64, 48))
    with pytest.raises(InputError, match="left images are 32×24 px and right images 64×48 px"):
        read_scan(scan_folder)


def test_a_file_of_ros_for_each_camera(scan_folder, tiny):
    (scan_folder / "calibration.json").unlink()
    for side, shift in (("left", 0), ("right", -50)):
        (scan_folder / f"{side}.yaml").write_text(
            "image_width: 32\nimage_height: 24\ncamera_name: " + side + "\n"
            "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [100, 0, 16, 0, 100, 12, 0, 0, 1]\n"
            "distortion_model: plumb_bob\n"
            "distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0, 0, 0, 0, 0]\n"
            "rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
            "projection_matrix:\n  rows: 3\n  cols: 4\n"
            f"  data: [100, 0, 16, {shift}, 0, 100, 12, 0, 0, 0, 1, 0]\n"
        )
    scan = read_scan(scan_folder)
    assert_known_pixels(scan, tiny)
    assert any("image_raw" in text for text in map(str, scan.diagnostics))


def test_sides_that_share_no_numbers_are_reported(scan_folder):
    for old, new in ((2, "dawn"), (10, "noon")):
        (scan_folder / "right" / f"right{old}.png").rename(scan_folder / "right" / f"{new}.png")
    scan = read_scan(scan_folder)
    assert [frame.right.name for frame in scan.frames] == ["dawn.png", "noon.png"]
    assert any("left/ and right/ share no numbers" in text for text in map(str, scan.diagnostics))


def test_a_rig_file_of_any_name_next_to_the_images(scan_folder, tiny):
    (scan_folder / "calibration.json").rename(scan_folder / "our_cameras.json")
    scan = read_scan(scan_folder)
    assert_known_pixels(scan, tiny)
    said = "the calibration is read from our_cameras.json, which was found in the scan folder"
    assert said in map(str, scan.diagnostics)
    other = {**CAMERA, "baseline": 0.7}
    (scan_folder / "other.json").write_text(json.dumps(other))
    with pytest.raises(
        InputError, match=r"several files contain one: other\.json, our_cameras\.json; choose one with"
    ):
        read_scan(scan_folder)


def test_real_calibration_halves_with_incomplete_p1(shared_data, tmp_path, tiny):
    halves = shared_data / "real" / "calibrations"
    for name in ("left01.jpg", "right01.jpg"):
        tiny.color(tmp_path / name, (3072, 2048))
    named = ScanParams(calibration=str(halves / "opencv_hik_extrinsics.yml"))
    rig = read_scan(tmp_path, named).rig
    assert (rig.left.fx, rig.right.fx) == pytest.approx((12975.717, 13031.695), abs=1e-3)
    assert rig.baseline == pytest.approx(0.1619, abs=1e-4)
    assert not rig.is_rectified
    copy = tmp_path / "alone.yml"
    copy.write_bytes((halves / "opencv_hik_extrinsics.yml").read_bytes())
    with pytest.raises(InputError, match="P1 is not filled in"):
        read_scan(tmp_path, ScanParams(calibration=str(copy)))


def test_an_unused_rig_file_is_reported(scan_folder):
    for path in scan_folder.glob("calibration.*"):
        path.unlink()
    (scan_folder / "of the rig.yaml").write_text("K1: [100, 0, 16, 0, 100, 12, 0, 0, 1]\nK2: [100, 0")
    scan = read_scan(scan_folder, complete=False)
    assert str(scan.missing[0]).startswith("no calibration:")
    assert "of the rig.yaml: it looks like a calibration but is not used: the file does not parse" in str(
        scan.diagnostics[0]
    )


MATRIX = np.array([[100.0, 0, 16], [0, 100, 12], [0, 0, 1]])
# A camera 0.5 m to the right of the other, in the convention of cv2.stereoCalibrate.
RIG = {"R": np.eye(3), "T": np.array([[-0.5], [0], [0]])}


def names_of_a_rig(matrices, lenses):
    bent = np.array([[0.1, -0.02, 0, 0, 0.003]])
    return RIG | dict.fromkeys(matrices, MATRIX) | dict.fromkeys(lenses, bent)


@pytest.mark.parametrize(
    ("matrices", "lenses"),
    [
        (("mtxL", "mtxR"), ("distL", "distR")),
        (("Left_camera_matrix", "Right_camera_matrix"), ("Left_dist", "Right_dist")),
        (("Intrinsic_mtx_1", "Intrinsic_mtx_2"), ("dist_1", "dist_2")),
    ],
)
@pytest.mark.parametrize("place", [".", "calib"])
def test_arrays_of_a_calibration_in_one_archive(scan_folder, matrices, lenses, place):
    (scan_folder / "calibration.json").unlink()
    (scan_folder / place).mkdir(exist_ok=True)
    corners = np.array([np.zeros((3, 2)), np.zeros((4, 2))], dtype=object)
    straight = {f"new{name}": MATRIX * 2 / [[2], [2], [2]] for name in matrices}
    arrays = names_of_a_rig(matrices, lenses) | straight | {"corners": corners, "P1": np.eye(3, 4)}
    np.savez(scan_folder / place / "stereo.npz", **arrays, allow_pickle=True)
    scan = read_scan(scan_folder)
    assert (scan.rig.baseline, scan.rig.is_rectified) == (0.5, False)
    assert scan.rig.left.distortion == (0.1, -0.02, 0, 0, 0.003)
    named = (Path(place) / "stereo.npz").as_posix()
    assert f"the calibration is read from {named}, which was found in the scan folder" in map(
        str, scan.diagnostics
    )


@pytest.mark.parametrize("suffix", [".txt", ".npy"])
@pytest.mark.parametrize("place", [".", "camera_params"])
def test_a_calibration_in_a_file_for_each_matrix(scan_folder, suffix, place):
    (scan_folder / "calibration.json").unlink()
    (scan_folder / place).mkdir(exist_ok=True)
    for name, array in names_of_a_rig(("mtx_l", "mtx_r"), ("dist_l", "dist_r")).items():
        save = np.savetxt if suffix == ".txt" else np.save
        save(scan_folder / place / f"{name}{suffix}", array)
    scan = read_scan(scan_folder)
    assert (scan.rig.baseline, scan.rig.left.fx, scan.rig.right.distortion[1]) == (0.5, 100, -0.02)
    (said,) = [text for text in map(str, scan.diagnostics) if "one matrix per file" in text]
    assert all(f"{name}{suffix}" in said for name in ("mtx_l", "dist_r", "R", "T"))
    assert not find_unused_files(scan)
    (scan_folder / place / f"mtx_r{suffix}").unlink()
    with pytest.raises(InputError, match="no calibration"):
        read_scan(scan_folder)


def test_files_of_both_cameras_in_a_folder_of_calibrations(scan_folder):
    (scan_folder / "calibration.json").unlink()
    (scan_folder / "calib").mkdir()
    for side, shift in (("left", 0), ("right", -50)):
        p = {"rows": 3, "cols": 4, "data": [100, 0, 16, shift, 0, 100, 12, 0, 0, 0, 1, 0]}
        matrix = {"rows": 3, "cols": 3, "data": MATRIX.ravel().tolist()}
        info = {
            "image_width": 32,
            "image_height": 24,
            "camera_matrix": matrix,
            "projection_matrix": p,
        }
        (scan_folder / "calib" / f"{side}.yaml").write_text(json.dumps(info))
    scan = read_scan(scan_folder)
    assert scan.rig.baseline == 0.5
    assert "the calibration is read from the files in calib/" in map(str, scan.diagnostics)


def test_a_damaged_archive_of_arrays_is_reported(scan_folder):
    (scan_folder / "calibration.json").unlink()
    np.savez(scan_folder / "stereo.npz", **names_of_a_rig(("mtxL", "mtxR"), ("distL", "distR")))
    whole = (scan_folder / "stereo.npz").read_bytes()
    for content in (b"", whole[:-30], whole[:200] + bytes(200) + whole[400:]):
        (scan_folder / "stereo.npz").write_bytes(content)
        with pytest.raises(
            InputError, match=r"stereo\.npz: (the archive|.* cannot be read|.*expected)|no small"
        ):
            read_scan(scan_folder, ScanParams(calibration="stereo.npz"))


def test_matrices_as_the_stereovision_package_saves_them(scan_folder):
    """The folder also contains rotations, projections and maps, which are not cameras."""
    (scan_folder / "calibration.json").unlink()
    place = scan_folder / "stereo_calibration_result"
    place.mkdir()
    names = {"mtx_l": "cam_mats_left", "mtx_r": "cam_mats_right", "R": "rot_mat", "T": "trans_vec"}
    names |= {"dist_l": "dist_coefs_left", "dist_r": "dist_coefs_right"}
    arrays = names_of_a_rig(("mtx_l", "mtx_r"), ("dist_l", "dist_r"))
    for name, array in arrays.items():
        np.save(place / f"{names[name]}.npy", array)
    for side in ("left", "right"):
        np.save(place / f"rect_trans_{side}.npy", np.eye(3))
        np.save(place / f"proj_mats_{side}.npy", np.eye(3, 4) * 90)
        np.save(place / f"undistortion_map_{side}.npy", np.zeros((24, 32, 2), np.int16))
    rig = read_scan(scan_folder).rig
    assert (rig.baseline, rig.left.fx, rig.right.distortion[1]) == (0.5, 100, -0.02)


@pytest.mark.parametrize(
    ("baseline", "metres", "said"),
    [
        (0.5, 0.5, None),
        (8.9, 8.9, "read as metres, which is unusually wide"),
        (12.0, 0.012, r"read as millimetres; .*in centimetres it would be 0\.12 m"),
    ],
)
def test_a_baseline_with_unknown_unit(scan_folder, baseline, metres, said):
    (scan_folder / "calibration.json").write_text(json.dumps({**CAMERA, "baseline": baseline}))
    scan = read_scan(scan_folder)
    assert scan.rig.baseline == pytest.approx(metres)
    told = [text for text in map(str, scan.diagnostics) if "has no unit" in text]
    assert (said is None and not told) or re.search(said, told[0])
    assert not any(
        "has no unit" in text
        for text in map(str, read_scan(scan_folder, ScanParams(baseline=0.1)).diagnostics)
    )


@pytest.mark.parametrize(
    "sides", [("left_images", "right_images"), ("rig_Left", "rig_Right"), ("calib_left", "calib_right")]
)
def test_folders_of_any_names_that_part_both_sides(scan_folder, tiny, sides):
    for name, side in zip(sides, ("left", "right"), strict=True):
        (scan_folder / side).rename(scan_folder / name)
    assert_known_pixels(read_scan(scan_folder), tiny)


def test_folders_of_depth_and_of_boards_are_not_those_of_the_pairs(scan_folder, tiny):
    for side in ("left", "right"):
        (scan_folder / side).rename(scan_folder / f"{side}_images")
        tiny.color(scan_folder / f"calib_{side}" / "0.png")
        tiny.color(scan_folder / f"{side}_disparity" / "0.png")
    assert_known_pixels(read_scan(scan_folder), tiny)


def test_disparity_maps_are_not_images_of_a_side(scan_folder, tiny):
    for side in ("left", "right"):
        for number in (2, 10):
            (scan_folder / side / f"{side}{number}.png").rename(scan_folder / f"im_{side}_{number}.png")
            tiny.color(scan_folder / f"disp_{side}_{number}.png")
        (scan_folder / side).rmdir()
    assert_known_pixels(read_scan(scan_folder), tiny)


def test_folders_of_several_rigs_are_not_guessed_at(scan_folder, tiny):
    for number in (1, 2):
        for side in ("left", "right"):
            tiny.color(scan_folder / f"{side}_{number}" / "0.png")
    assert_known_pixels(read_scan(scan_folder), tiny)
    for side in ("left", "right"):
        (scan_folder / side).rename(scan_folder / f"{side}_0")
    with pytest.raises(InputError, match="unknown layout"):
        read_scan(scan_folder)


@pytest.mark.parametrize(
    "form", ["img_{side}_{number}.png", "{number}_{letter}.png", "Cam{side}{number}.png"]
)
def test_sides_may_be_marked_anywhere_in_image_names(scan_folder, tiny, form):
    for side, letter in (("left", "L"), ("right", "R")):
        for number in (2, 10):
            name = form.format(
                side=side.capitalize() if "Cam" in form else side, letter=letter, number=number
            )
            (scan_folder / side / f"{side}{number}.png").rename(scan_folder / name)
        (scan_folder / side).rmdir()
    assert_known_pixels(read_scan(scan_folder), tiny)
