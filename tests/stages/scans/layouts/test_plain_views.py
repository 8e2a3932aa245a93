"""Photos with pose and camera files of any name in the same folder."""

import json

import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import detect_layout, read_scan

K = {"camera_matrix": [[40.0, 0, 15.5], [0, 40.0, 11.5], [0, 0, 1]], "image_width": 32, "image_height": 24}


@pytest.fixture
def photos(tmp_path, tiny):
    """Write three photos with numbered names, and their camera."""
    for name in ("frame_000007", "frame_000012", "frame_000031"):
        tiny.color(tmp_path / "images" / f"{name}.png")
    (tmp_path / "lens.json").write_text(json.dumps(K))
    return tmp_path


def shifted(x):
    pose = np.eye(4)
    pose[0, 3] = x
    return pose


def places(scan):
    return [frame.world_from_camera[0, 3] for frame in scan.frames]


def rows(xs):
    return "".join(" ".join(map(str, shifted(x)[:3].ravel())) + "\n" for x in xs)


def test_poses_in_the_order_of_the_photos(photos):
    (photos / "where.txt").write_text(rows((1, 2, 3)))
    layout, why = detect_layout(photos)
    assert (layout.name, why) == ("plain-views", "images/ and where.txt, one pose per image")
    scan = read_scan(photos)
    assert scan.is_views
    assert scan.is_metric
    assert places(scan) == [1, 2, 3]
    assert scan.frames[0].camera.fx == 40
    assert any("poses are read from where.txt" in said for said in map(str, scan.diagnostics))
    assert any("camera is read from lens.json" in said for said in map(str, scan.diagnostics))


def test_poses_are_assigned_by_photo_numbers(photos):
    (photos / "poses.json").write_text(json.dumps({str(n): shifted(n).tolist() for n in range(40)}))
    assert places(read_scan(photos)) == [7, 12, 31]


def test_poses_by_the_names_of_photos_and_one_without(photos):
    named = {"images/frame_000031.png": shifted(3).tolist(), "images/frame_000007.png": shifted(1).tolist()}
    (photos / "poses.json").write_text(json.dumps(named))
    scan = read_scan(photos)
    assert places(scan) == [1, 3]
    assert [(one.name, one.reason) for one in scan.skipped_frames] == [
        ("frame_000012", "poses.json has no pose for it")
    ]


def test_poses_by_time(tmp_path, tiny):
    for time in ("10.000000", "10.500000", "11.000000"):
        tiny.color(tmp_path / f"{time}.png")
    (tmp_path / "lens.json").write_text(json.dumps(K))
    lines = [f"{10 + n / 10} {n} 0 0 0 0 0 1" for n in range(11)]
    (tmp_path / "track.txt").write_text("\n".join(lines))
    np.testing.assert_allclose(places(read_scan(tmp_path)), (0, 5, 10))


def test_one_camera_of_a_rig(photos):
    (photos / "images").rename(photos / "image_l")
    (photos / "poses.txt").write_text(rows((1, 2, 3)))
    scan = read_scan(photos)
    assert (scan.layout, places(scan)) == ("plain-views", [1, 2, 3])


def test_missing_data_is_reported(photos):
    with pytest.raises(InputError, match=r"unknown layout: images/ holds images without poses.*scan.poses"):
        read_scan(photos)
    elsewhere = photos.parent / "elsewhere.txt"
    elsewhere.write_text(rows((1, 2, 3)))
    assert places(read_scan(photos, ScanParams(poses=str(elsewhere)))) == [1, 2, 3]
    (photos / "lens.json").unlink()
    given = ScanParams(poses=str(elsewhere))
    with pytest.raises(InputError, match="no calibration: no file in the scan folder states the camera"):
        read_scan(photos, given)
    assert read_scan(photos, given, complete=False).missing
    assert (
        read_scan(photos, ScanParams(poses=str(elsewhere), intrinsics="50,50,16,12")).frames[0].camera.fx
        == 50
    )


def test_two_trajectories_are_ambiguous(photos):
    (photos / "one.txt").write_text(rows((1, 2, 3)))
    (photos / "two.txt").write_text(rows((4, 5, 6)))
    scan = read_scan(photos, complete=False)
    assert any(
        "several files have poses for the images: one.txt, two.txt" in said
        for said in map(str, scan.diagnostics)
    )
    assert scan.missing[0].code == "pose.missing"
    assert places(read_scan(photos, ScanParams(poses="two.txt"))) == [4, 5, 6]


def test_a_pose_file_of_other_frames_is_reported(photos):
    (photos / "where.txt").write_text(rows((1, 2, 3)))
    (photos / "others.json").write_text(json.dumps({"left": shifted(1).tolist()}))
    with pytest.raises(InputError, match=r"its frame names, such as 'left', match no frame of the scan"):
        read_scan(photos, ScanParams(poses="others.json"))


@pytest.mark.parametrize(
    ("convention", "written"),
    [
        ("as-written", lambda pose: pose),
        ("world-to-camera", np.linalg.inv),
        ("y-up", lambda pose: pose @ np.diag((1, -1, -1, 1))),
        ("world-to-camera-y-up", lambda pose: np.linalg.inv(pose @ np.diag((1, -1, -1, 1)))),
    ],
)
def test_the_given_pose_convention_is_used(photos, tiny, convention, written):
    poses = [tiny.identity, tiny.second, tiny.identity]
    (photos / "poses.json").write_text(json.dumps([written(pose).tolist() for pose in poses]))
    scan = read_scan(photos, ScanParams(pose_convention=convention))
    for frame, pose in zip(scan.frames, poses, strict=True):
        np.testing.assert_allclose(frame.world_from_camera, pose, atol=1e-9)
