"""Stereo rig of a layout, from calibration files or the user."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.files import documents
from scanloom.stages.files.file_access_log import pause_recording, record_opened
from scanloom.stages.scans.calibration import rig_calibration
from scanloom.stages.scans.calibration.camera_files import read_calibration_document
from scanloom.stages.scans.calibration.discovery import (
    find_rigs,
    list_calibration_folders,
    read_split_calibration,
    warn_rejected_files,
)
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_ASSUMED
from scanloom.stages.scans.image_folders.image_files import find_first_existing, has_all
from scanloom.stages.scans.model.missing_data import describe_missing_calibration
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, StereoRig
from scanloom.stages.scans.streams.timestamped_streams import TimestampedImages

_OPENCV_FILES = ("intrinsics.yml", "extrinsics.yml")
# ROS's camera calibrator writes one file per camera.
_ROS_FILES = (
    ("left.yaml", "right.yaml"),
    ("left_camera_info.yaml", "right_camera_info.yaml"),
    ("camera_info_left.yaml", "camera_info_right.yaml"),
)


def find_rig(
    folder: Path, options: ReadingParams, size: tuple[int, int], names: Sequence[str]
) -> tuple[StereoRig, tuple[Diagnostic, ...]]:
    """Find and read the stereo calibration of a folder.

    Sources, in this order:

    - the file given by the user, or one of `names`
    - intrinsics and baseline given by the user
    - calibrations split over several files
    - any other file in or near the folder that holds a rig

    Parameters
    ----------
    size : image size (width, height) in pixels.
    names : names of calibration files to look for in the folder, the preferred first.

    Returns
    -------
    rig : the stereo rig; with NaN entries if the calibration is missing.
    missing : diagnostics of the missing calibration; empty if there is one.

    Raises
    ------
    InputError
        If the calibration cannot be read.
    """
    stated = options.get_camera(*size)
    path = options.resolve_file("calibration", folder) or find_first_existing(folder, *names)
    if path is not None:
        document = _merge_opencv_files(path)
        rig = rig_calibration.read_rig(path, *size, document=document, baseline=options.baseline)
    elif stated is not None and options.baseline is not None:
        right_from_left = rig_calibration.set_baseline(np.eye(4), options.baseline)
        return StereoRig(stated, stated, right_from_left, is_rectified=True), ()
    elif (split_calibration := _read_split_calibration(folder) or _read_matrix_files(folder)) is not None:
        document, path = split_calibration
        rig = rig_calibration.read_rig(path, *size, document=document, baseline=options.baseline)
    elif found := find_rigs(folder, *size, options.baseline):
        rig, path, diagnostics = found[0]
        if len(found) > 1:
            lacking = describe_missing_calibration(
                "several files contain one: {files}",
                remedy="choose one with scan.calibration=FILE",
                files=", ".join(one.name for _, one, _ in found[:5]),
            )
            return create_uncalibrated_rig(size), (lacking,)
        record_opened(path)
        emit(
            CAMERA_CALIBRATION_ASSUMED.warning(
                "the calibration is read from {file}, which was found in the scan folder",
                file=path.relative_to(folder).as_posix(),
            ),
            *diagnostics,
        )
    else:
        warn_rejected_files(folder, *size, rig_calibration.read_rig)
        opencv_hint = (
            "; intrinsics.yml exists, but extrinsics.yml does not"
            if has_all(folder, "intrinsics.yml")
            else ""
        )
        lacking = describe_missing_calibration(
            "{file} is missing{half}",
            remedy="name a calibration with scan.calibration=FILE, or for rectified pairs set "
            "scan.intrinsics=fx,fy,cx,cy and scan.baseline=METRES",
            file=names[0],
            half=opencv_hint,
        )
        return create_uncalibrated_rig(size), (lacking,)
    return (rig if stated is None else replace(rig, left=stated, right=stated)), ()


def _read_split_calibration(folder: Path) -> tuple[dict[str, Any], Path] | None:
    """Read a calibration that OpenCV's sample or ROS split into two files.

    Returns the merged document and the path of the second file, or None.
    """
    for place in list_calibration_folders(folder):
        for pair in (_OPENCV_FILES, *_ROS_FILES):
            if has_all(place, *pair):
                first, second = (documents.read_document(place / name) for name in pair)
                table = first | second if pair == _OPENCV_FILES else {"left": first, "right": second}
                if place != folder:
                    emit(
                        CAMERA_CALIBRATION_ASSUMED.warning(
                            "the calibration is read from the files in {folder}/", folder=place.name
                        )
                    )
                return table, place / pair[1]
    return None


def _read_matrix_files(folder: Path) -> tuple[dict[str, Any], Path] | None:
    """Read a calibration that stores each matrix in a separate file.

    Returns the merged document and the folder of the files, or None.
    """
    for place in list_calibration_folders(folder):
        with pause_recording():
            table, files = read_split_calibration(place)
        if rig_calibration.has_camera_pair(table):
            for path in files:
                record_opened(path)
            emit(
                CAMERA_CALIBRATION_ASSUMED.warning(
                    "the calibration is read from {files} (one matrix per file)",
                    files=", ".join(path.relative_to(folder).as_posix() for path in files),
                )
            )
            return table, place
    return None


def _merge_opencv_files(path: Path) -> dict[str, Any] | None:
    """Read OpenCV's intrinsics and extrinsics files as one document.

    `path` is either of the two files.

    Returns None if the file is not one of such a pair.
    """
    for half, other in (("extrinsics", "intrinsics"), ("intrinsics", "extrinsics")):
        beside = path.with_name(path.name.replace(half, other))
        if half in path.name and path.is_file() and beside.is_file():
            return (read_calibration_document(beside) or {}) | (read_calibration_document(path) or {}) or None
    return None


def read_stated_rig(left: TimestampedImages, folder: Path, options: ReadingParams) -> StereoRig | None:
    """Return the rig that the user gives for a recording, or None.

    Raises
    ------
    InputError
        If the calibration file, or the first left image (for its size), cannot be read.
    """
    if options.calibration is None and (options.intrinsics is None or options.baseline is None):
        return None
    height, width = left.read_color(0).shape[:2]
    rig, _ = find_rig(folder, options, (width, height), ())
    return rig


def create_uncalibrated_rig(size: tuple[int, int]) -> StereoRig:
    """Create a placeholder rig of which only the image size is known.

    All other numbers are NaN.
    """
    camera = Camera(*size, math.nan, math.nan, math.nan, math.nan)
    return StereoRig(camera, camera, np.full((4, 4), math.nan), is_rectified=False)
