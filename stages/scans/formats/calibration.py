"""Read calibration files: JSON, TOML, OpenCV, Kalibr and ORB-SLAM YAML, matrices as text.

One camera or a rig, whatever the names its writer used; every number is checked before it becomes a camera.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError
from stages.files import documents
from stages.scans.formats import orb_slam, trajectories
from stages.scans.scan import Camera, Pose, StereoRig

# Left and right names of one thing: OpenCV's samples, its tutorials, and our own tables.
_MATRICES = (("K1", "K2"), ("M1", "M2"), ("camera_matrix_left", "camera_matrix_right"), ("Kl", "Kr"))
_PROJECTIONS = ("projection_matrix", "P", "p")
_DISTORTIONS = (("D1", "D2"), ("dist_coeffs_left", "dist_coeffs_right"), ("Dl", "Dr"))
# What files call OpenCV's fisheye model, and the models of its ordinary one.
_FISHEYE = ("equidistant", "fisheye", "kannala_brandt", "kannala_brandt4", "kb4")
_PINHOLE = ("radtan", "radial-tangential", "plumb_bob", "rational_polynomial", "none")
# Matrices that begin with the camera's.
_CAMERA_SHAPES = ((3, 3), (4, 4), (3, 4))
# Suffixes of files that hold bare numbers.
_TEXTS = (".txt", ".csv")
_MATRIX_AND_BASELINE = 10
# No rig carried by hand or car is wider; a larger number is in millimetres.
_WIDEST_METRES = 10.0
# Pixels; beyond these, single precision cannot hold where a camera sees things.
_FOCAL_LENGTHS = (1e-3, 1e9)


def read_camera(path: Path, width: int, height: int) -> Camera:
    """Read one camera, for images of this size in pixels.

    A 3x3 (or 4x4) matrix as text; or JSON, TOML or YAML with `fx fy cx cy`, or `camera_matrix`, `K` or
    `intrinsic_matrix` (which Open3D stores column-major), and `distortion`; Kalibr's camchain of one camera;
    ORB-SLAM's settings. A stated size that differs from the images' is refused.
    """
    if path.suffix in _TEXTS:
        return matrix_camera(_text_matrix(path), (), width, height, path)
    return camera_from_table(orb_slam.as_table(documents.read_document(path)), width, height, path)


def read_depth_scale(path: Path) -> float | None:
    """Return how many units of a depth file are one metre, as a camera file says; None when it does not."""
    if path.suffix in _TEXTS:
        return None
    value = orb_slam.as_table(documents.read_document(path)).get("depth_scale")
    if value is None:
        return None
    scale = _number(value, "depth_scale", path)
    if scale <= 0:
        raise InputError(f"depth_scale is {scale:g}; it must be positive.", path)
    return scale


def read_rig(
    path: Path,
    width: int,
    height: int,
    *,
    document: dict[str, Any] | None = None,
    baseline: float | None = None,
) -> tuple[StereoRig, list[str]]:
    """Read a stereo rig for images of this size in pixels, and return it with what is odd about the file.

    Accepted forms: tables `left` and `right` with `R`, `T` or `baseline` beside them; one camera and a
    `baseline` for a rectified pair; OpenCV's `K1 D1 K2 D2 R T` (or `M1 …`), or `P1 P2` for rectified images;
    Kalibr's `cam0` and `cam1`; ROS's camera_info under `left` and `right`; ORB-SLAM's settings; a text of the
    nine numbers of a matrix and a baseline, of a rectified pair. Lengths are metres unless `unit` says `mm`,
    `cm` or `m`.

    Parameters
    ----------
    path : named in messages, and read unless `document` is given.
    document : the file's content, when several files make it up.
    baseline : metres, in place of the file's.

    Raises
    ------
    InputError
        If the file does not parse, something is missing, or a number cannot be right.
    """
    if document is None:
        document = _text_pair(path) if path.suffix in _TEXTS else documents.read_document(path)
    values = orb_slam.as_table(document)
    infos = _camera_infos(values)
    if "cam0" in values and "cam1" in values:
        left, right, right_from_left = _kalibr(values, width, height, path)
    elif infos is not None:
        left, right, right_from_left = _ros(*infos, width, height, path)
    elif "left" in values and "right" in values:
        left, right = (
            camera_from_table(_table(values, side, path), width, height, path) for side in ("left", "right")
        )
        right_from_left = _extrinsics(values, path, required=baseline is None)
    elif (keys := _present(values, _MATRICES)) is not None:
        bent = _present(values, _DISTORTIONS) or ("", "")
        left, right = (
            matrix_camera(_array(values, key, path), _coefficients(values.get(d), path), width, height, path)
            for key, d in zip(keys, bent, strict=True)
        )
        right_from_left = _extrinsics(values, path, required=baseline is None)
    elif "P1" in values and "P2" in values:
        left, right, right_from_left = _projections(values, width, height, path)
    else:
        left = right = camera_from_table(values, width, height, path)
        right_from_left = _extrinsics(values, path, required=baseline is None)

    if baseline is None:
        right_from_left, warnings = _in_metres(right_from_left, values.get("unit"), path)
    else:
        right_from_left, warnings = with_baseline(right_from_left, baseline), []
    if infos is not None:
        warnings.append(
            "the images are taken as they left the cameras, as ROS's image_raw; for image_rect give a file "
            "with P1 and P2 alone"
        )
    rectified = values.get("rectified", _looks_rectified(left, right, right_from_left))
    if not isinstance(rectified, (bool, int)):
        raise InputError(f"rectified is {rectified!r}; it must be true or false.", path)
    if right_from_left[0, 3] >= 0:
        raise InputError(
            "the second camera is not right of the first: T maps left-camera points to the right "
            "camera, so its x must be negative. Are the two cameras swapped?",
            path,
        )
    return StereoRig(left, right, right_from_left, bool(rectified)), warnings


def with_baseline(right_from_left: Pose, baseline: float) -> Pose:
    """Return the relation of two cameras, their distance set to `baseline` metres (along x if it was 0)."""
    length = float(np.linalg.norm(right_from_left[:3, 3]))
    moved: Pose = right_from_left.copy()
    moved[:3, 3] = (-baseline, 0, 0) if length == 0 else right_from_left[:3, 3] * (baseline / length)
    return moved


def checked(camera: Camera, path: Path) -> Camera:
    """Return the camera when its numbers can be right.

    Raises
    ------
    InputError
        If a number is not finite, a focal length is not positive, or the centre is far outside the image.
    """
    if not all(
        math.isfinite(value) for value in (camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion)
    ):
        raise InputError("the camera holds a value that is not finite.", path)
    if camera.fx <= 0 or camera.fy <= 0:
        raise InputError(
            f"the focal lengths are {camera.fx:g} and {camera.fy:g} px; both must be positive.", path
        )
    if not all(_FOCAL_LENGTHS[0] <= value <= _FOCAL_LENGTHS[1] for value in (camera.fx, camera.fy)):
        raise InputError(f"focal lengths of {camera.fx:g} and {camera.fy:g} px cannot be right.", path)
    width, height = camera.width, camera.height
    if not (-width <= camera.cx <= 2 * width and -height <= camera.cy <= 2 * height):
        raise InputError(
            f"the principal point ({camera.cx:g}, {camera.cy:g}) is far outside the images of "
            f"{width}×{height}; is the calibration for another size?",
            path,
        )
    return camera


def camera_from_table(values: dict[str, Any], width: int, height: int, path: Path) -> Camera:
    """Return the camera of a table, under any of the usual names."""
    chain = [key for key in values if re.fullmatch(r"cam\d+", str(key))]
    if len(chain) == 1:
        return _kalibr_camera(values, chain[0], width, height, path)
    if chain:
        raise InputError(
            f"it holds the cameras {', '.join(chain[:8])}, and the one of these images is needed: leave only "
            "that in a copy of the file.",
            path,
        )
    size = (
        values.get("width", values.get("image_width", width)),
        values.get("height", values.get("image_height", height)),
    )
    if size != (width, height):
        raise InputError(
            f"it is for images of {size[0]}×{size[1]}, but these are {width}×{height}; "
            "give the calibration of this size.",
            path,
        )
    bent = next(
        (values[key] for key in ("distortion", "distortion_coefficients", "D", "d", "dist") if key in values),
        None,
    )
    fisheye = is_fisheye(values.get("distortion_model"), path)
    distortion = _coefficients(bent, path, fisheye=fisheye)
    camera = _without_model(values, distortion, width, height, path)
    return replace(camera, fisheye=fisheye)


def _without_model(
    values: dict[str, Any], distortion: tuple[float, ...], width: int, height: int, path: Path
) -> Camera:
    if "intrinsic_matrix" in values:
        # Open3D stores it column by column.
        matrix = _array(values, "intrinsic_matrix", path)
        if matrix.shape in _CAMERA_SHAPES and matrix[2, :2].any():
            matrix = matrix.T
        return matrix_camera(matrix, distortion, width, height, path)
    for key in ("matrix", "camera_matrix", "K", "k"):
        if key in values:
            return matrix_camera(_array(values, key, path), distortion, width, height, path)
    if missing := [key for key in ("fx", "fy", "cx", "cy") if key not in values]:
        raise InputError(
            f"no camera in it: neither a matrix (`camera_matrix`, `K`) nor {', '.join(missing)}.", path
        )
    fx, fy, cx, cy = (_number(values[key], key, path) for key in ("fx", "fy", "cx", "cy"))
    return checked(Camera(width, height, fx, fy, cx, cy, distortion), path)


def _kalibr_camera(values: dict[str, Any], side: str, width: int, height: int, path: Path) -> Camera:
    """Read a camera of Kalibr's camchain: `intrinsics: [fu, fv, cu, cv]`, and its lens."""
    table = _table(values, side, path)
    if table.get("camera_model", "pinhole") != "pinhole":
        raise InputError(f"{side} is of camera_model {table['camera_model']}; pinhole is supported.", path)
    fisheye = is_fisheye(table.get("distortion_model"), path)
    if table.get("resolution", [width, height]) != [width, height]:
        raise InputError(f"{side} is for images of another size than {width}×{height}.", path)
    row = number_row(table.get("intrinsics"), "intrinsics", path)
    if len(row) != 4:
        raise InputError(f"{side}.intrinsics must be 4 numbers: fu, fv, cu, cv.", path)
    bent = _coefficients(table.get("distortion_coeffs"), path, fisheye=fisheye)
    return checked(Camera(width, height, *row, distortion=bent, fisheye=fisheye), path)


def _kalibr(values: dict[str, Any], width: int, height: int, path: Path) -> tuple[Camera, Camera, Pose]:
    """Read Kalibr's camchain of two cameras: `T_cn_cnm1` takes points of camera 0 to camera 1."""
    cameras = [_kalibr_camera(values, side, width, height, path) for side in ("cam0", "cam1")]
    if "T_cn_cnm1" not in values["cam1"] and "T_cam_imu" in values["cam1"]:
        left, right = (camera_from_body(values, side, path) for side in ("cam0", "cam1"))
        return cameras[0], cameras[1], right @ trajectories.inverted(left)
    matrix = trajectories.matrix_of(values["cam1"].get("T_cn_cnm1"), path, "cam1.T_cn_cnm1")
    return cameras[0], cameras[1], _finite_pose(matrix, "cam1.T_cn_cnm1", path)


def _camera_infos(values: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """Return the tables of two cameras as ROS states them, each with its projection, or None."""
    sides = values.get("left"), values.get("right")
    if not all(isinstance(side, dict) and _first_key(side, _PROJECTIONS) for side in sides):
        return None
    return sides[0], sides[1]  # type: ignore[return-value]


def _ros(
    left: dict[str, Any], right: dict[str, Any], width: int, height: int, path: Path
) -> tuple[Camera, Camera, Pose]:
    """Read two of ROS's camera_info: R turns a camera to be rectified, P[0,3] / P[0,0] is minus the baseline.

    A point x of the left camera is R_right^T (R_left x + t) in the right one.
    """
    cameras = [camera_from_table(side, width, height, path) for side in (left, right)]
    turns = [_rectification(side, path) for side in (left, right)]
    key = _first_key(right, _PROJECTIONS)
    projection = _array(right, key or "", path)
    if projection.shape != (3, 4) or projection[0, 0] == 0:
        raise InputError(f"{key} of the right camera is not a 3x4 projection.", path)
    right_from_left = np.eye(4)
    right_from_left[:3, :3] = turns[1].T @ turns[0]
    right_from_left[:3, 3] = turns[1].T @ (projection[0, 3] / projection[0, 0], 0, 0)
    return cameras[0], cameras[1], _finite_pose(right_from_left, "R and P", path)


def _rectification(table: dict[str, Any], path: Path) -> NDArray[np.float64]:
    key = _first_key(table, ("rectification_matrix", "R", "r"))
    turn = np.eye(3) if key is None else _array(table, key, path)
    if turn.shape != (3, 3):
        raise InputError(f"{key} must be 3x3.", path)
    return turn


def _first_key(table: dict[str, Any], names: tuple[str, ...]) -> str | None:
    return next((name for name in names if name in table), None)


def camera_from_body(values: dict[str, Any], side: str, path: Path) -> Pose:
    """Return T_cam_imu of a camera in Kalibr's camchain: takes points of the body (the IMU) to the camera.

    Raises
    ------
    InputError
        If it is not there or not rigid.
    """
    name = f"{side}.T_cam_imu"
    return _finite_pose(
        trajectories.matrix_of(_table(values, side, path).get("T_cam_imu"), path, name), name, path
    )


def _projections(values: dict[str, Any], width: int, height: int, path: Path) -> tuple[Camera, Camera, Pose]:
    """Read the projection matrices of rectified images: the baseline is -P2[0,3] / P2[0,0]."""
    left, right = (_array(values, key, path) for key in ("P1", "P2"))
    if left.shape != (3, 4) or right.shape != (3, 4):
        raise InputError("P1 and P2 must be 3x4.", path)
    if left[0, 0] == 1:
        raise InputError(
            "P1 is not filled in, as where calibration ended before rectification. The cameras' own matrices "
            "are needed beside R and T: name the file of both, or put intrinsics.yml beside extrinsics.yml.",
            path,
        )
    cameras = [matrix_camera(p[:, :3], (), width, height, path) for p in (left, right)]
    right_from_left = np.eye(4)
    right_from_left[0, 3] = right[0, 3] / cameras[1].fx
    return cameras[0], cameras[1], right_from_left


def _extrinsics(values: dict[str, Any], path: Path, *, required: bool) -> Pose:
    """Return right_from_left, in the file's unit, from R and T, or from a baseline along x."""
    if "left_from_right" in values:
        given = _array(values, "left_from_right", path)
        if given.shape != (4, 4):
            raise InputError("the relation of the cameras must be 4x4.", path)
        return trajectories.inverted(_finite_pose(given, "the relation of the cameras", path))
    matrix = np.eye(4)
    rotation = next((key for key in ("R", "rotation") if key in values), None)
    translation = next((key for key in ("T", "translation", "t") if key in values), None)
    if rotation is not None:
        turn = _array(values, rotation, path)
        if turn.size == 3:
            import cv2

            turn = np.asarray(cv2.Rodrigues(turn.reshape(3))[0], np.float64)
        if turn.shape != (3, 3):
            raise InputError(f"{rotation} must be 3x3 (or 3 numbers, a rotation vector).", path)
        matrix[:3, :3] = turn
    if translation is not None:
        shift = _array(values, translation, path)
        if shift.size != 3:
            raise InputError(f"{translation} must be 3 numbers.", path)
        matrix[:3, 3] = shift.ravel()
    elif "baseline" in values:
        matrix[0, 3] = -abs(_number(values["baseline"], "baseline", path))
    elif required:
        raise InputError(
            "how the cameras stand to each other is missing: R and T, or a baseline "
            "(or set scan.baseline=METRES).",
            path,
        )
    return _finite_pose(matrix, "R, T", path)


def _in_metres(right_from_left: Pose, unit: object, path: Path) -> tuple[Pose, list[str]]:
    """Return the extrinsics in metres; calibration boards are often measured in millimetres."""
    length = float(np.linalg.norm(right_from_left[:3, 3]))
    if length == 0:
        raise InputError("the two cameras stand at the same place (baseline 0); no depth can be had.", path)
    warnings = []
    if unit is None:
        unit = "mm" if length > _WIDEST_METRES else "m"
        if unit == "mm":
            warnings.append(
                f"the baseline of {path.name} is {length:g} without a unit, taken as millimetres; "
                "say `unit: m` if it is not"
            )
    scale = {"m": 1.0, "cm": 0.01, "mm": 0.001}.get(str(unit))
    if scale is None:
        raise InputError(f"unit is {unit!r}; it must be m, cm or mm.", path)
    metric = right_from_left.copy()
    metric[:3, 3] *= scale
    return metric, warnings


def _looks_rectified(left: Camera, right: Camera, right_from_left: Pose) -> bool:
    """Say whether rows correspond: no rotation, no distortion, one focal length and row centre."""
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


def _finite_pose(matrix: NDArray[np.float64], name: str, path: Path) -> Pose:
    pose = trajectories.rigid(matrix, path, name)
    if pose is None:
        raise InputError(f"{name} is not finite.", path)
    return pose


def matrix_camera(
    matrix: NDArray[np.float64], distortion: tuple[float, ...], width: int, height: int, path: Path
) -> Camera:
    """Return the checked camera of a 3x3 matrix (or one that begins with it)."""
    if matrix.shape not in _CAMERA_SHAPES:
        raise InputError(f"a camera matrix must be 3x3, not {matrix.shape}.", path)
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return checked(Camera(width, height, fx, fy, cx, cy, distortion), path)


def _text_numbers(path: Path) -> list[float]:
    try:
        return [float(word) for word in documents.read_text(path).replace(",", " ").split()]
    except ValueError as error:
        raise InputError("a camera matrix of 3 rows of 3 numbers is expected.", path) from error


def _text_pair(path: Path) -> dict[str, Any]:
    """Return the table of a rectified pair written as the nine numbers of its matrix and the baseline."""
    numbers = _text_numbers(path)
    if len(numbers) == _MATRIX_AND_BASELINE:
        return {"K": numbers[:-1], "baseline": numbers[-1]}
    return {"K": _text_matrix(path).tolist()}


def _text_matrix(path: Path) -> NDArray[np.float64]:
    """Return a matrix written as rows of numbers, or the four numbers fx fy cx cy as one."""
    values = _text_numbers(path)
    if len(values) == _MATRIX_AND_BASELINE:
        values.pop()
    if len(values) == 4:
        fx, fy, cx, cy = values
        values = [fx, 0, cx, 0, fy, cy, 0, 0, 1]
    if len(values) not in (9, 16):
        raise InputError(
            f"a camera matrix of 3 rows of 3 numbers is expected, not {len(values)} numbers.", path
        )
    side = math.isqrt(len(values))
    return np.array(values).reshape(side, side)


def _array(values: dict[str, Any], key: str, path: Path) -> NDArray[np.float64]:
    """Return a matrix given as nested rows, as a flat list, or as OpenCV's rows, cols and data."""
    value = values[key]
    shape: tuple[int, ...] | None = None
    try:
        if isinstance(value, dict):
            shape = int(value["rows"]), int(value["cols"])
            value = value["data"]
        array = np.asarray(value, np.float64)
        shape = shape or {9: (3, 3), 12: (3, 4), 16: (4, 4)}.get(array.size, array.shape)
        return array.reshape(shape)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{key} is not a matrix of numbers.", path) from error


def number_row(value: object, name: str, path: Path) -> tuple[float, ...]:
    """Return a list of numbers of any shape as one row; empty for None."""
    if value is None:
        return ()
    return tuple(float(number) for number in _array({name: value}, name, path).ravel())


def is_fisheye(model: object, path: Path) -> bool:
    """Say whether the name of a distortion model is the fisheye one's; None is the ordinary one.

    Raises
    ------
    InputError
        If it is neither.
    """
    if model is None or model in _PINHOLE:
        return False
    if model in _FISHEYE:
        return True
    raise InputError(
        f"the lens model {str(model)[:40]} is not supported; radial-tangential and equidistant are. "
        "Undistort the images first.",
        path,
    )


def _coefficients(value: object, path: Path, *, fisheye: bool = False) -> tuple[float, ...]:
    """Return OpenCV's distortion coefficients (0, 4, 5, 8, 12 or 14 of them), empty when all are 0.

    A fisheye's are four: it bends lines even when they are 0.
    """
    row = number_row(value, "distortion", path)
    if fisheye:
        if len(row) != 4:
            raise InputError(f"a fisheye camera has 4 distortion coefficients, not {len(row)}.", path)
        return row
    if len(row) not in (0, 4, 5, 8, 12, 14):
        raise InputError(f"distortion has {len(row)} coefficients; OpenCV knows 4, 5, 8, 12 or 14.", path)
    return row if any(row) else ()


def _number(value: object, key: str, path: Path) -> float:
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{key} is {str(value)[:40]!r}; a number is expected.", path)
    return number


def _table(values: dict[str, Any], key: str, path: Path) -> dict[str, Any]:
    table = values[key]
    if not isinstance(table, dict):
        raise InputError(f"{key} must be a table of names and values.", path)
    return table


def _present(values: dict[str, Any], names: tuple[tuple[str, str], ...]) -> tuple[str, str] | None:
    return next((keys for keys in names if keys[0] in values and keys[1] in values), None)
