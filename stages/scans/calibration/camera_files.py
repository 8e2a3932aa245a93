"""Read cameras of calibration files: JSON, TOML, OpenCV, Kalibr and ORB-SLAM YAML, matrices as text.

Whatever the names its writer used; every number is checked before it becomes a camera.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.files.images import read_array
from scanloom.stages.files.row_numbers import numbers_on
from scanloom.stages.scans.calibration import (
    azure_kinect,
    named_arrays,
    named_text,
    orb_slam,
    realsense,
    ros_text,
    zed,
)
from scanloom.stages.scans.calibration.contradictions import check_camera
from scanloom.stages.scans.calibration.image_size import for_images, stated_size, with_rows_first
from scanloom.stages.scans.calibration.lens_names import distortion_in
from scanloom.stages.scans.calibration.table_values import (
    MATRICES,
    matrix_in,
    number_of,
    number_row,
    table_in,
)
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_ASSUMED,
    CAMERA_CALIBRATION_INVALID,
    CAMERA_CALIBRATION_MISMATCH,
    CAMERA_LENS_UNKNOWN,
)
from scanloom.stages.scans.model.scan import Camera

# What files call OpenCV's fisheye model, and the models of its ordinary one.
_FISHEYE = ("equidistant", "fisheye", "kannala_brandt", "kannala_brandt4", "kb4")
_PINHOLE = ("radtan", "radial-tangential", "plumb_bob", "rational_polynomial", "none")
# Matrices that begin with the camera's.
_CAMERA_SHAPES = ((3, 3), (4, 4), (3, 4))
# Suffixes of files that hold bare numbers, or lines of names and numbers; NumPy's of one array, of more.
ARRAY, ARCHIVE = ".npy", ".npz"
TEXTS = (".txt", ".csv", ".ini", ".conf", ARRAY)
MATRIX_AND_BASELINE = 10
_THREE_BY_FOUR, _MOST_NUMBERS = 12, 16
# Of a depth map, in a metre.
_LEAST_UNITS, _MILLIMETRES = 0.5, 1000.0
# Of the cameras of a device; depth maps are brought to the one of colour far more often than the other way.
_OF_COLOR = re.compile("rgb|colou?r", re.IGNORECASE)
# Tables that programs put a camera's numbers into, beside its lens.
_INNER = ("intrinsic", "intrinsics")
# Pixels; beyond these, single precision cannot hold where a camera sees things.
_FOCAL_LENGTHS = (1e-3, 1e9)
# The rational model's terms, which cancel each other, are some hundreds.
_LARGEST_DISTORTION = 1e6


def read_camera(path: Path, width: int, height: int) -> Camera:
    """Read one camera, for images of this size in pixels.

    A 3x3 (or 4x4) matrix as text or .npy, or text of names and numbers; or JSON, TOML, YAML or .npz with `fx
    fy cx cy`, or `camera_matrix`, `K` or `intrinsic_matrix` (as Open3D, column-major), and `distortion`;
    Kalibr's camchain of one camera; ORB-SLAM's settings, RealSense's and Azure Kinect's. Of several the one
    for this size is taken, or that of colour; a camera for another size of the same shape is scaled. Both
    give a warning.
    """
    document = document_of(path)
    if document is None:
        return for_images(matrix_camera(text_matrix(path), (), width, height, path), width, height, path)
    return camera_from_table(orb_slam.as_table(document), width, height, path)


def document_of(path: Path) -> dict[str, Any] | None:
    """Return what a calibration file states under names; None for one of bare numbers."""
    if path.suffix == ARCHIVE:
        return named_arrays.tables(path)
    if path.suffix not in TEXTS:
        return documents.read_document(path)
    if path.suffix == ARRAY:
        return None
    text = documents.read_text(path)
    return zed.tables(text) or ros_text.tables(text) or named_text.tables(text)


def read_depth_scale(path: Path) -> float | None:
    """Return how many units of a depth file are one metre, as a camera file says; None when it does not."""
    document = document_of(path)
    if document is None:
        return None
    values = orb_slam.as_table(document)
    tables = [values, *(one for one in values.values() if isinstance(one, dict))]
    value = next((one["depth_scale"] for one in tables if one.get("depth_scale") is not None), None)
    if value is None:
        return None
    scale = number_of(value, "depth_scale", path)
    if scale <= 0:
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "depth_scale is {scale:g}; it must be positive.", path, scale=scale
        )
    if "cam_K" in values:
        # BOP's data sets say how many millimetres a unit is.
        return _MILLIMETRES / scale
    # No unit is longer than a metre: RealSense's library says how many metres a unit is.
    return 1 / scale if scale < _LEAST_UNITS else scale


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
        raise InputError(CAMERA_CALIBRATION_INVALID, "the camera holds a value that is not finite.", path)
    if camera.fx <= 0 or camera.fy <= 0:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "the focal lengths are {fx:g} and {fy:g} px; both must be positive.",
            path,
            fx=camera.fx,
            fy=camera.fy,
        )
    if not all(_FOCAL_LENGTHS[0] <= value <= _FOCAL_LENGTHS[1] for value in (camera.fx, camera.fy)):
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "focal lengths of {fx:g} and {fy:g} px cannot be right.",
            path,
            fx=camera.fx,
            fy=camera.fy,
        )
    if max(map(abs, camera.distortion), default=0.0) > _LARGEST_DISTORTION:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "a distortion coefficient of {distortion:g} cannot be right.",
            path,
            distortion=max(camera.distortion, key=abs),
        )
    width, height = camera.width, camera.height
    if not (-width <= camera.cx <= 2 * width and -height <= camera.cy <= 2 * height):
        raise InputError(
            CAMERA_CALIBRATION_MISMATCH,
            (
                "the principal point ({cx:g}, {cy:g}) is far outside the images of "
                "{width}×{height}; is the calibration for another size?"
            ),
            path,
            cx=camera.cx,
            cy=camera.cy,
            width=width,
            height=height,
        )
    return camera


def camera_from_table(values: dict[str, Any], width: int, height: int, path: Path) -> Camera:
    """Return the camera of a table, under any of the usual names, for images of this size in pixels.

    Raises
    ------
    InputError
        If something is missing, a number cannot be right, or the table is for images of another shape.
    """
    if azure_kinect.is_one(values):
        values = azure_kinect.as_table(values, width, height, path)
    if zed.is_one(values):
        values = zed.as_table(values, width, height, path)
    chain = [key for key in values if re.fullmatch(r"cam\d+", str(key))]
    if len(chain) == 1:
        return kalibr_camera(values, chain[0], width, height, path)
    if chain:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            (
                "it holds the cameras {chain}, and the one of these images is needed: leave "
                "only that in a copy of the file."
            ),
            path,
            chain=", ".join(chain[:8]),
        )
    values = realsense.as_table(_of_one_camera(values, width, height, path))
    size = stated_size(values, width, height, path)
    fisheye = is_fisheye(values.get("distortion_model"), path)
    distortion = coefficients(distortion_in(values, path, fisheye=fisheye), path, fisheye=fisheye)
    camera = with_rows_first(_without_model(values, distortion, *size, path), width, height)
    check_camera(values, camera, path)
    return for_images(replace(camera, fisheye=fisheye), width, height, path)


def _of_one_camera(values: dict[str, Any], width: int, height: int, path: Path) -> dict[str, Any]:
    """Return a camera's table: the one given, or one in it, for such images or, of several, of colour."""
    if is_of_adjust(values):
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "it is what `adjust` found, which scan.adjusted takes; a calibration is expected.",
            path,
        )
    if _is_camera(values):
        return values
    tables = {name: _with_inner(one) for name, one in values.items() if isinstance(one, dict)}
    inner = {name: one for name, one in tables.items() if _is_camera(one)}
    if len(inner) == 1 and next(iter(inner)) in _INNER:
        return _with_inner(values)
    if len(inner) < 2:
        return next(iter(inner.values()), values)
    of_size = [
        name for name, one in inner.items() if stated_size(one, width, height, path) == (width, height)
    ]
    fitting = of_size or list(inner)
    chosen = [name for name in fitting if _OF_COLOR.search(name)] if len(fitting) > 1 else fitting
    if len(chosen) != 1:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            (
                "it holds the cameras {inner}, and the one of these images is needed: leave "
                "only that in a copy of the file."
            ),
            path,
            inner=", ".join(list(inner)[:8]),
        )
    emit(
        CAMERA_CALIBRATION_ASSUMED.warning(
            "it holds the cameras {names}: {chosen} is taken",
            path,
            names=", ".join(list(inner)[:8]),
            chosen=chosen[0],
        )
    )
    return inner[chosen[0]]


def is_of_adjust(values: dict[str, Any]) -> bool:
    """Say whether a table is the cameras.json of `adjust`."""
    return isinstance(values.get("accepted"), bool)


def _with_inner(values: dict[str, Any]) -> dict[str, Any]:
    """Return a table with the numbers of its `intrinsic` as its own."""
    inner = next((values[name] for name in _INNER if isinstance(values.get(name), dict)), None)
    return values if inner is None or not _is_camera(inner) else values | inner


def _is_camera(values: dict[str, Any]) -> bool:
    return any(key in values for key in MATRICES) or {"fx", "fy"} <= values.keys()


def _without_model(
    values: dict[str, Any], distortion: tuple[float, ...], width: int, height: int, path: Path
) -> Camera:
    if "intrinsic_matrix" in values:
        # Open3D stores it column by column.
        matrix = matrix_in(values, "intrinsic_matrix", path)
        if matrix.shape in _CAMERA_SHAPES and matrix[2, :2].any():
            matrix = matrix.T
        return matrix_camera(matrix, distortion, width, height, path)
    for key in MATRICES:
        if key in values:
            return matrix_camera(matrix_in(values, key, path), distortion, width, height, path)
    if missing := [key for key in ("fx", "fy", "cx", "cy") if key not in values]:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "no camera in it: neither a matrix (`camera_matrix`, `K`) nor {missing}.",
            path,
            missing=", ".join(missing),
        )
    fx, fy, cx, cy = (number_of(values[key], key, path) for key in ("fx", "fy", "cx", "cy"))
    return checked(Camera(width, height, fx, fy, cx, cy, distortion), path)


def kalibr_camera(values: dict[str, Any], side: str, width: int, height: int, path: Path) -> Camera:
    """Read a camera of Kalibr's camchain: `intrinsics: [fu, fv, cu, cv]`, and its lens."""
    table = table_in(values, side, path)
    if table.get("camera_model", "pinhole") != "pinhole":
        raise InputError(
            CAMERA_LENS_UNKNOWN,
            "{side} is of camera_model {table}; pinhole is supported.",
            path,
            side=side,
            table=table["camera_model"],
        )
    fisheye = is_fisheye(table.get("distortion_model"), path)
    row = number_row(table.get("intrinsics"), "intrinsics", path)
    if len(row) != 4:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "{side}.intrinsics must be 4 numbers: fu, fv, cu, cv.",
            path,
            side=side,
        )
    bent = coefficients(table.get("distortion_coeffs"), path, fisheye=fisheye)
    camera = Camera(*stated_size(table, width, height, path), *row, distortion=bent, fisheye=fisheye)
    return for_images(checked(camera, path), width, height, path)


def matrix_camera(
    matrix: NDArray[np.float64], distortion: tuple[float, ...], width: int, height: int, path: Path
) -> Camera:
    """Return the checked camera of a 3x3 matrix (or one that begins with it)."""
    if matrix.shape not in _CAMERA_SHAPES:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "a camera matrix must be 3x3, not {matrix_shape}.",
            path,
            matrix_shape=matrix.shape,
        )
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return checked(Camera(width, height, fx, fy, cx, cy, distortion), path)


def text_numbers(path: Path) -> list[float]:
    """Return the bare numbers of a text or an array; raises InputError if it holds something else."""
    if path.suffix == ARRAY:
        array = read_array(path, "the camera matrix")
        if array.dtype.kind not in "uif" or array.size > _MOST_NUMBERS:
            raise InputError(
                CAMERA_CALIBRATION_INVALID,
                (
                    "a camera matrix of 3 rows of 3 numbers is expected; this is {array_shape} "
                    "of type {array_dtype}."
                ),
                path,
                array_shape=array.shape,
                array_dtype=array.dtype,
            )
        return [float(value) for value in array.ravel()]
    try:
        rows = [numbers_on(text) for _, text in documents.lines(path)]
        return [number for row in rows for number in row]
    except ValueError as error:
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "a camera matrix of 3 rows of 3 numbers is expected.", path
        ) from error


def text_matrix(path: Path) -> NDArray[np.float64]:
    """Return a matrix written as rows of numbers, or the four numbers fx fy cx cy as one."""
    values = text_numbers(path)
    if len(values) == MATRIX_AND_BASELINE:
        values.pop()
    if len(values) == 4:
        fx, fy, cx, cy = values
        values = [fx, 0, cx, 0, fy, cy, 0, 0, 1]
    if len(values) == _THREE_BY_FOUR:
        return np.array(values).reshape(3, 4)
    if len(values) not in (9, 16):
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "a camera matrix of 3 rows of 3 numbers is expected, not {values_count} numbers.",
            path,
            values_count=len(values),
        )
    side = math.isqrt(len(values))
    return np.array(values).reshape(side, side)


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
        CAMERA_LENS_UNKNOWN,
        (
            "the lens model {model} is not supported; radial-tangential and equidistant "
            "are. Undistort the images first."
        ),
        path,
        model=str(model)[:40],
    )


def coefficients(value: object, path: Path, *, fisheye: bool = False) -> tuple[float, ...]:
    """Return OpenCV's distortion coefficients (0, 4, 5, 8, 12 or 14 of them), empty when all are 0.

    A fisheye's are four: it bends lines even when they are 0.
    """
    row = number_row(value, "distortion", path)
    if fisheye:
        if len(row) != 4:
            raise InputError(
                CAMERA_CALIBRATION_INVALID,
                "a fisheye camera has 4 distortion coefficients, not {row_count}.",
                path,
                row_count=len(row),
            )
        return row
    if len(row) not in (0, 4, 5, 8, 12, 14):
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "distortion has {row_count} coefficients; OpenCV knows 4, 5, 8, 12 or 14.",
            path,
            row_count=len(row),
        )
    return row if any(row) else ()
