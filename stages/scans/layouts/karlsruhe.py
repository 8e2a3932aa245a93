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
from scanloom.stages.scans.image_folders.image_files import common_size, first_existing, images, pair
from scanloom.stages.scans.layouts.kitti.projections import projected_rig
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.lacking import poses_missing
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Frame, Pose, Scan
from scanloom.stages.scans.streams.stereo_rigs import rig_of
from scanloom.stages.scans.trajectory import files as trajectories

_NAME = re.compile(r"I([12])_\d+")
_PROJECTION = re.compile(r"^\s*P([12])_roi\s*[:=]\s*(.*?)\s*$", re.MULTILINE)
_CALIBRATIONS = ("calib.txt", "../calib.txt")
_POSES = ("poses.txt", "poses.tum")
_CAR = "insdata.txt"


def _sides(folder: Path) -> tuple[list[Path], list[Path]]:
    named = [(match[1], path) for path in images(folder) if (match := _NAME.fullmatch(path.stem))]
    left, right = ([path for side, path in named if side == number] for number in "12")
    return left, right


def _matches(folder: Path) -> str | None:
    left, right = _sides(folder)
    return f"files named like {left[0].name} and {right[0].name}" if left and right else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    pairs, skipped = pair(*_sides(folder), "the images named I1", "the images named I2", folder)
    size = common_size([one for one, _ in pairs])
    calib = first_existing(folder, *_CALIBRATIONS) if options.calibration is None else None
    projections = {} if calib is None else _projections(calib)
    missing: tuple[Diagnostic, ...] = ()
    if calib is not None and {"1", "2"} <= projections.keys():
        rig, _ = projected_rig(projections["1"], projections["2"], size, options, calib)
    else:
        rig, missing = rig_of(folder, options, size, ("calib.txt with P1_roi and P2_roi",))
    names = [one.stem for one, _ in pairs]
    path = options.file("poses", folder) or first_existing(folder, *_POSES)
    poses: list[Pose | None] = [None] * len(pairs)
    if path is not None:
        poses = trajectories.match(trajectories.read_trajectory(path), names, path)
    else:
        car = (
            f" ({_CAR} has positions of the car, but their offset to the cameras is unknown)"
            if (folder / _CAR).is_file()
            else ""
        )
        missing = (*missing, poses_missing("poses.txt is missing{car}", car=car))
    frames = [
        Frame(name=name, camera=rig.left, color=one, right=other, world_from_camera=pose)
        for name, (one, other), pose in zip(names, pairs, poses, strict=True)
    ]
    return Scan(LAYOUT.name, frames, rig, folder, tuple(skipped), missing=missing)


def _projections(calib: Path) -> dict[str, NDArray[np.float64]]:
    """Read the projection matrices (3, 4), by camera number."""
    found = {}
    for side, text in _PROJECTION.findall(documents.read_text(calib)):
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
    text="I1_000000.png and I2_000000.png in one folder, calib.txt with P1_roi (Karlsruhe, libviso2)",
    matches=_matches,
    read=_read,
)
