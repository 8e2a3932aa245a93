"""Frames and scans from arrays in memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanloom import Camera, Frame, InputError, Scan, StereoRig, fuse, read_scan
from scanloom.stages.scans.model.images import read_color, read_depth

SAMPLES = Path(__file__).resolve().parents[3] / "samples"
SIZE = (12, 16)
K = np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]])
COLOR = np.full((*SIZE, 3), 90, np.uint8)
DEPTH = np.full(SIZE, 1.5, np.float32)


def make(**changes: Any) -> Frame:
    given: dict[str, Any] = {"color": COLOR, "depth": DEPTH, "intrinsics": K, "world_from_camera": np.eye(4)}
    return Frame.from_arrays(**{**given, **changes})


def test_a_frame_keeps_the_given_arrays() -> None:
    frame = make(timestamp=5, name="a")
    assert (frame.camera.fx, frame.camera.cx, frame.camera.width) == (20.0, 7.5, 16)
    np.testing.assert_array_equal(read_color(frame), COLOR)
    np.testing.assert_array_equal(read_depth(frame), DEPTH)
    assert (frame.timestamp, frame.name) == (5, "a")


@pytest.mark.parametrize("intrinsics", [K.tolist(), (20, 20, 7.5, 5.5), Camera(16, 12, 20, 20, 7.5, 5.5)])
def test_intrinsics_come_in_several_forms(intrinsics: Any) -> None:
    assert make(intrinsics=intrinsics).camera == make().camera


@pytest.mark.parametrize("pose", [np.eye(4).tolist(), np.eye(4)[:3], np.eye(4, dtype=np.float32)])
def test_poses_come_in_several_forms(pose: Any) -> None:
    np.testing.assert_array_equal(make(world_from_camera=pose).world_from_camera, np.eye(4))


def test_a_pose_of_nan_is_lost() -> None:
    assert make(world_from_camera=np.full((4, 4), np.nan)).world_from_camera is None


@pytest.mark.parametrize(
    ("depth", "scale"),
    [
        (np.full(SIZE, 1500, np.uint16), None),
        (np.full(SIZE, 1500, np.int32), 1000),
        (np.full(SIZE, 15000, np.uint16), 10_000),
        (np.full(SIZE, 1500.0), 1000),
        (DEPTH.astype(np.float16), None),
        (DEPTH[:, :, None], None),
    ],
)
def test_depth_is_converted_to_metres(depth: Any, scale: float | None) -> None:
    np.testing.assert_array_equal(make(depth=depth, depth_scale=scale).depth, DEPTH)


@pytest.mark.slow
@given(st.lists(st.floats(width=32), min_size=192, max_size=192))
def test_non_finite_depth_becomes_missing(values: list[float]) -> None:
    array = np.array(values, np.float32).reshape(SIZE)
    depth = make(depth=array, depth_scale=1).depth
    assert isinstance(depth, np.ndarray)
    assert np.isfinite(depth).all()
    assert (depth >= 0).all()
    kept = np.isfinite(array) & (array > 0)
    np.testing.assert_array_equal(depth[kept], array[kept])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"color": COLOR / 255}, "uint8, not (12, 16, 3) float64"),
        ({"color": COLOR.transpose(2, 0, 1)}, "(h, w, 3)"),
        ({"depth": np.full(SIZE, 9, np.uint8)}, "at least 16 bits"),
        ({"depth": np.full((*SIZE, 3), 9, np.uint16)}, "a depth image must be"),
        (
            {"depth": np.full(SIZE, 1500.0)},
            "the median depth is 1,500 m, which is implausible. Set depth_scale",
        ),
        ({"depth_scale": 0}, "depth_scale must be a positive number"),
        ({"depth_scale": float("nan")}, "depth_scale must be a positive number"),
        ({"intrinsics": None}, "intrinsics are missing"),
        ({"intrinsics": (1, 2, 3)}, "a (3, 3) camera matrix"),
        ({"intrinsics": "kinect"}, "a (3, 3) camera matrix"),
        ({"intrinsics": K.T}, "a camera matrix must be"),
        ({"intrinsics": (-20, 20, 7.5, 5.5)}, "do not fit an image of 16 × 12 px"),
        ({"intrinsics": (525, 525, 319.5, 239.5)}, "do not fit an image of 16 × 12 px"),
        ({"intrinsics": (np.nan, 20, 7.5, 5.5)}, "do not fit an image"),
        ({"intrinsics": Camera(32, 24, 20, 20, 7.5, 5.5)}, "the camera is for images of 32 × 24 px"),
        ({"intrinsics": Camera(16, 12, 20, 20, 7.5, 5.5, (0.1,))}, "4, 5, 8, 12 or 14"),
        ({"world_from_camera": np.eye(3)}, "world_from_camera must be a (4, 4) or (3, 4) matrix, not (3, 3)"),
        ({"world_from_camera": "here"}, "not str"),
        ({"world_from_camera": 2 * np.eye(4)}, "the last row of the pose"),
        ({"world_from_camera": np.diag([1.0, 1, -1, 1])}, "mirrors"),
        ({"color": None, "depth": None}, "needs a colour image or a depth image"),
        ({"color": np.full((16, 12, 3), 9, np.uint8)}, "differ in aspect ratio"),
        ({"right": COLOR[:6]}, "of the same size"),
        ({"mask": np.zeros(SIZE)}, "a mask must be (h, w) uint8 or bool"),
    ],
)
def test_invalid_arguments_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as told:
        make(name="7", **changes)
    assert str(told.value).startswith("frame 7: ")
    assert message in str(told.value)


def test_the_frame_constructor_checks_arrays() -> None:
    camera = make().camera
    with pytest.raises(InputError, match="floats in metres, not uint16"):
        Frame("a", camera, depth=np.full(SIZE, 1500, np.uint16))
    with pytest.raises(InputError, match=r"must be a \(4, 4\) array"):
        Frame("a", camera, color=COLOR, world_from_camera=np.eye(4).tolist())  # type: ignore[arg-type]


def test_frames_without_a_name_are_numbered() -> None:
    scan = Scan.from_frames([make(), make(name="second"), make()], up=(0, 0, 2))
    assert [frame.name for frame in scan.frames] == ["000000", "second", "000002"]
    assert scan.up is not None
    assert scan.up.direction == (0, 0, 1)


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([], "at least one frame"),
        ([make(), make(depth=None)], "frame 000001: it has neither depth"),
        ([make(depth=None, world_from_camera=None)], "single images need poses"),
        ([make(depth=None, right=COLOR)], "stereo pairs need the argument rig"),
    ],
)
def test_frames_that_make_no_scan_are_refused(frames: list[Frame], message: str) -> None:
    with pytest.raises(InputError) as told:
        Scan.from_frames(frames)
    assert message in str(told.value)


def test_an_up_direction_of_no_length_is_refused() -> None:
    with pytest.raises(InputError, match="up must be a direction"):
        Scan.from_frames([make()], up=(0, 0, 0))


def test_pairs_are_a_stereo_scan() -> None:
    camera = make().camera
    right_from_left = np.eye(4)
    right_from_left[0, 3] = -0.1
    rig = StereoRig(camera, camera, right_from_left, is_rectified=True)
    scan = Scan.from_frames([make(depth=None, right=COLOR, mask=np.ones(SIZE, bool))], rig=rig)
    assert scan.is_stereo


def test_arrays_give_the_mesh_that_files_give() -> None:
    scan = read_scan(SAMPLES / "rgbd")
    from_arrays = Scan.from_frames(
        Frame.from_arrays(
            read_color(frame), read_depth(frame), frame.camera, frame.world_from_camera, name=frame.name
        )
        for frame in scan.frames
    )
    ours, theirs = fuse(from_arrays).mesh, fuse(scan).mesh
    np.testing.assert_array_equal(ours.vertices, theirs.vertices)
    np.testing.assert_array_equal(ours.triangles, theirs.triangles)
    np.testing.assert_array_equal(ours.colors, theirs.colors)
