"""Middlebury 2014 and 2021, and ETH3D two-view: one rectified pair with calib.txt."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.files.images import read_image_size
from scanloom.stages.scans.calibration.camera_files import check_camera_values
from scanloom.stages.scans.calibration.image_size import get_stated_size, scale_to_images
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_ASSUMED, CAMERA_CALIBRATION_INVALID
from scanloom.stages.scans.image_folders.image_files import find_first_existing, has_all
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, StereoRig
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories


def _matches(folder: Path) -> str | None:
    return "im0.png, im1.png and calib.txt" if has_all(folder, "im0.png", "im1.png", "calib.txt") else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    left, right, calib = folder / "im0.png", folder / "im1.png", folder / "calib.txt"
    rig = _read_rig(calib, read_image_size(left), options)
    pose = _read_pose(folder, options)
    frame = Frame(name="im0", camera=rig.left, color=left, right=right, world_from_camera=pose)
    lacking = describe_missing_poses("pose.txt is missing", remedy="name a pose file with scan.poses=FILE")
    missing = () if pose is not None else (lacking,)
    return Scan(LAYOUT.name, [frame], rig, folder, missing=missing)


def _read_rig(calib: Path, size: tuple[int, int], options: ReadingParams) -> StereoRig:
    values = documents.parse_assignments(documents.read_text(calib))
    try:
        stated = get_stated_size(
            {key: values[key] for key in ("width", "height") if key in values}, *size, calib
        )
        left, right = (_parse_camera(values[key], stated, calib) for key in ("cam0", "cam1"))
        doffs = float(values["doffs"]) if "doffs" in values else right.cx - left.cx
        baseline = float(values["baseline"])
        disparities = int(values["ndisp"]) if "ndisp" in values else None
    except (KeyError, ValueError) as error:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "cam0, cam1 and baseline are required; {error} is missing or not a number.",
            calib,
            error=error,
        ) from error
    # Downscaled images are often stored with the calibration of the original size.
    left, downscale_ratio = scale_to_images(left, *size, calib), size[0] / stated[0]
    doffs *= downscale_ratio
    disparities = None if disparities is None else math.ceil(disparities * downscale_ratio)
    if not (0 < baseline < 1e5 and abs(doffs) < size[0]):
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "invalid baseline={baseline:g} mm or doffs={doffs:g} px.",
            calib,
            baseline=baseline,
            doffs=doffs,
        )
    if baseline < 5:
        emit(
            CAMERA_CALIBRATION_ASSUMED.warning(
                "the baseline of {baseline:g} is assumed to be in metres, because it is too small for "
                "millimetres",
                calib,
                baseline=baseline,
            )
        )
        baseline *= 1000
    given = options.get_camera(*size)
    if given is not None:
        left = given
    # Middlebury defines z = f b / (d + doffs): one focal length for both cameras, and doffs as a shift of the
    # principal point.
    right = Camera(*size, left.fx, left.fy, left.cx + doffs, left.cy)
    right_from_left = np.eye(4)
    right_from_left[0, 3] = -(options.baseline or baseline / 1000)
    return StereoRig(left, right, right_from_left, True, disparities)


def _parse_camera(text: str, size: tuple[int, int], calib: Path) -> Camera:
    rows = [[float(word) for word in row.split()] for row in text.strip("[] ").split(";")]
    if [len(row) for row in rows] != [3, 3, 3]:
        raise ValueError("a 3x3 camera matrix")
    return check_camera_values(Camera(*size, rows[0][0], rows[1][1], rows[0][2], rows[1][2]), calib)


def _read_pose(folder: Path, options: ReadingParams) -> Pose | None:
    """Return the pose of the single frame, or None."""
    path = options.resolve_file("poses", folder) or find_first_existing(folder, "pose.txt")
    return (
        None
        if path is None
        else trajectories.match_poses_to_frames(trajectories.read_trajectory(path), ["im0"], path)[0]
    )


LAYOUT = Layout(
    name="middlebury",
    description="im0.png, im1.png, calib.txt (Middlebury 2014/2021, ETH3D two-view)",
    matches=_matches,
    read=_read,
)
