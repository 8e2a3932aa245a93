"""The pose convention of views is recognised from feature matches between photos."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.inspecting.epipolar_check import check_view_poses, require_view_poses
from scanloom.stages.scans.reader import read_scan

FLIP = np.diag((1.0, -1.0, -1.0, 1.0))
READINGS = {
    "world-to-camera": np.linalg.inv,
    "in camera axes with y up and z back": lambda pose: pose @ FLIP,
    "world-to-camera in axes with y up and z back": lambda pose: np.linalg.inv(pose @ FLIP),
}
VIEWS = [
    "real/nerf_alpha_toy",
    "real/colmap_views_meeting_room",
    "stereo/middlebury_templeRing",
]


def rewrite_poses(scan, written):
    frames = [replace(one, world_from_camera=written(one.world_from_camera)) for one in scan.frames]
    return replace(scan, frames=frames)


@pytest.mark.parametrize("folder", VIEWS)
def test_correct_poses_raise_no_warning(shared_data, folder):
    scan = read_scan(shared_data / folder)
    errors, suspicion = check_view_poses(scan.frames)
    assert suspicion is None
    assert errors["as given"] < 1.5
    assert min(errors, key=lambda name: errors[name]) == "as given"


@pytest.mark.slow
@pytest.mark.parametrize("folder", VIEWS[1:])
@pytest.mark.parametrize("reading", READINGS)
def test_another_pose_convention_is_reported(shared_data, folder, reading):
    scan = rewrite_poses(read_scan(shared_data / folder), READINGS[reading])
    convention = {
        "in camera axes with y up and z back": "y-up",
        "world-to-camera in axes with y up and z back": "world-to-camera-y-up",
    }.get(reading, reading)
    with pytest.raises(InputError, match=f"probably {reading}.*Set scan.pose_convention={convention},"):
        require_view_poses(scan)


def test_poses_in_the_wrong_order_are_reported(shared_data):
    scan = read_scan(shared_data / "real" / "nerf_alpha_toy")
    poses = [frame.world_from_camera for frame in scan.frames][::-1]
    frames = [replace(frame, world_from_camera=pose) for frame, pose in zip(scan.frames, poses, strict=True)]
    with pytest.raises(InputError, match="in reverse frame order"):
        require_view_poses(replace(scan, frames=frames))


def test_without_feature_matches_no_convention_is_reported(tmp_path):
    scan = write_blank_views(tmp_path)
    assert check_view_poses(scan.frames) == ({}, None)
    assert check_view_poses(scan.frames[:1]) == ({}, None)
    assert check_view_poses([]) == ({}, None)


def write_blank_views(folder):
    (folder / "images").mkdir()
    for name in ("0", "1", "2"):
        assert cv2.imwrite(str(folder / "images" / f"{name}.png"), np.full((24, 32, 3), 90, np.uint8))
    (folder / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 2 + "1 0 0 1 0 1 0 0 0 0 1 0\n")
    (folder / "K.txt").write_text("40 0 15.5\n0 40 11.5\n0 0 1\n")
    return read_scan(folder)
