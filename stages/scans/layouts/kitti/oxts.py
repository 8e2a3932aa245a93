"""Poses of KITTI's raw recordings: a file a frame of what the car's navigation unit (GPS and IMU) measured.

    oxts/data/0000000000.txt      latitude, longitude (degrees), altitude (m), roll, pitch, yaw (rad), …
    calib_imu_to_velo.txt         R, T: takes points of the unit to the laser scanner
    calib_velo_to_cam.txt         R, T: takes points of the scanner to camera 0, before it is rectified
    calib_cam_to_cam.txt          R_rect_00: rectifies camera 0

The world has x east, y north, z up, and its origin where the first file says that the unit is.

Reference: Geiger, Lenz, Stiller, Urtasun, Vision meets Robotics: The KITTI Dataset, IJRR 2013, and the
data set's development kit (Mercator projection at the latitude of the first file).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.codes import POSE_TRAJECTORY_UNREADABLE
from scanloom.stages.scans.image_folders.image_files import first_existing, numbers
from scanloom.stages.scans.model.poses import inverted, rigid
from scanloom.stages.scans.model.scan import Pose

_DATA = "oxts/data"
# Metres, of the equator.
_EARTH_RADIUS = 6378137.0
# The Mercator projection has no poles.
_FARTHEST_LATITUDE = 85.0
_READ = 6


def unit_poses(folder: Path, names: Sequence[str], cameras: Path) -> tuple[list[Pose | None] | None, str]:
    """Return world_from_cam0 (rectified) of each frame, None where a file is missing; or what is lacking.

    Parameters
    ----------
    folder : of the drive; the calibration stands in it or, for all drives of a day, above.
    names : of the frames, numbered as the files.
    cameras : calib_cam_to_cam.txt.

    Raises
    ------
    InputError
        If a file is damaged.
    """
    data = folder / _DATA
    if not data.is_dir():
        return None, f"{_DATA}/ is missing"
    found = {}
    for name in ("calib_imu_to_velo.txt", "calib_velo_to_cam.txt"):
        path = first_existing(folder, name, f"../{name}")
        if path is None:
            return None, f"{_DATA}/ is there, but {name}, which says how the camera stands to it, is missing"
        found[name] = _place(path)
    turn = _numbers(cameras, "R_rect_00", 9)
    if turn is None:
        return None, f"{_DATA}/ is there, but {cameras.name} has no R_rect_00"
    rectified = _rigid(turn.reshape(3, 3), np.zeros(3), cameras)
    cam0_from_unit = rectified @ found["calib_velo_to_cam.txt"] @ found["calib_imu_to_velo.txt"]
    files = sorted(data.glob("*.txt"), key=lambda path: (numbers(path.stem), path.name))
    world_from_unit = _unit_poses(files)
    unit_from_cam0 = inverted(cam0_from_unit)
    return [
        None if (pose := world_from_unit.get(numbers(name))) is None else pose @ unit_from_cam0
        for name in names
    ], ""


def _unit_poses(files: Sequence[Path]) -> dict[tuple[int, ...], Pose]:
    """Return world_from_unit by the numbers in the files' names."""
    from scipy.spatial.transform import Rotation

    poses: dict[tuple[int, ...], Pose] = {}
    scale, origin = 1.0, np.zeros(3)
    for file in files:
        latitude, longitude, altitude, roll, pitch, yaw = _measured(file)
        if not poses:
            scale = math.cos(math.radians(latitude))
        # Lengths of the projection are those of the equator: they are true at the latitude of the scale.
        east = math.radians(longitude)
        north = math.log(math.tan(math.radians(90 + latitude) / 2))
        place = np.array([scale * _EARTH_RADIUS * east, scale * _EARTH_RADIUS * north, altitude])
        if not poses:
            origin = place
        pose = np.eye(4)
        # Roll about x first, then pitch about y, then yaw about z, each about the world's axis.
        pose[:3, :3] = Rotation.from_euler("xyz", (roll, pitch, yaw)).as_matrix()
        pose[:3, 3] = place - origin
        poses[numbers(file.stem)] = pose
    return poses


def _measured(file: Path) -> list[float]:
    try:
        values = [float(word) for word in documents.read_text(file).split()[:_READ]]
    except ValueError:
        values = []
    if len(values) != _READ or not all(math.isfinite(value) for value in values):
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE,
            "it does not begin with six numbers: latitude, longitude, … yaw.",
            file,
        )
    if abs(values[0]) > _FARTHEST_LATITUDE:
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE,
            "a latitude of {values:g} degrees cannot be right.",
            file,
            values=values[0],
        )
    return values


def _place(path: Path) -> Pose:
    """Return the relation that R and T of a file state."""
    turn, shift = _numbers(path, "R", 9), _numbers(path, "T", 3)
    if turn is None or shift is None:
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE, "rows `R: …` of 9 numbers and `T: …` of 3 are expected.", path
        )
    return _rigid(turn.reshape(3, 3), shift, path)


def _rigid(turn: NDArray[np.float64], shift: NDArray[np.float64], path: Path) -> Pose:
    pose = rigid(np.column_stack([turn, shift]), path)
    if pose is None:
        raise InputError(POSE_TRAJECTORY_UNREADABLE, "its numbers are not finite.", path)
    return pose


def _numbers(path: Path, key: str, count: int) -> NDArray[np.float64] | None:
    """Return the numbers of the row `key: …`; None where there is no such row."""
    for line in documents.read_text(path).splitlines():
        name, _, text = line.partition(":")
        if name.strip() == key:
            try:
                values = np.array([float(word) for word in text.split()])
            except ValueError:
                values = np.empty(0)
            if values.size != count:
                raise InputError(
                    POSE_TRAJECTORY_UNREADABLE, "{key} is not {count} numbers.", path, key=key, count=count
                )
            return values
    return None
