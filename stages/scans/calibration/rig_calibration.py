"""Reader for stereo calibrations: JSON, TOML, YAML (OpenCV, Kalibr, ROS, ORB-SLAM) and `K.txt`.

Key names and length units of various programs are converted; extrinsics are in metres.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.calibration import orb_slam, zed
from scanloom.stages.scans.calibration.camera_files import (
    MATRIX_AND_BASELINE_SIZE,
    create_camera_from_matrix,
    is_fisheye,
    parse_camera_table,
    parse_distortion,
    parse_kalibr_camera,
    read_bare_matrix,
    read_bare_numbers,
    read_calibration_document,
)
from scanloom.stages.scans.calibration.contradictions import check_extrinsics, check_rig, warn_not_rectified
from scanloom.stages.scans.calibration.image_size import get_stated_size, scale_to_images
from scanloom.stages.scans.calibration.lens_names import find_pair_distortions
from scanloom.stages.scans.calibration.pair_names import find_matrix_pair
from scanloom.stages.scans.calibration.table_values import get_matrix, get_table, to_finite_number
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_ASSUMED,
    CAMERA_CALIBRATION_INVALID,
    CAMERA_PAIR_UNCALIBRATED,
)
from scanloom.stages.scans.model.poses import check_rigid_pose, invert_pose, parse_pose_matrix
from scanloom.stages.scans.model.scan import Camera, Pose, StereoRig

# Key names of the rotation and translation between the cameras.
_ROTATION_KEY = re.compile("R|rot(ation)?(_?(mat(rix)?|vec(tor)?))?", re.IGNORECASE)
_TRANSLATION_KEY = re.compile("T|tr(a?ns?|anslation)(_?vec(tor)?)?", re.IGNORECASE)
_PROJECTION_KEYS = ("projection_matrix", "P", "p")
_FISHEYE = "fisheye"
# Maximum plausible baseline in metres; a larger number without a unit is in millimetres.
_MAX_BASELINE_M = 10.0
# Metres; few rigs are wider. Calibration boards measured in centimetres or squares give such numbers.
_WIDE_BASELINE_M = 1.5


def read_rig(
    path: Path,
    width: int,
    height: int,
    *,
    document: dict[str, Any] | None = None,
    baseline: float | None = None,
) -> StereoRig:
    """Read a stereo rig for a given image size in pixels.

    Supported forms:

    - tables `left` and `right`, with `R`, `T` or `baseline`;
    - one camera and a `baseline`, for a rectified pair;
    - OpenCV's `K1 D1 K2 D2 R T` as YAML, XML or .npz, with any key names that distinguish the sides (`mtxL`,
      `cam_matrix_right` …);
    - `P1 P2` of rectified images;
    - Kalibr's `cam0` and `cam1`, ROS's camera_info under `left` and `right`, ORB-SLAM settings, ZED files;
    - text with the nine numbers of a matrix and a baseline, for a rectified pair.

    Lengths are metres unless `unit` is `mm`, `cm` or `m`. Without a unit, a baseline above 10 is read as
    millimetres, with a warning.

    Parameters
    ----------
    path : calibration file; only used in messages if `document` is given.
    document : content, if several files make up the calibration.
    baseline : metres, overrides the baseline of the file.

    Raises
    ------
    InputError
        If the file does not parse, something is missing, or a number is implausible.
    """
    if document is None:
        document = read_calibration_document(path)
    if document is None:
        document = _read_bare_pair(path)
    values = orb_slam.to_calibration_table(document)
    if zed.is_zed_calibration(values):
        values = zed.to_rig_table(values, width, height, path)
    infos = _find_camera_infos(values)
    if "cam0" in values and "cam1" in values:
        left, right, right_from_left = _read_kalibr_rig(values, width, height, path)
    elif infos is not None:
        left, right, right_from_left = _read_ros_rig(*infos, width, height, path)
    elif "left" in values and "right" in values:
        left, right = (
            parse_camera_table(get_table(values, side, path), width, height, path)
            for side in ("left", "right")
        )
        right_from_left = _read_extrinsics(values, path, required=baseline is None)
    elif (keys := find_matrix_pair(values)) is not None:
        lenses = find_pair_distortions(values, path)
        size = get_stated_size(values, width, height, path)
        fisheye = _has_fisheye_lenses(values, path)
        cameras = [
            replace(
                create_camera_from_matrix(
                    get_matrix(values, key, path), parse_distortion(lens, path, fisheye=fisheye), *size, path
                ),
                fisheye=fisheye,
            )
            for key, lens in zip(keys, lenses, strict=True)
        ]
        left, right = (scale_to_images(camera, width, height, path) for camera in cameras)
        right_from_left = _read_extrinsics(values, path, required=baseline is None)
    elif "P1" in values and "P2" in values:
        left, right, right_from_left = _read_projections(values, width, height, path)
    else:
        left = right = parse_camera_table(values, width, height, path)
        right_from_left = _read_extrinsics(values, path, required=baseline is None)

    length = float(np.linalg.norm(right_from_left[:3, 3]))
    if baseline is None:
        right_from_left = _convert_to_metres(right_from_left, values.get("unit"), path)
    else:
        right_from_left = set_baseline(right_from_left, baseline)
    if infos is not None:
        emit(
            CAMERA_CALIBRATION_ASSUMED.warning(
                "the images are assumed to be unrectified (ROS's image_raw)",
                path,
                remedy="for image_rect, give a file that contains only P1 and P2",
            )
        )
    looks_rectified = _looks_rectified(left, right, right_from_left)
    rectified = values.get("rectified", looks_rectified)
    if not isinstance(rectified, (bool, int)):
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "rectified is {rectified!r}; it must be true or false.",
            path,
            rectified=rectified,
        )
    if right_from_left[0, 3] >= 0:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            (
                "the second camera is not right of the first: T maps left-camera points to "
                "the right camera, so its x must be negative. Are the two cameras swapped?"
            ),
            path,
        )
    rig = StereoRig(left, right, right_from_left, bool(rectified))
    if rectified and not looks_rectified:
        warn_not_rectified(rig, path)
    if baseline is None:
        check_rig(document, values, rig, length, path)
    return rig


def has_camera_pair(values: dict[str, Any]) -> bool:
    """Return True if a table has two camera matrices and a translation."""
    return find_matrix_pair(values) is not None and _find_key(values, _TRANSLATION_KEY) is not None


def set_baseline(right_from_left: Pose, baseline: float) -> Pose:
    """Set the length of the baseline, in metres; along x if it was 0."""
    length = float(np.linalg.norm(right_from_left[:3, 3]))
    moved: Pose = right_from_left.copy()
    moved[:3, 3] = (-baseline, 0, 0) if length == 0 else right_from_left[:3, 3] * (baseline / length)
    return moved


def _read_kalibr_rig(
    values: dict[str, Any], width: int, height: int, path: Path
) -> tuple[Camera, Camera, Pose]:
    """Read a Kalibr camchain of two cameras.

    `T_cn_cnm1` maps points from camera 0 to camera 1. Without it, the extrinsics are computed from
    `T_cam_imu`.
    """
    cameras = [parse_kalibr_camera(values, side, width, height, path) for side in ("cam0", "cam1")]
    if "T_cn_cnm1" not in values["cam1"] and "T_cam_imu" in values["cam1"]:
        left, right = (read_camera_from_body(values, side, path) for side in ("cam0", "cam1"))
        return cameras[0], cameras[1], right @ invert_pose(left)
    matrix = parse_pose_matrix(values["cam1"].get("T_cn_cnm1"), path, "cam1.T_cn_cnm1")
    right_from_left = _require_finite_pose(matrix, "cam1.T_cn_cnm1", path)
    if all("T_cam_imu" in values[side] for side in ("cam0", "cam1")):
        left, right = (read_camera_from_body(values, side, path) for side in ("cam0", "cam1"))
        by_body = right @ invert_pose(left)
        check_extrinsics(right_from_left, by_body, "cam1.T_cn_cnm1 and T_cam_imu", path)
    return cameras[0], cameras[1], right_from_left


def _find_camera_infos(values: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """Return the left and right camera_info tables of ROS.

    Returns None if one lacks a projection.
    """
    sides = values.get("left"), values.get("right")
    if not all(isinstance(side, dict) and _find_first_key(side, _PROJECTION_KEYS) for side in sides):
        return None
    return sides[0], sides[1]  # type: ignore[return-value]


def _read_ros_rig(
    left: dict[str, Any], right: dict[str, Any], width: int, height: int, path: Path
) -> tuple[Camera, Camera, Pose]:
    """Read a stereo pair of ROS camera_info tables.

    R rotates a camera to its rectified axes, and P[0,3] / P[0,0] of the right camera is the negative
    baseline. A point x in left camera coordinates is R_rightᵀ (R_left x + t) in right camera coordinates.
    """
    cameras = [parse_camera_table(side, width, height, path) for side in (left, right)]
    turns = [_read_rectification(side, path) for side in (left, right)]
    key = _find_first_key(right, _PROJECTION_KEYS)
    projection = get_matrix(right, key or "", path)
    if projection.shape != (3, 4) or projection[0, 0] == 0:
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "{key} of the right camera is not a 3x4 projection.", path, key=key
        )
    right_from_left = np.eye(4)
    right_from_left[:3, :3] = turns[1].T @ turns[0]
    right_from_left[:3, 3] = turns[1].T @ (projection[0, 3] / projection[0, 0], 0, 0)
    return cameras[0], cameras[1], _require_finite_pose(right_from_left, "R and P", path)


def _read_rectification(table: dict[str, Any], path: Path) -> NDArray[np.float64]:
    key = _find_first_key(table, ("rectification_matrix", "R", "r"))
    turn = np.eye(3) if key is None else get_matrix(table, key, path)
    if turn.shape != (3, 3):
        raise InputError(CAMERA_CALIBRATION_INVALID, "{key} must be 3x3.", path, key=key)
    return turn


def _find_first_key(table: dict[str, Any], names: tuple[str, ...]) -> str | None:
    return next((name for name in names if name in table), None)


def _has_fisheye_lenses(values: dict[str, Any], path: Path) -> bool:
    """Return True if a stereo calibration has fisheye lenses.

    The distortion model decides, or the file name if there is no model.
    """
    model = values.get("distortion_model")
    if model is None and _FISHEYE in path.stem.lower():
        emit(
            CAMERA_CALIBRATION_ASSUMED.warning(
                "its name contains fisheye, so OpenCV's fisheye model is assumed", path
            )
        )
        return True
    return is_fisheye(model, path)


def _find_key(values: dict[str, Any], names: re.Pattern[str]) -> str | None:
    return next((name for name in values if names.fullmatch(str(name))), None)


def read_camera_from_body(values: dict[str, Any], side: str, path: Path) -> Pose:
    """Read T_cam_imu of a Kalibr camchain: maps points from body (IMU) to camera coordinates.

    Raises
    ------
    InputError
        If the matrix is missing or not rigid.
    """
    name = f"{side}.T_cam_imu"
    return _require_finite_pose(
        parse_pose_matrix(get_table(values, side, path).get("T_cam_imu"), path, name), name, path
    )


def _read_projections(
    values: dict[str, Any], width: int, height: int, path: Path
) -> tuple[Camera, Camera, Pose]:
    """Read the projection matrices of a rectified pair; the baseline is -P2[0,3] / P2[0,0]."""
    left, right = (get_matrix(values, key, path) for key in ("P1", "P2"))
    if left.shape != (3, 4) or right.shape != (3, 4):
        raise InputError(CAMERA_CALIBRATION_INVALID, "P1 and P2 must be 3x4.", path)
    if left[0, 0] == 1:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            (
                "P1 is not filled in: the calibration ended before rectification. Give a file with "
                "the camera matrices, R and T, or put intrinsics.yml next to extrinsics.yml."
            ),
            path,
        )
    size = get_stated_size(values, width, height, path)
    cameras = [
        scale_to_images(create_camera_from_matrix(p[:, :3], (), *size, path), width, height, path)
        for p in (left, right)
    ]
    right_from_left = np.eye(4)
    right_from_left[0, 3] = right[0, 3] / right[0, 0]
    return cameras[0], cameras[1], right_from_left


def _read_extrinsics(values: dict[str, Any], path: Path, *, required: bool) -> Pose:
    """Read right_from_left (4, 4) in the unit of the file.

    From R and T, from `left_from_right`, or from a baseline along x.
    """
    if "left_from_right" in values:
        given = get_matrix(values, "left_from_right", path)
        if given.shape != (4, 4):
            raise InputError(CAMERA_CALIBRATION_INVALID, "the extrinsics of the cameras must be 4x4.", path)
        return invert_pose(_require_finite_pose(given, "the extrinsics of the cameras", path))
    matrix = np.eye(4)
    rotation = _find_key(values, _ROTATION_KEY)
    translation = _find_key(values, _TRANSLATION_KEY)
    if rotation is not None:
        turn = get_matrix(values, rotation, path)
        if turn.size == 3:
            import cv2

            turn = np.asarray(cv2.Rodrigues(turn.reshape(3))[0], np.float64)
        if turn.shape != (3, 3):
            raise InputError(
                CAMERA_CALIBRATION_INVALID,
                "{rotation} must be 3x3 (or 3 numbers, a rotation vector).",
                path,
                rotation=rotation,
            )
        matrix[:3, :3] = turn
    if translation is not None:
        shift = get_matrix(values, translation, path)
        if shift.size != 3:
            raise InputError(
                CAMERA_CALIBRATION_INVALID, "{translation} must be 3 numbers.", path, translation=translation
            )
        matrix[:3, 3] = shift.ravel()
    elif "baseline" in values:
        matrix[0, 3] = -abs(to_finite_number(values["baseline"], "baseline", path))
    elif required:
        raise InputError(
            CAMERA_PAIR_UNCALIBRATED,
            ("the extrinsics are missing: R and T, or a baseline. Add them, or set scan.baseline=METRES."),
            path,
        )
    return _require_finite_pose(matrix, "R, T", path)


def _convert_to_metres(right_from_left: Pose, unit: object, path: Path) -> Pose:
    """Convert extrinsics to metres.

    A missing unit is inferred from the length, because calibration boards are often measured in millimetres.
    """
    length = float(np.linalg.norm(right_from_left[:3, 3]))
    if length == 0:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "the baseline is 0, so no depth can be computed.",
            path,
        )
    if unit is None:
        unit = "mm" if length > _MAX_BASELINE_M else "m"
        if unit == "mm":
            emit(
                CAMERA_CALIBRATION_ASSUMED.warning(
                    "the baseline {length:g} has no unit and is read as millimetres",
                    path,
                    remedy="if it is not in millimetres (in centimetres it would be {by_centimetres:g} m), "
                    "set scan.baseline=METRES",
                    length=length,
                    by_centimetres=length / 100,
                )
            )
        elif length > _WIDE_BASELINE_M:
            emit(
                CAMERA_CALIBRATION_ASSUMED.warning(
                    "the baseline {length:g} has no unit and is read as metres, which is unusually wide",
                    path,
                    remedy="if the board was measured in centimetres or squares, set scan.baseline=METRES",
                    length=length,
                )
            )
    scale = {"m": 1.0, "cm": 0.01, "mm": 0.001}.get(str(unit))
    if scale is None:
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "unit is {unit!r}; it must be m, cm or mm.", path, unit=unit
        )
    metric: Pose = right_from_left.copy()
    metric[:3, 3] *= scale
    return metric


def _looks_rectified(left: Camera, right: Camera, right_from_left: Pose) -> bool:
    """Return True if the cameras are parallel, undistorted, and have equal intrinsics.

    cx may differ, because it does not affect the correspondence of rows.
    """
    shift = right_from_left[:3, 3]
    return (
        np.allclose(right_from_left[:3, :3], np.eye(3), atol=1e-6)
        and not any(left.distortion + right.distortion)
        and not (left.fisheye or right.fisheye)
        and abs(shift[1]) + abs(shift[2]) < 1e-4 * abs(shift[0])
        and abs(left.fx - right.fx) < 1e-3
        and abs(left.fy - right.fy) < 1e-3
        and abs(left.cy - right.cy) < 1e-3
    )


def _require_finite_pose(matrix: NDArray[np.float64], name: str, path: Path) -> Pose:
    pose = check_rigid_pose(matrix, path, name)
    if pose is None:
        raise InputError(CAMERA_CALIBRATION_INVALID, "{name} is not finite.", path, name=name)
    return pose


def _read_bare_pair(path: Path) -> dict[str, Any]:
    """Read a rectified pair as a table.

    The file has nine matrix elements and a baseline, or only a matrix.
    """
    numbers = read_bare_numbers(path)
    if len(numbers) == MATRIX_AND_BASELINE_SIZE:
        return {"K": numbers[:-1], "baseline": numbers[-1]}
    return {"K": read_bare_matrix(path).tolist()}
