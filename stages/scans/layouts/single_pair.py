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
from scanloom.stages.files.images import read_image_size
from scanloom.stages.scans.calibration.rig_calibration import set_baseline
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_ASSUMED, SCAN_FILES_MISSING, SCAN_TABLE_DAMAGED
from scanloom.stages.scans.image_folders.image_files import find_first_existing
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Scan, StereoRig
from scanloom.stages.scans.streams.stereo_rigs import find_rig
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

_PAIR_NAMES = (("im0", "im1"), ("im2", "im6"), ("view1", "view5"), ("left", "right"))
_SUFFIXES = (".png", ".ppm", ".pgm", ".jpg", ".jpeg")
# K.txt is the format of stereo networks: the nine numbers of the matrix, and the baseline in metres.
_CALIBRATION_FILES = ("calibration.json", "calibration.toml", "K.txt")


# Middlebury 2005 and 2006, views 1 and 5 at full size: pixels, metres, pixels.
_FOCAL_LENGTH_PX, _BASELINE_M, _FULL_HEIGHT_PX = 3740.0, 0.16, 1110
_PUBLISHED_WARNING = CAMERA_CALIBRATION_ASSUMED.warning(
    "the published calibration of Middlebury 2005 and 2006 is used (3740 px at full size, "
    "0.16 m, dmin.txt), with the principal point at the image centre",
    remedy="for another data set, set scan.intrinsics=fx,fy,cx,cy and scan.baseline=METRES",
)


def _get_published_rig(folder: Path, size: tuple[int, int]) -> StereoRig | None:
    """Return the rig of Middlebury 2005 and 2006, or None.

    It is known for full, half and third size images.

    The published images are cropped: the offset in dmin.txt, in full-size pixels, has to be added to each
    disparity.
    """
    path = folder / "dmin.txt"
    if not path.exists() or size[1] not in (_FULL_HEIGHT_PX, _FULL_HEIGHT_PX // 2, _FULL_HEIGHT_PX // 3):
        return None
    downscale_ratio = size[1] / _FULL_HEIGHT_PX
    focal = _FOCAL_LENGTH_PX * downscale_ratio
    left = Camera(*size, focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2)
    right = replace(left, cx=left.cx + _read_disparity_offset(path) * downscale_ratio)
    return StereoRig(left, right, set_baseline(np.eye(4), _BASELINE_M), is_rectified=True)


def _read_disparity_offset(path: Path) -> float:
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


def _find_pair(folder: Path) -> tuple[Path, Path] | None:
    for names in _PAIR_NAMES:
        left, right = (
            find_first_existing(folder, *(name + suffix for suffix in _SUFFIXES)) for name in names
        )
        if left is not None and right is not None:
            return left, right
    return None


def _matches(folder: Path) -> str | None:
    found = _find_pair(folder)
    return f"{found[0].name} and {found[1].name}" if found else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    found = _find_pair(folder)
    if found is None:
        raise InputError(
            SCAN_FILES_MISSING, "a pair im2.png and im6.png (or view1, view5) is required.", folder
        )
    size = read_image_size(found[0])
    with collecting(forward=False) as diagnostics:
        rig, missing = find_rig(folder, options, size, _CALIBRATION_FILES)
    published = None
    if missing and options.intrinsics is None and found[0].stem == "view1":
        published = _get_published_rig(folder, size)
    if published is not None:
        rig, diagnostics, missing = published, [_PUBLISHED_WARNING], ()
        if options.baseline is not None:
            right_from_left = set_baseline(rig.right_from_left, options.baseline)
            rig = replace(rig, right_from_left=right_from_left)
    emit(*diagnostics)
    path = options.resolve_file("poses", folder)
    poses = (
        [None]
        if path is None
        else trajectories.match_poses_to_frames(trajectories.read_trajectory(path), ["0"], path)
    )
    frame = Frame(
        name=found[0].stem, camera=rig.left, color=found[0], right=found[1], world_from_camera=poses[0]
    )
    if path is None:
        lacking = describe_missing_poses(
            "a single pair has no poses", remedy="name a pose file with scan.poses=FILE"
        )
        missing = (*missing, lacking)
    return Scan(LAYOUT.name, [frame], rig, folder, missing=missing)


LAYOUT = Layout(
    name="pair",
    description="im2 and im6, or view1 and view5 with dmin.txt, .png or .ppm (Middlebury 2001 to 2006); "
    "or left.png and right.png, optionally with K.txt",
    matches=_matches,
    read=_read,
)
