"""Single stereo pair: Middlebury 2001 to 2006, or left.png, right.png and K.txt.

The calibration of Middlebury 2005 and 2006 is built in.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.files.images import image_size
from scanloom.stages.scans.calibration.rig_calibration import with_baseline
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_ASSUMED, SCAN_FILES_MISSING, SCAN_TABLE_DAMAGED
from scanloom.stages.scans.image_folders.image_files import first_existing
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.lacking import poses_missing
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Scan, StereoRig
from scanloom.stages.scans.streams.stereo_rigs import rig_of
from scanloom.stages.scans.trajectory import files as trajectories

_PAIRS = (("im0", "im1"), ("im2", "im6"), ("view1", "view5"), ("left", "right"))
_SUFFIXES = (".png", ".ppm", ".pgm", ".jpg", ".jpeg")
# K.txt is the format of stereo networks: the nine numbers of the matrix, and the baseline in metres.
_CALIBRATIONS = ("calibration.json", "calibration.toml", "K.txt")


# Middlebury 2005 and 2006, views 1 and 5 at full size: pixels, metres, pixels.
_FOCAL_LENGTH, _BASELINE, _FULL_HEIGHT = 3740.0, 0.16, 1110
_PUBLISHED = CAMERA_CALIBRATION_ASSUMED.warning(
    "the published calibration of Middlebury 2005 and 2006 is used (3740 px at full size, "
    "0.16 m, dmin.txt), with the principal point at the image centre",
    remedy="for another data set, set scan.intrinsics=fx,fy,cx,cy and scan.baseline=METRES",
)


def _published(folder: Path, size: tuple[int, int]) -> StereoRig | None:
    """Return the rig of Middlebury 2005 and 2006, or None.

    It is known for full, half and third size images.

    The published images are cropped: the offset in dmin.txt, in full-size pixels, has to be added to each
    disparity.
    """
    path = folder / "dmin.txt"
    if not path.exists() or size[1] not in (_FULL_HEIGHT, _FULL_HEIGHT // 2, _FULL_HEIGHT // 3):
        return None
    share = size[1] / _FULL_HEIGHT
    focal = _FOCAL_LENGTH * share
    left = Camera(*size, focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2)
    right = replace(left, cx=left.cx + _least_disparity(path) * share)
    return StereoRig(left, right, with_baseline(np.eye(4), _BASELINE), rectified=True)


def _least_disparity(path: Path) -> float:
    try:
        value = float(documents.read_text(path).strip())
    except ValueError:
        value = math.nan
    if not abs(value) < 1e4:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "the file must contain one number, the disparity offset of the cropped images.",
            path,
        )
    return value


def _pair(folder: Path) -> tuple[Path, Path] | None:
    for names in _PAIRS:
        left, right = (first_existing(folder, *(name + suffix for suffix in _SUFFIXES)) for name in names)
        if left is not None and right is not None:
            return left, right
    return None


def _matches(folder: Path) -> str | None:
    found = _pair(folder)
    return f"{found[0].name} and {found[1].name}" if found else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    found = _pair(folder)
    if found is None:
        raise InputError(
            SCAN_FILES_MISSING, "a pair im2.png and im6.png (or view1, view5) is required.", folder
        )
    size = image_size(found[0])
    with collecting(forward=False) as diagnostics:
        rig, missing = rig_of(folder, options, size, _CALIBRATIONS)
    published = None
    if missing and options.intrinsics is None and found[0].stem == "view1":
        published = _published(folder, size)
    if published is not None:
        rig, diagnostics, missing = published, [_PUBLISHED], ()
        if options.baseline is not None:
            beside = with_baseline(rig.right_from_left, options.baseline)
            rig = replace(rig, right_from_left=beside)
    emit(*diagnostics)
    path = options.file("poses", folder)
    poses = [None] if path is None else trajectories.match(trajectories.read_trajectory(path), ["0"], path)
    frame = Frame(
        name=found[0].stem, camera=rig.left, color=found[0], right=found[1], world_from_camera=poses[0]
    )
    if path is None:
        lacking = poses_missing("a single pair has no poses", remedy="name a pose file with scan.poses=FILE")
        missing = (*missing, lacking)
    return Scan(LAYOUT.name, [frame], rig, folder, missing=missing)


LAYOUT = Layout(
    name="pair",
    text="im2 and im6, or view1 and view5 with dmin.txt, .png or .ppm (Middlebury 2001 to 2006); "
    "or left.png and right.png, optionally with K.txt",
    matches=_matches,
    read=_read,
)
