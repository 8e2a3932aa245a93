"""TartanAir: rendered pairs of images, depth of the left one as .npy, poses in axes of an aircraft (NED).

image_left/000000_left.png   depth_left/000000_left_depth.npy   pose_left.txt
image_right/000000_right.png                                     used where there is no depth
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError
from stages.formats import calibration, trajectories
from stages.images import read_raw_depth
from stages.layouts.files import DEPTHS, common_size, first_existing, images, pair
from stages.layouts.layout import Layout
from stages.scan import Camera, Frame, Packed, Pose, Scan, StereoRig, scaled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from stages.layouts.params import ScanParams

_CAMERA = Camera(640, 480, 320.0, 320.0, 320.0, 240.0)
_BASELINE = 0.25
# Metres; the sky is put at some very large distance, which differs from scene to scene.
_SKY = 1000.0
_POSES = "pose_left.txt"
# Camera axes of the data set are x forward, y right, z down.
_NED_FROM_CAMERA = np.array([[0.0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


def _matches(folder: Path) -> str | None:
    is_there = (folder / _POSES).is_file() and (folder / "image_left").is_dir()
    return f"{_POSES} and image_left/" if is_there else None


def _read(folder: Path, options: ScanParams) -> Scan:
    if not (folder / "image_left").is_dir():
        raise InputError("a folder image_left/ is needed.", folder)
    lefts = images(folder / "image_left")
    has_depth = (folder / "depth_left").is_dir()
    if has_depth:
        others, name = images(folder / "depth_left", DEPTHS), "depth_left/"
    elif (folder / "image_right").is_dir():
        others, name = images(folder / "image_right"), "image_right/"
    else:
        raise InputError("it has neither depth_left/ nor image_right/; one of them is needed.", folder)
    pairs, skipped = pair(lefts, others, "image_left/", name, folder)
    names = [left.stem for left, _ in pairs]
    poses, missing = _poses(folder, options, names)
    camera = _camera(folder, options, *common_size([left for left, _ in pairs]))
    rig = None if has_depth else _rig(camera, options)
    frames = [
        Frame(
            name=frame_name,
            camera=camera,
            color=left,
            right=None if has_depth else other,
            depth=Packed(other, "depth", partial(_depth, other)) if has_depth else None,
            depth_scale=options.depth_scale or 1.0,
            world_from_camera=pose,
        )
        for frame_name, (left, other), pose in zip(names, pairs, poses, strict=True)
    ]
    return Scan(LAYOUT.name, frames, rig, folder, tuple(skipped), (), missing)


def _poses(
    folder: Path, options: ScanParams, names: Sequence[str]
) -> tuple[list[Pose | None], tuple[str, ...]]:
    """Return a pose a frame, in OpenCV axes of the camera, and what is missing."""
    given = options.file("poses", folder)
    path = given or first_existing(folder, _POSES)
    if path is None:
        lacking = f"poses: {_POSES} is missing; name a trajectory with scan.poses=FILE"
        return [None] * len(names), (lacking,)
    if given is not None and given.name != _POSES:
        return trajectories.match(trajectories.read_trajectory(given), names, given), ()
    trajectory = trajectories.read_translation_first(path)
    poses = trajectories.match(trajectory, names, path)
    return [None if pose is None else pose @ _NED_FROM_CAMERA for pose in poses], ()


def _depth(path: Path) -> NDArray[Any]:
    """Return a depth map as stored, without the sky."""
    raw = read_raw_depth(path)
    return np.where(raw < _SKY, raw, 0)


def _camera(folder: Path, options: ScanParams, width: int, height: int) -> Camera:
    stated, path = options.camera(width, height), options.file("calibration", folder)
    if stated is not None:
        return stated
    return scaled(_CAMERA, width, height) if path is None else calibration.read_camera(path, width, height)


def _rig(camera: Camera, options: ScanParams) -> StereoRig:
    beside = calibration.with_baseline(np.eye(4), options.baseline or _BASELINE)
    return StereoRig(camera, camera, beside, rectified=True)


LAYOUT = Layout(
    name="tartanair",
    text="image_left/, depth_left/ (or image_right/), pose_left.txt (TartanAir)",
    matches=_matches,
    read=_read,
)
