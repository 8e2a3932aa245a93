"""Reader for calibration files of one camera.

Supports JSON, TOML, YAML (OpenCV, Kalibr, ORB-SLAM), and matrices as text, with all common key names. Every
number is validated.
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
from scanloom.stages.files.number_rows import parse_number_row
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
from scanloom.stages.scans.calibration.image_size import fix_transposed_size, get_stated_size, scale_to_images
from scanloom.stages.scans.calibration.lens_names import find_distortion
from scanloom.stages.scans.calibration.table_values import (
    MATRIX_KEYS,
    flatten_numbers,
    get_matrix,
    get_table,
    to_finite_number,
)
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_ASSUMED,
    CAMERA_CALIBRATION_INVALID,
    CAMERA_CALIBRATION_MISMATCH,
    CAMERA_LENS_UNKNOWN,
)
from scanloom.stages.scans.model.scan import Camera

# Names of OpenCV's fisheye model, and of the models that OpenCV's standard distortion covers.
_FISHEYE_MODELS = ("equidistant", "fisheye", "kannala_brandt", "kannala_brandt4", "kb4")
_PINHOLE_MODELS = ("radtan", "radial-tangential", "plumb_bob", "rational_polynomial", "none")
# Shapes of matrices whose upper left part is the camera matrix.
_CAMERA_SHAPES = ((3, 3), (4, 4), (3, 4))
# Suffixes of files of numbers or name-value lines, of a NumPy array, and of a NumPy archive.
ARRAY_SUFFIX, ARCHIVE_SUFFIX = ".npy", ".npz"
TEXT_SUFFIXES = (".txt", ".csv", ".ini", ".conf", ARRAY_SUFFIX)
MATRIX_AND_BASELINE_SIZE = 10
_THREE_BY_FOUR_SIZE, _MAX_NUMBERS = 12, 16
# Units of depth per metre: smaller values are metres per unit; and the value of millimetres.
_MIN_UNITS_PER_METRE, _MILLIMETRES_PER_METRE = 0.5, 1000.0
# Name of the colour camera of a device. Depth maps are usually aligned to colour, rarely the reverse.
_COLOR_CAMERA_NAME = re.compile("rgb|colou?r", re.IGNORECASE)
# Keys of a nested table that holds the camera matrix, with the distortion in the outer table.
_INNER_TABLE_KEYS = ("intrinsic", "intrinsics")
# Pixels; beyond this range, projections are not representable in float32.
_FOCAL_RANGE_PX = (1e-3, 1e9)
# Coefficients of the rational model reach some hundreds, because its terms cancel each other.
_MAX_DISTORTION = 1e6


def read_camera(path: Path, width: int, height: int) -> Camera:
    """Read one camera for a given image size in pixels.

    Supported forms:

    - 3x3 or 4x4 matrix as text or .npy; text lines of names and numbers;
    - JSON, TOML, YAML or .npz with `fx fy cx cy`, or with `camera_matrix`, `K` or `intrinsic_matrix` (Open3D,
      column-major), and `distortion`;
    - Kalibr camchain of one camera, ORB-SLAM settings, RealSense and Azure Kinect calibrations.

    If the file has several cameras, the camera for this image size is used, or the colour camera. A camera
    for another size of the same aspect ratio is scaled. Both emit a warning.

    Raises
    ------
    InputError
        If the file cannot be read, something is missing, or a number is implausible.
    """
    document = read_calibration_document(path)
    if document is None:
        return scale_to_images(
            create_camera_from_matrix(read_bare_matrix(path), (), width, height, path), width, height, path
        )
    return parse_camera_table(orb_slam.to_calibration_table(document), width, height, path)


def read_calibration_document(path: Path) -> dict[str, Any] | None:
    """Read a calibration file as a table of names and values.

    Returns None for bare numbers.
    """
    if path.suffix == ARCHIVE_SUFFIX:
        return named_arrays.read_small_arrays(path)
    if path.suffix not in TEXT_SUFFIXES:
        return documents.read_document(path)
    if path.suffix == ARRAY_SUFFIX:
        return None
    text = documents.read_text(path)
    return zed.parse_zed_text(text) or ros_text.parse_ros_text(text) or named_text.parse_named_text(text)


def read_depth_scale(path: Path) -> float | None:
    """Read the depth units per metre from a camera file.

    Returns None if not stated.

    Raises
    ------
    InputError
        If the file cannot be read, or the scale is not positive.
    """
    document = read_calibration_document(path)
    if document is None:
        return None
    values = orb_slam.to_calibration_table(document)
    tables = [values, *(one for one in values.values() if isinstance(one, dict))]
    value = next((one["depth_scale"] for one in tables if one.get("depth_scale") is not None), None)
    if value is None:
        return None
    scale = to_finite_number(value, "depth_scale", path)
    if scale <= 0:
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "depth_scale is {scale:g}; it must be positive.", path, scale=scale
        )
    if "cam_K" in values:
        # BOP states millimetres per unit.
        return _MILLIMETRES_PER_METRE / scale
    # Depth units are at most 1 m, so a value below 0.5 is metres per unit (RealSense).
    return 1 / scale if scale < _MIN_UNITS_PER_METRE else scale


def check_camera_values(camera: Camera, path: Path) -> Camera:
    """Check that the intrinsics of a camera are plausible, and return the camera.

    Raises
    ------
    InputError
        If a value is not finite, a focal length is not positive, a coefficient is too large, or the principal
        point is far outside the image.
    """
    if not all(
        math.isfinite(value) for value in (camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion)
    ):
        raise InputError(CAMERA_CALIBRATION_INVALID, "a value of the camera is not finite.", path)
    if camera.fx <= 0 or camera.fy <= 0:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "the focal lengths are {fx:g} and {fy:g} px; both must be positive.",
            path,
            fx=camera.fx,
            fy=camera.fy,
        )
    if not all(_FOCAL_RANGE_PX[0] <= value <= _FOCAL_RANGE_PX[1] for value in (camera.fx, camera.fy)):
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "the focal lengths {fx:g} and {fy:g} px are implausible.",
            path,
            fx=camera.fx,
            fy=camera.fy,
        )
    if max(map(abs, camera.distortion), default=0.0) > _MAX_DISTORTION:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "the distortion coefficient {distortion:g} is implausible.",
            path,
            distortion=max(camera.distortion, key=abs),
        )
    width, height = camera.width, camera.height
    if not (-width <= camera.cx <= 2 * width and -height <= camera.cy <= 2 * height):
        raise InputError(
            CAMERA_CALIBRATION_MISMATCH,
            (
                "the principal point ({cx:g}, {cy:g}) is far outside the images of {width}×{height} "
                "px; is the calibration for another image size?"
            ),
            path,
            cx=camera.cx,
            cy=camera.cy,
            width=width,
            height=height,
        )
    return camera


def parse_camera_table(values: dict[str, Any], width: int, height: int, path: Path) -> Camera:
    """Create a camera from a calibration table for a given image size in pixels.

    Raises
    ------
    InputError
        If something is missing, a number is implausible, or the aspect ratio differs.
    """
    if azure_kinect.is_azure_kinect(values):
        values = azure_kinect.to_calibration_table(values, width, height, path)
    if zed.is_zed_calibration(values):
        values = zed.to_calibration_table(values, width, height, path)
    chain = [key for key in values if re.fullmatch(r"cam\d+", str(key))]
    if len(chain) == 1:
        return parse_kalibr_camera(values, chain[0], width, height, path)
    if chain:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            (
                "the file has several cameras ({chain}), and the camera of these images is ambiguous. "
                "Keep only that camera in a copy of the file."
            ),
            path,
            chain=", ".join(chain[:8]),
        )
    values = realsense.to_calibration_table(_select_camera_table(values, width, height, path))
    size = get_stated_size(values, width, height, path)
    fisheye = is_fisheye(values.get("distortion_model"), path)
    distortion = parse_distortion(find_distortion(values, path, fisheye=fisheye), path, fisheye=fisheye)
    camera = fix_transposed_size(_parse_intrinsics(values, distortion, *size, path), width, height)
    check_camera(values, camera, path)
    return scale_to_images(replace(camera, fisheye=fisheye), width, height, path)


def _select_camera_table(values: dict[str, Any], width: int, height: int, path: Path) -> dict[str, Any]:
    """Select the table of one camera.

    This is the table itself, its only nested camera, or the nested camera for this image size; if there are
    several, the colour camera.
    """
    if is_adjust_result(values):
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "this is the cameras.json of `adjust`, not a calibration. Pass it as scan.adjusted_cameras=FILE.",
            path,
        )
    if _has_intrinsics(values):
        return values
    tables = {name: _merge_inner_table(one) for name, one in values.items() if isinstance(one, dict)}
    inner = {name: one for name, one in tables.items() if _has_intrinsics(one)}
    if len(inner) == 1 and next(iter(inner)) in _INNER_TABLE_KEYS:
        return _merge_inner_table(values)
    if len(inner) < 2:
        return next(iter(inner.values()), values)
    of_size = [
        name for name, one in inner.items() if get_stated_size(one, width, height, path) == (width, height)
    ]
    fitting = of_size or list(inner)
    chosen = [name for name in fitting if _COLOR_CAMERA_NAME.search(name)] if len(fitting) > 1 else fitting
    if len(chosen) != 1:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            (
                "the file has several cameras ({inner}), and the camera of these images is ambiguous. "
                "Keep only that camera in a copy of the file."
            ),
            path,
            inner=", ".join(list(inner)[:8]),
        )
    emit(
        CAMERA_CALIBRATION_ASSUMED.warning(
            "the file has several cameras ({names}); {chosen} is used",
            path,
            names=", ".join(list(inner)[:8]),
            chosen=chosen[0],
        )
    )
    return inner[chosen[0]]


def is_adjust_result(values: dict[str, Any]) -> bool:
    """Return True if a table is the cameras.json of `adjust`."""
    return isinstance(values.get("accepted"), bool)


def _merge_inner_table(values: dict[str, Any]) -> dict[str, Any]:
    """Merge a nested `intrinsic` or `intrinsics` table into its parent."""
    inner = next((values[name] for name in _INNER_TABLE_KEYS if isinstance(values.get(name), dict)), None)
    return values if inner is None or not _has_intrinsics(inner) else values | inner


def _has_intrinsics(values: dict[str, Any]) -> bool:
    return any(key in values for key in MATRIX_KEYS) or {"fx", "fy"} <= values.keys()


def _parse_intrinsics(
    values: dict[str, Any], distortion: tuple[float, ...], width: int, height: int, path: Path
) -> Camera:
    if "intrinsic_matrix" in values:
        # Open3D stores the matrix column-major.
        matrix = get_matrix(values, "intrinsic_matrix", path)
        if matrix.shape in _CAMERA_SHAPES and matrix[2, :2].any():
            matrix = matrix.T
        return create_camera_from_matrix(matrix, distortion, width, height, path)
    for key in MATRIX_KEYS:
        if key in values:
            return create_camera_from_matrix(get_matrix(values, key, path), distortion, width, height, path)
    if missing := [key for key in ("fx", "fy", "cx", "cy") if key not in values]:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "the file has no camera: neither a matrix (`camera_matrix`, `K`) nor {missing}.",
            path,
            missing=", ".join(missing),
        )
    fx, fy, cx, cy = (to_finite_number(values[key], key, path) for key in ("fx", "fy", "cx", "cy"))
    return check_camera_values(Camera(width, height, fx, fy, cx, cy, distortion), path)


def parse_kalibr_camera(values: dict[str, Any], side: str, width: int, height: int, path: Path) -> Camera:
    """Read one camera of a Kalibr camchain: `intrinsics: [fu, fv, cu, cv]` and distortion."""
    table = get_table(values, side, path)
    if table.get("camera_model", "pinhole") != "pinhole":
        raise InputError(
            CAMERA_LENS_UNKNOWN,
            "{side} has the camera_model {table}; only pinhole is supported.",
            path,
            side=side,
            table=table["camera_model"],
        )
    fisheye = is_fisheye(table.get("distortion_model"), path)
    row = flatten_numbers(table.get("intrinsics"), "intrinsics", path)
    if len(row) != 4:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "{side}.intrinsics must be 4 numbers: fu, fv, cu, cv.",
            path,
            side=side,
        )
    distortion = parse_distortion(table.get("distortion_coeffs"), path, fisheye=fisheye)
    camera = Camera(
        *get_stated_size(table, width, height, path), *row, distortion=distortion, fisheye=fisheye
    )
    return scale_to_images(check_camera_values(camera, path), width, height, path)


def create_camera_from_matrix(
    matrix: NDArray[np.float64], distortion: tuple[float, ...], width: int, height: int, path: Path
) -> Camera:
    """Create a camera from a 3x3, 3x4 or 4x4 matrix.

    Raises
    ------
    InputError
        If the matrix has another shape, or the intrinsics are implausible.
    """
    if matrix.shape not in _CAMERA_SHAPES:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "a camera matrix must be 3x3, not {matrix_shape}.",
            path,
            matrix_shape=matrix.shape,
        )
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return check_camera_values(Camera(width, height, fx, fy, cx, cy, distortion), path)


def read_bare_numbers(path: Path) -> list[float]:
    """Read the bare numbers of a text file or a .npy array.

    Raises
    ------
    InputError
        If the file holds anything else.
    """
    if path.suffix == ARRAY_SUFFIX:
        array = read_array(path, "the camera matrix")
        if array.dtype.kind not in "uif" or array.size > _MAX_NUMBERS:
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
        rows = [parse_number_row(text) for _, text in documents.iterate_lines(path)]
        return [number for row in rows for number in row]
    except ValueError as error:
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "a camera matrix of 3 rows of 3 numbers is expected.", path
        ) from error


def read_bare_matrix(path: Path) -> NDArray[np.float64]:
    """Read a camera matrix from rows of numbers, or from the four numbers fx fy cx cy.

    Returns
    -------
    (3, 3), (3, 4) or (4, 4) float64. A tenth number behind a 3x3 matrix is a baseline and ignored.
    """
    values = read_bare_numbers(path)
    if len(values) == MATRIX_AND_BASELINE_SIZE:
        values.pop()
    if len(values) == 4:
        fx, fy, cx, cy = values
        values = [fx, 0, cx, 0, fy, cy, 0, 0, 1]
    if len(values) == _THREE_BY_FOUR_SIZE:
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
    """Return True if a distortion model name means the fisheye model.

    None means OpenCV's standard model.

    Raises
    ------
    InputError
        If the model is not supported.
    """
    if model is None or model in _PINHOLE_MODELS:
        return False
    if model in _FISHEYE_MODELS:
        return True
    raise InputError(
        CAMERA_LENS_UNKNOWN,
        (
            "the lens model {model} is not supported, only radial-tangential and equidistant. "
            "Undistort the images first."
        ),
        path,
        model=str(model)[:40],
    )


def parse_distortion(value: object, path: Path, *, fisheye: bool = False) -> tuple[float, ...]:
    """Check OpenCV's distortion coefficients: 0, 4, 5, 8, 12 or 14.

    The result is empty if all are 0.

    A fisheye camera has four coefficients, which are kept if 0, because its projection is not a pinhole.

    Raises
    ------
    InputError
        For another number of coefficients.
    """
    row = flatten_numbers(value, "distortion", path)
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
            "distortion has {row_count} coefficients; OpenCV supports 4, 5, 8, 12 or 14.",
            path,
            row_count=len(row),
        )
    return row if any(row) else ()
