"""Poses of KITTI raw recordings from the car's GPS/IMU unit.

    oxts/data/0000000000.txt      latitude, longitude (degrees), altitude (m), roll, pitch, yaw (rad), …
    calib_imu_to_velo.txt         R, T: from the unit to the laser scanner
    calib_velo_to_cam.txt         R, T: from the scanner to the unrectified camera 0
    calib_cam_to_cam.txt          R_rect_00: rectifies camera 0

There is one oxts file per frame. World axes: x east, y north, z up. The origin is the first position of
the unit.

Reference: Geiger, Lenz, Stiller, Urtasun, Vision meets Robotics: The KITTI Dataset, IJRR 2013, and the
development kit of the data set (Mercator projection at the latitude of the first file).
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
from scanloom.stages.scans.image_folders.image_files import extract_numbers, find_first_existing
from scanloom.stages.scans.model.poses import check_rigid_pose, invert_pose
from scanloom.stages.scans.model.scan import Pose

_DATA_FOLDER = "oxts/data"
# Equatorial radius, metres.
_EARTH_RADIUS_M = 6378137.0
# Degrees; the Mercator projection diverges at the poles.
_MAX_LATITUDE_DEG = 85.0
_VALUE_COUNT = 6


def read_oxts_poses(
    folder: Path, names: Sequence[str], cameras: Path
) -> tuple[list[Pose | None] | None, str]:
    """Read world_from_cam0 (rectified camera 0) of each frame.

    Parameters
    ----------
    folder : drive folder; its calibration files are in it or, shared by all drives of a day, in its parent.
    names : frame names, with the same numbers as the oxts files.
    cameras : calib_cam_to_cam.txt.

    Returns
    -------
    poses : poses (4, 4) in metres, None for a frame without an oxts file; None instead of the list if a
        file is missing.
    reason : the missing file, or "".

    Raises
    ------
    InputError
        If a file is damaged.
    """
    data = folder / _DATA_FOLDER
    if not data.is_dir():
        return None, f"{_DATA_FOLDER}/ is missing"
    found = {}
    for name in ("calib_imu_to_velo.txt", "calib_velo_to_cam.txt"):
        path = find_first_existing(folder, name, f"../{name}")
        if path is None:
            return None, f"{_DATA_FOLDER}/ exists, but {name}, which relates it to the cameras, is missing"
        found[name] = _read_transform(path)
    rectification = _read_numbers(cameras, "R_rect_00", 9)
    if rectification is None:
        return None, f"{_DATA_FOLDER}/ exists, but {cameras.name} has no R_rect_00"
    rectified = _to_rigid_pose(rectification.reshape(3, 3), np.zeros(3), cameras)
    cam0_from_unit = rectified @ found["calib_velo_to_cam.txt"] @ found["calib_imu_to_velo.txt"]
    files = sorted(data.glob("*.txt"), key=lambda path: (extract_numbers(path.stem), path.name))
    world_from_unit = _read_world_from_unit(files)
    unit_from_cam0 = invert_pose(cam0_from_unit)
    return [
        None if (pose := world_from_unit.get(extract_numbers(name))) is None else pose @ unit_from_cam0
        for name in names
    ], ""


def _read_world_from_unit(files: Sequence[Path]) -> dict[tuple[int, ...], Pose]:
    """Read world_from_unit of each file, by the numbers in its name."""
    from scipy.spatial.transform import Rotation

    poses: dict[tuple[int, ...], Pose] = {}
    scale, origin = 1.0, np.zeros(3)
    for file in files:
        latitude, longitude, altitude, roll, pitch, yaw = _read_measurement(file)
        if not poses:
            scale = math.cos(math.radians(latitude))
        # The Mercator projection stretches lengths by 1 / cos(latitude); `scale` undoes this at the latitude
        # of the first file.
        east = math.radians(longitude)
        north = math.log(math.tan(math.radians(90 + latitude) / 2))
        position = np.array([scale * _EARTH_RADIUS_M * east, scale * _EARTH_RADIUS_M * north, altitude])
        if not poses:
            origin = position
        pose = np.eye(4)
        # Extrinsic rotations: roll about x, then pitch about y, then yaw about z.
        pose[:3, :3] = Rotation.from_euler("xyz", (roll, pitch, yaw)).as_matrix()
        pose[:3, 3] = position - origin
        poses[extract_numbers(file.stem)] = pose
    return poses


def _read_measurement(file: Path) -> list[float]:
    try:
        values = [float(word) for word in documents.read_text(file).split()[:_VALUE_COUNT]]
    except ValueError:
        values = []
    if len(values) != _VALUE_COUNT or not all(math.isfinite(value) for value in values):
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE,
            "the file must begin with six numbers: latitude, longitude, altitude, roll, pitch, yaw.",
            file,
        )
    if abs(values[0]) > _MAX_LATITUDE_DEG:
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE,
            "the latitude of {values:g}° is invalid; ±85° are supported.",
            file,
            values=values[0],
        )
    return values


def _read_transform(path: Path) -> Pose:
    """Read the rigid transform R, T of a calibration file."""
    rotation, translation = _read_numbers(path, "R", 9), _read_numbers(path, "T", 3)
    if rotation is None or translation is None:
        raise InputError(
            POSE_TRAJECTORY_UNREADABLE, "rows `R: …` with 9 numbers and `T: …` with 3 are required.", path
        )
    return _to_rigid_pose(rotation.reshape(3, 3), translation, path)


def _to_rigid_pose(rotation: NDArray[np.float64], translation: NDArray[np.float64], path: Path) -> Pose:
    pose = check_rigid_pose(np.column_stack([rotation, translation]), path)
    if pose is None:
        raise InputError(POSE_TRAJECTORY_UNREADABLE, "the transform contains NaN or infinity.", path)
    return pose


def _read_numbers(path: Path, key: str, count: int) -> NDArray[np.float64] | None:
    """Return the numbers of the row `key: …`, or None."""
    for line in documents.read_text(path).splitlines():
        name, _, text = line.partition(":")
        if name.strip() == key:
            try:
                values = np.array([float(word) for word in text.split()])
            except ValueError:
                values = np.empty(0)
            if values.size != count:
                raise InputError(
                    POSE_TRAJECTORY_UNREADABLE, "{key} must be {count} numbers.", path, key=key, count=count
                )
            return values
    return None
