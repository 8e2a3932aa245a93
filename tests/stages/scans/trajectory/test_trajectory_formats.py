import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.trajectory.trajectory_formats import (
    Trajectory,
    assign_by_number,
    interpolate_pose,
    read_pose,
    read_trajectory,
    sort_by_time,
)


def written(folder, name, text):
    (folder / name).write_text(text)
    return folder / name


def turn_about_z(degrees, x=0.0):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0, x], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("kitti.txt", "0 0 1 1 0 1 0 2 -1 0 0 3\n"),
        ("flat.txt", "0 0 1 1 0 1 0 2 -1 0 0 3 0 0 0 1\n"),
        # World-to-camera, -90° about y.
        ("phone.traj", "7.5 0 -1.5707963268 0 3 -2 -1\n"),
        ("rows.txt", "0 0 1 1\n0 1 0 2\n-1 0 0 3\n0 0 0 1\n"),
        ("commas.txt", "# a comment\n\n0, 0, 1, 1, 0, 1, 0, 2, -1, 0, 0, 3\n"),
        ("poses.tum", "# header\n7.5 1 2 3 0 0.70710678 0 0.70710678\n"),
        ("truth.csv", "#ns,...\n7500000000,1,2,3,0.70710678,0,0.70710678,0,9,9,9\n"),
        ("poses.log", "0 0 1\n0 0 1 1\n0 1 0 2\n-1 0 0 3\n0 0 0 1\n"),
        ("nested.json", json.dumps({"poses": [[[0, 0, 1, 1], [0, 1, 0, 2], [-1, 0, 0, 3], [0, 0, 0, 1]]]})),
        ("graph.json", json.dumps({"nodes": [{"pose": [0, 0, -1, 0, 0, 1, 0, 0, 1, 0, 0, 0, 1, 2, 3, 1]}]})),
        (
            "camera.json",
            json.dumps({"parameters": [{"extrinsic": [0, 0, 1, 0, 0, 1, 0, 0, -1, 0, 0, 0, 3, -2, -1, 1]}]}),
        ),
    ],
)
def test_every_form_holds_the_same_pose(tmp_path, tiny, name, text):
    trajectory = read_trajectory(written(tmp_path, name, text))
    assert len(trajectory) == 1
    np.testing.assert_allclose(trajectory.poses[0], tiny.second, atol=1e-7)
    if trajectory.timestamps is not None:
        assert trajectory.timestamps.tolist() == [7_500_000_000]


@pytest.mark.parametrize("shape", [(-1, 4, 4), (-1, 3, 4), (-1, 16), (-1, 12)])
def test_matrices_in_one_array(tmp_path, tiny, shape):
    poses = np.stack([tiny.identity, tiny.second, np.full((4, 4), np.nan)])
    rows = 3 if shape in ((-1, 3, 4), (-1, 12)) else 4
    np.save(tmp_path / "poses.npy", poses[:, :rows].reshape(shape).astype(np.float32))
    trajectory = read_trajectory(tmp_path / "poses.npy")
    assert trajectory.poses[2] is None
    np.testing.assert_allclose(trajectory.poses[:2], poses[:2], atol=1e-6)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((0, 4, 4)), "poses are expected"),
        (np.zeros((4, 4)), "poses are expected"),
        (np.zeros((3, 4, 4), int), "poses are expected"),
        (np.zeros((3, 4, 4)), "pose 0: .*the last row of the pose"),
        (np.zeros((3, 7)), "poses are expected"),
    ],
)
def test_an_array_without_poses_is_reported(tmp_path, array, message):
    np.save(tmp_path / "poses.npy", array)
    with pytest.raises(InputError, match=rf"poses\.npy: {message}"):
        read_trajectory(tmp_path / "poses.npy")
    (tmp_path / "poses.npy").write_bytes(b"no array")
    with pytest.raises(InputError, match=r"poses\.npy: the trajectory file cannot be read"):
        read_trajectory(tmp_path / "poses.npy")


def test_euroc_nanoseconds_stay_exact(tmp_path):
    time = 1403715273262142976
    trajectory = read_trajectory(
        written(tmp_path, "a.csv", f"{time},0,0,0,1,0,0,0\n{time + 1},0,0,0,1,0,0,0\n")
    )
    assert trajectory.timestamps.tolist() == [time, time + 1]


@pytest.mark.parametrize("mark", ["-inf", "inf", "nan"])
def test_a_pose_all_of_one_infinite_mark_is_lost(tmp_path, mark):
    assert read_pose(written(tmp_path, "p.txt", f"{mark} {mark} {mark} {mark}\n" * 4)) is None
    assert read_pose(written(tmp_path, "q.txt", f"{mark} {mark} {mark} {mark}\n" * 3 + "0 0 0 1\n")) is None


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 nan 0 1 0 0 0 0 1 0\n", "line 2: .*not finite"),
        ("a.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n2 0 0 0 0 1 0 0 0 0 1 0\n", "line 2: .*not rigid"),
        ("a.txt", "1e308 1e308 0 0 -1e308 1e308 0 0 0 0 1 0\n", "line 1: .*not rigid"),
        ("a.json", f"[[{10**400}, 0, 0, 0]]", "pose 0 is not a 4x4 matrix"),
        ("a.txt", "1e308 0 0 0 0 1 0 0 0 0 1 0\n", "line 1: .*not rigid"),
        ("a.txt", "-1 0 0 0 0 1 0 0 0 0 1 0\n", "line 1: .*mirrors"),
        ("a.txt", "1.01 0 0 0 0 1 0 0 0 0 1 0\n", "off by 0.02"),
        ("a.txt", "1 0 0 0 0 1 0 0 0 0 1 0 5 5 5 1\n", "last row .* 5 5 5 1.*column-major"),
        ("a.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 2 3\n", "line 2 holds 3 numbers"),
        ("a.txt", "1 2 3 4 5\n", "line 1 holds 5 numbers"),
        ("a.txt", "one two\n", "line 1 holds something that is not a number"),
        ("a.txt", "", "no poses"),
        ("a.txt", "# nothing\n", "no poses"),
        ("a.txt", "0 0 1\n1 0 0 0\n0 1 0 0\n", "entry at line 1"),
        ("a.txt", "1 0 0 0\n0 1 0 0\n", "holds 8 numbers"),
        ("a.tum", "1.5 0 0 0 0 0 0 1\n2.5 0 0 0 0 0 0 0.2\n", "line 2: the quaternion has length 0.2"),
        ("a.tum", "1e30 0 0 0 0 0 0 1\n", "line 1: the time"),
        ("a.tum", "1.5 0 nan 0 0 0 0 1\n", "line 1: .*not finite"),
        ("a.csv", "1.5,0,0,0,1,0,0,0\n", "line 1 is not"),
        ("a.csv", "15,0,0\n", "line 1 is not"),
        ("a.json", "{", "not valid JSON"),
        ("a.json", "{}", "not a trajectory"),
        ("a.json", '{"parameters": [{}]}', "extrinsic 0 is not a 4x4"),
        ("a.json", '{"parameters": [7]}', "extrinsic 0 is not a 4x4"),
        ("a.json", '{"poses": [[[1, 0], [0, 1]]]}', "pose 0 is not a 4x4"),
    ],
)
def test_errors_are_reported_with_their_line(tmp_path, name, text, message):
    with pytest.raises(InputError, match=rf"{name}: .*{message}|{name}: {message}"):
        read_trajectory(written(tmp_path, name, text))


def test_a_byte_order_mark_and_windows_line_ends_do_not_matter(tmp_path, tiny):
    (tmp_path / "a.txt").write_bytes(b"\xef\xbb\xbf0 0 1 1 0 1 0 2 -1 0 0 3\r\n")
    np.testing.assert_array_equal(read_trajectory(tmp_path / "a.txt").poses[0], tiny.second)


def test_a_binary_file_is_reported(tmp_path):
    (tmp_path / "a.txt").write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match="binary"):
        read_trajectory(tmp_path / "a.txt")


def test_a_missing_file_is_reported(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_trajectory(tmp_path / "a.txt")


@settings(max_examples=200, deadline=None)
@given(
    text=st.text(alphabet='0123456789.-+eEnaif #,\n[]{}":', max_size=120),
    suffix=st.sampled_from(["txt", "json", "csv"]),
)
def test_any_text_gives_poses_or_a_sentence(tmp_path_factory, text, suffix):
    path = tmp_path_factory.getbasetemp() / f"any.{suffix}"
    path.write_text(text)
    try:
        poses = read_trajectory(path).poses
    except InputError:
        return
    for pose in poses:
        assert pose is None or np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=0.01)


def test_a_first_pose_swallowed_by_the_header_is_found(tmp_path):
    text = "# trajectory <t x y z qx qy qz qw>0.5 7 0 0 0 0 0 1\n1.5 8 0 0 0 0 0 1\n"
    trajectory = read_trajectory(written(tmp_path, "a.tum", text))
    assert [pose[0, 3] for pose in trajectory.poses] == [7, 8]
    assert trajectory.timestamps.tolist() == [500_000_000, 1_500_000_000]


def test_halfway_is_halfway_in_place_and_turn():
    trajectory = Trajectory([turn_about_z(0), turn_about_z(90, x=2)], np.array([1000, 2000]))
    np.testing.assert_allclose(interpolate_pose(trajectory, 1500, 600), turn_about_z(45, x=1), atol=1e-12)
    np.testing.assert_allclose(interpolate_pose(trajectory, 1250, 600), turn_about_z(22.5, x=0.5), atol=1e-12)


def test_next_to_a_gap_the_nearest_pose_is_used():
    trajectory = Trajectory([turn_about_z(0), turn_about_z(90)], np.array([0, 1_000_000]))
    np.testing.assert_array_equal(interpolate_pose(trajectory, 10, 50), turn_about_z(0))
    assert interpolate_pose(trajectory, 500, 50) is None
    np.testing.assert_array_equal(interpolate_pose(trajectory, 999_990, 50), turn_about_z(90))


def test_ends_of_the_trajectory():
    trajectory = Trajectory([turn_about_z(0), turn_about_z(90)], np.array([100, 200]))
    np.testing.assert_array_equal(interpolate_pose(trajectory, 95, 10), turn_about_z(0))
    np.testing.assert_array_equal(interpolate_pose(trajectory, 205, 10), turn_about_z(90))
    assert interpolate_pose(trajectory, 80, 10) is None
    assert interpolate_pose(trajectory, 300, 10) is None


def test_in_order_sorts_and_drops_lost_and_repeated():
    poses = [turn_about_z(30), None, turn_about_z(10), turn_about_z(11)]
    ordered = sort_by_time(Trajectory(poses, np.array([30, 20, 10, 10])))
    assert ordered.timestamps.tolist() == [10, 30]
    np.testing.assert_array_equal(ordered.poses[0], turn_about_z(10))


def test_inverse_undoes():
    pose = turn_about_z(37, x=5)
    np.testing.assert_allclose(invert_pose(pose) @ pose, np.eye(4), atol=1e-12)


def test_more_values_than_frames_go_by_number(tmp_path):
    with collecting() as told:
        assert assign_by_number("abcd", ["f1", "f3"], tmp_path / "a.txt", "poses") == ["b", "d"]
    # An additional line shifts the poses, so it is reported.
    assert "a.txt: it holds 4 poses for 2 frames" in str(told[0])
    with pytest.raises(InputError, match="4 poses, but the scan has 2 frames"):
        assign_by_number("abcd", ["f1", "f9"], tmp_path, "poses")
    with pytest.raises(InputError, match="4 poses"):
        assign_by_number("abcd", ["left", "right"], tmp_path, "poses")


def test_a_place_that_cannot_be_right(tmp_path):
    (tmp_path / "poses.txt").write_text("1 0 0 1e300 0 1 0 0 0 0 1 0\n")
    with pytest.raises(InputError, match=r"line 1: a translation of 1e\+300 is implausible"):
        read_trajectory(tmp_path / "poses.txt")


def test_numbers_with_commas_for_points(tmp_path):
    (tmp_path / "poses.tum").write_text("0,5 1,25 0 -2,5 0 0 0 1\n")
    trajectory = read_trajectory(tmp_path / "poses.tum")
    assert trajectory.poses[0][:3, 3].tolist() == [1.25, 0, -2.5]
    assert trajectory.timestamps.tolist() == [500_000_000]
