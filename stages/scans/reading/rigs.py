"""The rig of a pair layout: from its calibration file, or from what the person states."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stages.files import documents
from stages.files.noting import note, only_looking
from stages.scans.formats import rig_calibration
from stages.scans.formats.calibration import document_of
from stages.scans.reading.beside import not_taken, parts_of_calibration, places_of_calibrations, rigs_beside
from stages.scans.reading.files import first_existing, has
from stages.scans.reading.params import ReadingParams
from stages.scans.reading.streams import Images
from stages.scans.scan import Camera, StereoRig

_OPENCV_FILES = ("intrinsics.yml", "extrinsics.yml")
# ROS's calibrator writes a file a camera.
_ROS_FILES = (
    ("left.yaml", "right.yaml"),
    ("left_camera_info.yaml", "right_camera_info.yaml"),
    ("camera_info_left.yaml", "camera_info_right.yaml"),
)


def rig_of(
    folder: Path, options: ReadingParams, size: tuple[int, int], names: Sequence[str]
) -> tuple[StereoRig, list[str], tuple[str, ...]]:
    """Return the rig, what is odd about its calibration, and what is missing.

    Parameters
    ----------
    folder, options : of the scan.
    size : of the images, (width, height) in pixels.
    names : calibration files to look for in the folder, the preferred first.

    Raises
    ------
    InputError
        If the calibration cannot be read.
    """
    stated = options.camera(*size)
    path = options.file("calibration", folder) or first_existing(folder, *names)
    if path is not None:
        document = _with_other_half(path)
        rig, warnings = rig_calibration.read_rig(path, *size, document=document, baseline=options.baseline)
    elif stated is not None and options.baseline is not None:
        beside = rig_calibration.with_baseline(np.eye(4), options.baseline)
        return StereoRig(stated, stated, beside, rectified=True), [], ()
    elif (several := _in_halves(folder) or _in_parts(folder)) is not None:
        document, path, said = several
        rig, warnings = rig_calibration.read_rig(path, *size, document=document, baseline=options.baseline)
        warnings = [*said, *warnings]
    elif found := rigs_beside(folder, *size, options.baseline):
        rig, warnings, path = found[0]
        if len(found) > 1:
            names = ", ".join(one.name for *_, one in found[:5])
            lacking = f"calibration: {names} all state one; name the right one with scan.calibration=FILE"
            return uncalibrated(size), [], (lacking,)
        note(path)
        name = path.relative_to(folder).as_posix()
        warnings = [f"the calibration is read from {name}, which lies beside the images", *warnings]
    else:
        half = "; intrinsics.yml lacks extrinsics.yml beside it" if has(folder, "intrinsics.yml") else ""
        lacking = (
            f"calibration: {names[0]} is missing{half}; name one with scan.calibration=FILE, or set "
            "scan.intrinsics=fx,fy,cx,cy and scan.baseline=METRES for a rectified pair"
        )
        return uncalibrated(size), not_taken(folder, *size, rig_calibration.read_rig), (lacking,)
    return (rig if stated is None else replace(rig, left=stated, right=stated)), warnings, ()


def _in_halves(folder: Path) -> tuple[dict[str, Any], Path, list[str]] | None:
    """Return a calibration in two files, as OpenCV's sample and ROS write it, and what is to be said."""
    for place in places_of_calibrations(folder):
        for pair in (_OPENCV_FILES, *_ROS_FILES):
            if has(place, *pair):
                first, second = (documents.read_document(place / name) for name in pair)
                table = first | second if pair == _OPENCV_FILES else {"left": first, "right": second}
                said = [] if place == folder else [f"the calibration is read from the files in {place.name}/"]
                return table, place / pair[1], said
    return None


def _in_parts(folder: Path) -> tuple[dict[str, Any], Path, list[str]] | None:
    """Return a calibration of which each matrix is a file, the folder of these, and what is to be said."""
    for place in places_of_calibrations(folder):
        with only_looking():
            table, files = parts_of_calibration(place)
        if rig_calibration.states_a_pair(table):
            for path in files:
                note(path)
            names = ", ".join(path.relative_to(folder).as_posix() for path in files)
            said = [f"the calibration is read from {names}, a matrix each"]
            return table, place, said
    return None


def _with_other_half(path: Path) -> dict[str, Any] | None:
    """Return what a calibration and the file of its other half say, where OpenCV wrote them as two files."""
    for half, other in (("extrinsics", "intrinsics"), ("intrinsics", "extrinsics")):
        beside = path.with_name(path.name.replace(half, other))
        if half in path.name and path.is_file() and beside.is_file():
            return (document_of(beside) or {}) | (document_of(path) or {}) or None
    return None


def stated_rig(left: Images, folder: Path, options: ReadingParams) -> tuple[StereoRig, list[str]] | None:
    """Return the rig of a recorded pair that the person states, and what is odd about it; None if not.

    Raises
    ------
    InputError
        If the calibration file cannot be read, or the first left image, whose size it is for.
    """
    if options.calibration is None and (options.intrinsics is None or options.baseline is None):
        return None
    height, width = left.color(0).shape[:2]
    rig, warnings, _ = rig_of(folder, options, (width, height), ())
    return rig, warnings


def uncalibrated(size: tuple[int, int]) -> StereoRig:
    """Return the rig of pairs of which only the size is known: every other number is NaN."""
    camera = Camera(*size, math.nan, math.nan, math.nan, math.nan)
    return StereoRig(camera, camera, np.full((4, 4), math.nan), rectified=False)
