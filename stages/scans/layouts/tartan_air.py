"""TartanAir: rendered stereo pairs, left depth, and poses in NED axes.

image_left/000000_left.png   depth_left/000000_left_depth.npy   pose_left.txt
image_right/000000_right.png                                     used if there is no depth

Version 2 has six view directions, and stores the four bytes of a float32 depth in the four channels of
a PNG:

image_lcam_front/000000_lcam_front.png   depth_lcam_front/000000_lcam_front_depth.png   pose_lcam_front.txt
image_rcam_front/000000_rcam_front.png
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_DEPTH_FORMAT
from scanloom.stages.files.images import read_raw_depth, read_stored_image
from scanloom.stages.scans.calibration import rig_calibration
from scanloom.stages.scans.calibration.camera_resolution import get_stated_camera
from scanloom.stages.scans.codes import SCAN_FILES_MISSING
from scanloom.stages.scans.image_folders.image_files import (
    DEPTH_SUFFIXES,
    find_common_size,
    find_first_existing,
    list_images,
    match_by_number,
)
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, PackedImage, Pose, Scan, StereoRig, scale_camera
from scanloom.stages.scans.model.world import Z_DOWN
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories


@dataclass(frozen=True)
class _ViewFiles:
    """Folder and file names of one view direction, and its camera."""

    left: str
    right: str
    depth: str
    poses: str
    camera: Camera


_VERSION_1_VIEW = _ViewFiles(
    "image_left", "image_right", "depth_left", "pose_left.txt", Camera(640, 480, 320.0, 320.0, 320.0, 240.0)
)
# In order of preference: the front view first.
_VIEWS = (
    _VERSION_1_VIEW,
    *(
        _ViewFiles(
            f"image_lcam_{way}",
            f"image_rcam_{way}",
            f"depth_lcam_{way}",
            f"pose_lcam_{way}.txt",
            # Field of view 90°, as in the reader of the data set: the principal point is between the middle
            # pixels.
            Camera(640, 640, 320.0, 320.0, 319.5, 319.5),
        )
        for way in ("front", "left", "right", "back", "top", "bottom")
    ),
)
_BASELINE_M = 0.25
# Metres. The sky has a large depth that varies between scenes.
_SKY_DEPTH_M = 1000.0
# Camera axes of the data set: x forward, y right, z down.
_NED_FROM_CAMERA = np.array([[0.0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


def _matches(folder: Path) -> str | None:
    found = (view for view in _VIEWS if (folder / view.poses).is_file() and (folder / view.left).is_dir())
    return next((f"{view.poses} and {view.left}/" for view in found), None)


def _read(folder: Path, options: ReadingParams) -> Scan:
    view = next((one for one in _VIEWS if (folder / one.left).is_dir()), None)
    if view is None:
        raise InputError(
            SCAN_FILES_MISSING, "a folder image_left/ (or image_lcam_front/) is required.", folder
        )
    lefts = list_images(folder / view.left)
    has_depth = (folder / view.depth).is_dir()
    if has_depth:
        others, name = list_images(folder / view.depth, DEPTH_SUFFIXES), f"{view.depth}/"
    elif (folder / view.right).is_dir():
        others, name = list_images(folder / view.right), f"{view.right}/"
    else:
        raise InputError(
            SCAN_FILES_MISSING,
            "{depth}/ or {right}/ is required, but both are missing.",
            folder,
            depth=view.depth,
            right=view.right,
        )
    pairs, skipped = match_by_number(lefts, others, f"{view.left}/", name, folder)
    names = [left.stem for left, _ in pairs]
    poses, missing = _read_poses(folder, options, view, names)
    size = find_common_size([left for left, _ in pairs])
    camera = get_stated_camera(options, folder, *size) or scale_camera(view.camera, *size)
    rig = None if has_depth else _create_rig(camera, options)
    frames = [
        Frame(
            name=frame_name,
            camera=camera,
            color=left,
            right=None if has_depth else other,
            depth=PackedImage(other, "depth", partial(_read_depth, other)) if has_depth else None,
            depth_scale=options.depth_scale or 1.0,
            world_from_camera=pose,
        )
        for frame_name, (left, other), pose in zip(names, pairs, poses, strict=True)
    ]
    return Scan(LAYOUT.name, frames, rig, folder, tuple(skipped), missing=missing)


def _read_poses(
    folder: Path, options: ReadingParams, view: _ViewFiles, names: Sequence[str]
) -> tuple[list[Pose | None], tuple[Diagnostic, ...]]:
    """Return a pose per frame with OpenCV camera axes, and missing-pose diagnostics."""
    given = options.resolve_file("poses", folder)
    path = given or find_first_existing(folder, view.poses)
    if path is None:
        return [None] * len(names), (describe_missing_poses("{file} is missing", file=view.poses),)
    if given is not None and given.name != view.poses:
        return trajectories.match_poses_to_frames(trajectories.read_trajectory(given), names, given), ()
    trajectory = trajectories.read_translation_first(path)
    poses = trajectories.match_poses_to_frames(trajectory, names, path)
    return [None if pose is None else pose @ _NED_FROM_CAMERA for pose in poses], ()


def _read_depth(path: Path) -> NDArray[Any]:
    """Read a depth map with the sky set to 0 (missing)."""
    raw = _read_packed_depth(path) if path.suffix == ".png" else read_raw_depth(path)
    return np.where(raw < _SKY_DEPTH_M, raw, 0)


def _read_packed_depth(path: Path) -> NDArray[np.float32]:
    """Decode float32 depth from an image with four 8-bit channels.

    Blue, green, red and alpha are the bytes of a value, lowest first.
    """
    channels = read_stored_image(path)
    if channels.dtype != np.uint8 or channels.ndim != 3 or channels.shape[2] != 4:
        raise InputError(FILE_DEPTH_FORMAT, "a depth map packed into four 8-bit channels is expected.", path)
    return np.ascontiguousarray(channels).view("<f4")[:, :, 0]


def _create_rig(camera: Camera, options: ReadingParams) -> StereoRig:
    right_from_left = rig_calibration.set_baseline(np.eye(4), options.baseline or _BASELINE_M)
    return StereoRig(camera, camera, right_from_left, is_rectified=True)


LAYOUT = Layout(
    name="tartanair",
    description="image_left/ (or image_lcam_front/), depth_left/ or image_right/, pose_left.txt (TartanAir)",
    matches=_matches,
    read=_read,
    up=Z_DOWN,
)
