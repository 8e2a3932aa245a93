"""Validation of images, intrinsics and poses given as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import USAGE_FRAME_INVALID
from scanloom.stages.scans.model.poses import Pose, check_rigid_pose

# Units per metre of integer depth. Depth cameras store millimetres.
DEFAULT_DEPTH_SCALE = 1000.0
# Metres. A larger median depth means that the unit is wrong: no depth camera reaches 300 m, and 300 mm is the
# near limit of indoor scans.
_MAX_MEDIAN_DEPTH_M = 300.0
# Focal length in image widths: horizontal fields of view of 174° and 1.4°.
_MIN_FOCAL_RATIO, _MAX_FOCAL_RATIO = 0.025, 40.0


def check_color(image: ArrayLike, where: str) -> NDArray[np.uint8]:
    """Check a colour image, (h, w, 3) or (h, w) uint8, and drop an alpha channel.

    Raises
    ------
    InputError
        For another shape or dtype.
    """
    array = np.asarray(image)
    is_color = array.ndim == 2 or (array.ndim == 3 and array.shape[2] in (3, 4))
    if array.dtype != np.uint8 or not is_color or not array.size:
        raise InputError(
            USAGE_FRAME_INVALID,
            "a colour image must be (h, w, 3) RGB or (h, w) grey uint8, not {array_shape} {array_dtype}.",
            where,
            array_shape=array.shape,
            array_dtype=array.dtype,
        )
    return array if array.ndim == 2 else array[:, :, :3]


def check_depth(image: ArrayLike, scale: float | None, where: str) -> NDArray[np.float32]:
    """Convert a depth image to (h, w) float32 metres.

    Missing, infinite and negative depth becomes 0.

    Parameters
    ----------
    image : (h, w) floats in metres, or integers of at least 16 bits.
    scale : units per metre; None for 1000 with integers and 1 with floats.

    Raises
    ------
    InputError
        For another shape or dtype, a scale that is not positive, and a median depth above 300 m without a
        scale.
    """
    array = np.asarray(image)
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    is_integer = np.issubdtype(array.dtype, np.integer) and array.dtype.itemsize > 1
    if array.ndim != 2 or not array.size or not (is_integer or np.issubdtype(array.dtype, np.floating)):
        raise InputError(
            USAGE_FRAME_INVALID,
            (
                "a depth image must be (h, w) floats in metres, or integers of at least 16 "
                "bits, not {array_shape} {array_dtype}."
            ),
            where,
            array_shape=array.shape,
            array_dtype=array.dtype,
        )
    units = (DEFAULT_DEPTH_SCALE if is_integer else 1.0) if scale is None else scale
    if not (np.isfinite(units) and units > 0):
        raise InputError(
            USAGE_FRAME_INVALID,
            "depth_scale must be a positive number of units per metre, not {units!r}.",
            where,
            units=units,
        )
    with np.errstate(over="ignore", invalid="ignore"):
        depth: NDArray[np.float32] = np.divide(array, units, dtype=np.float64).astype(np.float32)
    depth[~(np.isfinite(depth) & (depth > 0))] = 0
    if scale is None and depth.any() and (median := float(np.median(depth[depth > 0]))) > _MAX_MEDIAN_DEPTH_M:
        raise InputError(
            USAGE_FRAME_INVALID,
            "the median depth is {median:,.0f} m, which is implausible.",
            where,
            remedy="Set depth_scale, the units per metre: 1000 for millimetres, 1 for metres.",
            median=median,
        )
    return depth


def check_gray(image: ArrayLike, name: str, where: str) -> NDArray[np.uint8]:
    """Check a mask or confidence image, (h, w) uint8 or bool.

    True becomes 255.

    Raises
    ------
    InputError
        For another shape or dtype.
    """
    array = np.asarray(image)
    if array.ndim != 2 or not array.size or array.dtype not in (np.uint8, np.bool_):
        raise InputError(
            USAGE_FRAME_INVALID,
            "{name} must be (h, w) uint8 or bool, not {array_shape} {array_dtype}.",
            where,
            name=name,
            array_shape=array.shape,
            array_dtype=array.dtype,
        )
    return cast("NDArray[np.uint8]", array.astype(np.uint8) * 255 if array.dtype == np.bool_ else array)


def check_intrinsics(
    intrinsics: ArrayLike, size: tuple[int, int], where: str
) -> tuple[float, float, float, float]:
    """Check intrinsics and return fx, fy, cx and cy in pixels.

    Parameters
    ----------
    intrinsics : (3, 3) camera matrix, or fx, fy, cx, cy.
    size : width and height of the image.

    Raises
    ------
    InputError
        For another shape, a skewed matrix, and values that are implausible for the image size.
    """
    try:
        values = np.asarray(intrinsics, np.float64)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape == (3, 3):
        fx, fy, cx, cy = values[0, 0], values[1, 1], values[0, 2], values[1, 2]
        rest = np.array([values[0, 1], values[1, 0], values[2, 0], values[2, 1], values[2, 2] - 1])
        if not (np.abs(rest) <= 1e-6 * max(abs(fx), 1.0)).all():
            raise InputError(
                USAGE_FRAME_INVALID,
                "a camera matrix must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], not {array2string}.",
                where,
                array2string=np.array2string(values, precision=4, separator=", ").replace(chr(10), ""),
            )
    elif values.shape == (4,):
        fx, fy, cx, cy = values
    else:
        raise InputError(
            USAGE_FRAME_INVALID,
            "intrinsics must be a (3, 3) camera matrix, a Camera, or fx, fy, cx, cy in pixels.",
            where,
        )
    width, height = size
    fits = all(_MIN_FOCAL_RATIO * width <= focal <= _MAX_FOCAL_RATIO * width for focal in (fx, fy))
    if not (fits and -width <= cx <= 2 * width and -height <= cy <= 2 * height):
        raise InputError(
            USAGE_FRAME_INVALID,
            (
                "intrinsics of fx {fx:g}, fy {fy:g}, cx {cx:g}, cy {cy:g} px do not fit an image of "
                "{width} × {height} px. Intrinsics must be scaled with the image size."
            ),
            where,
            fx=fx,
            fy=fy,
            cx=cx,
            cy=cy,
            width=width,
            height=height,
        )
    return float(fx), float(fy), float(cx), float(cy)


def check_pose(pose: ArrayLike | None, name: str, where: str) -> Pose | None:
    """Check a rigid transform, (4, 4) or (3, 4).

    Returns None if all values are NaN, which trackers use for a lost pose.

    Raises
    ------
    InputError
        For another shape, and for a matrix that is not rigid.
    """
    if pose is None:
        return None
    try:
        matrix = np.asarray(pose, np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise InputError(
            USAGE_FRAME_INVALID,
            "{name} must be a (4, 4) or (3, 4) matrix, not {describe}.",
            where,
            name=name,
            describe=_describe(pose),
        )
    return check_rigid_pose(matrix, where)


def check_distortion(values: Sequence[float] | ArrayLike, where: str) -> tuple[float, ...]:
    """Check distortion coefficients in OpenCV's order and return them as a tuple.

    Raises
    ------
    InputError
        For a number of coefficients that OpenCV does not support, and for values that are not finite.
    """
    array = np.asarray(values, np.float64).reshape(-1)
    if len(array) not in (0, 4, 5, 8, 12, 14) or not np.isfinite(array).all():
        raise InputError(
            USAGE_FRAME_INVALID,
            "distortion must be 4, 5, 8, 12 or 14 finite numbers in OpenCV's order, k1 k2 p1 p2 k3 …",
            where,
        )
    return tuple(array.tolist())


def _describe(value: Any) -> str:
    """Describe a value by shape and dtype, or by its type."""
    return f"{value.shape} {value.dtype}" if isinstance(value, np.ndarray) else type(value).__name__
