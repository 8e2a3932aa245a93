"""Karlsruhe street sequences (libviso2): rectified pairs in one folder, and calib.txt.

    I1_000000.png  I2_000000.png  …
    calib.txt                        P1_roi and P2_roi, 3x4 projections of the cropped region

insdata.txt, the trajectory of the car, is ignored: its offset to the cameras is unknown.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_INVALID
from scanloom.stages.scans.image_folders.image_files import (
    find_common_size,
    find_first_existing,
    list_images,
    match_by_number,
)
from scanloom.stages.scans.layouts.kitti.projections import create_projected_rig
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Frame, Pose, Scan
from scanloom.stages.scans.streams.stereo_rigs import find_rig
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

_IMAGE_NAME = re.compile(r"I([12])_\d+")
_PROJECTION_NAMES = {"1": "P1_roi", "2": "P2_roi"}
_CALIBRATION_FILES = ("calib.txt", "../calib.txt")
_POSE_FILES = ("poses.txt", "poses.tum")
_CAR_POSITIONS_FILE = "insdata.txt"


def _list_sides(folder: Path) -> tuple[list[Path], list[Path]]:
    named = [(match[1], path) for path in list_images(folder) if (match := _IMAGE_NAME.fullmatch(path.stem))]
    left, right = ([path for side, path in named if side == number] for number in "12")
    return left, right


def _matches(folder: Path) -> str | None:
    left, right = _list_sides(folder)
    return f"files named like {left[0].name} and {right[0].name}" if left and right else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    pairs, skipped = match_by_number(
        *_list_sides(folder), "the images named I1", "the images named I2", folder
    )
    size = find_common_size([one for one, _ in pairs])
    calib = find_first_existing(folder, *_CALIBRATION_FILES) if options.calibration is None else None
    projections = {} if calib is None else _read_projections(calib)
    missing: tuple[Diagnostic, ...] = ()
    if calib is not None and {"1", "2"} <= projections.keys():
        rig, _ = create_projected_rig(projections["1"], projections["2"], size, options, calib)
    else:
        rig, missing = find_rig(folder, options, size, ("calib.txt with P1_roi and P2_roi",))
    names = [one.stem for one, _ in pairs]
    path = options.resolve_file("poses", folder) or find_first_existing(folder, *_POSE_FILES)
    poses: list[Pose | None] = [None] * len(pairs)
    if path is not None:
        poses = trajectories.match_poses_to_frames(trajectories.read_trajectory(path), names, path)
    else:
        car = (
            f" ({_CAR_POSITIONS_FILE} has positions of the car, but their offset to the cameras is unknown)"
            if (folder / _CAR_POSITIONS_FILE).is_file()
            else ""
        )
        missing = (*missing, describe_missing_poses("poses.txt is missing{car}", car=car))
    frames = [
        Frame(name=name, camera=rig.left, color=one, right=other, world_from_camera=pose)
        for name, (one, other), pose in zip(names, pairs, poses, strict=True)
    ]
    return Scan(LAYOUT.name, frames, rig, folder, tuple(skipped), missing=missing)


def _read_projections(calib: Path) -> dict[str, NDArray[np.float64]]:
    """Read the projection matrices (3, 4), by camera number."""
    found = {}
    values = documents.parse_assignments(documents.read_text(calib), ":=")
    for side, name in _PROJECTION_NAMES.items():
        text = values.get(name)
        if text is None:
            continue
        try:
            row = np.array([float(word) for word in text.split()])
        except ValueError:
            row = np.empty(0)
        if row.size != 12 or not np.isfinite(row).all():
            raise InputError(
                CAMERA_CALIBRATION_INVALID, "P{side}_roi must be 12 finite numbers.", calib, side=side
            )
        found[side] = row.reshape(3, 4)
    return found


LAYOUT = Layout(
    name="karlsruhe",
    description="I1_000000.png and I2_000000.png in one folder, calib.txt with P1_roi (Karlsruhe, libviso2)",
    matches=_matches,
    read=_read,
)
