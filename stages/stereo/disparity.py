"""Semi-global census matcher for rectified pairs, with probabilities as confidence.

Hirschmüller, "Stereo processing by semiglobal matching and mutual information", 2008, over census and
gradient costs that are averaged over pixels of similar colour. Pixels that fail the left–right check, and
pixels next to a disparity jump, are replaced by a weighted median. It prefers surrounding pixels of the same
colour (Ma et al., "Constant time weighted median filtering for stereo matching and beyond", 2013).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files.memory_check import check_memory_available
from scanloom.stages.printing import format_by_metrics, render_table

Map = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Tolerance of the left–right check, px.
_LEFT_RIGHT_TOLERANCE = 1
# Disparity difference of a jump, px; window around a jump in which a pixel may belong to either side, px.
_MIN_JUMP = 2
_JUMP_WINDOW = 7
# Radius of the weighted median, px, and colour difference with weight 1/e, grey levels. The wide window is
# for pixels with too few matched pixels of their colour in the narrow one.
_NARROW_MEDIAN, _WIDE_MEDIAN = (5, 8.0), (13, 6.0)
_MIN_KNOWN_WEIGHT = 0.15
# Windows of the confidence indicators, px: ratio of matched pixels, and range of disparities.
_MATCHED_WINDOW, _SPREAD_WINDOW = 11, 5
# Number of aggregation paths; costs are sums over all paths.
_PATH_COUNT = 8
# Logistic regression of the event that the disparity is right within 2 px: weights of each indicator and of
# its square. Fitted to pairs with ground truth, with equal numbers of pixels, occluded pixels included:
# Motorcycle and Adirondack (Middlebury 2014), Cones (2003), Cloth3, Reindeer and Wood2 (2006), and four pairs
# of KITTI 2015.
_WEIGHTS = {
    "margin": (-1.0657, 0.2672),
    "agreeing": (0.8425, 0.0),
    "known": (-3.4651, 4.5083),
    "matched": (0.6753, 1.3999),
    "spread": (-0.0835, 0.0),
}
_BIAS = 0.0967
# Clipping limit of the disparity range, px; a wider range carries no more information.
_MAX_SPREAD = 12
# Bytes per pixel and disparity for the three cost volumes.
_VOLUME_BYTES = 6
_DISPARITY_STEP = 16
_MAX_RANGE = 1 << 13


@dataclass(frozen=True, eq=False)
class Disparity:
    """Disparity of a rectified left image.

    Attributes
    ----------
    disparity : (h, w) float32 px, x of the left minus x of the right image; NaN where confidence is too low.
    confidence : (h, w) float32, 0 to 1: probability that the disparity is right within 2 px, for every pixel.
    filled : (h, w) bool, pixels whose disparity comes from surrounding pixels.
    """

    disparity: Map
    confidence: Map
    filled: Mask

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return JSON-ready statistics, with units in the keys."""
        sure = np.isfinite(self.disparity)
        return {
            "width_px": self.disparity.shape[1],
            "height_px": self.disparity.shape[0],
            "confident_ratio": float(sure.mean()),
            "filled_ratio": float((sure & self.filled).mean()),
            "median_disparity_px": float(np.median(self.disparity[sure])) if sure.any() else None,
            "mean_confidence": float(self.confidence.mean()),
        }


def stereo_disparity(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    max_disparity: int,
    *,
    min_disparity: int = 0,
    min_confidence: float = 0.8,
    threads: int | None = None,
) -> Disparity:
    """Compute the disparity of a rectified pair.

    Results do not depend on the number of threads.

    Parameters
    ----------
    left, right : (h, w, 3) RGB or (h, w) grey uint8, whose rows correspond.
    max_disparity, min_disparity : px, inclusive search range.
    min_confidence : 0 to 1; pixels below have no disparity. 0 keeps every pixel. Higher values keep fewer
        pixels with fewer errors.
    threads : thread count; None uses all cores.

    Raises
    ------
    InputError
        If the images are invalid or differ in size.
    UsageError
        If the range is empty or wider than 8,192 px, or `min_confidence` is not from 0 to 1.
    MemoryError
        If memory does not suffice: 6 bytes for each pixel and disparity.
    """
    import cv2

    first, second = (_check_image(image, name) for image, name in ((left, "left"), (right, "right")))
    if first.shape != second.shape:
        raise InputError(
            USAGE_ARGUMENT_INVALID,
            "left and right image differ in size: {size} and {size_2} px.",
            size=_format_size(first),
            size_2=_format_size(second),
        )
    if not 0 <= max_disparity - min_disparity < _MAX_RANGE:
        raise UsageError(
            USAGE_ARGUMENT_INVALID,
            (
                "max_disparity is {max_disparity} px; it must be from min_disparity ({min_disparity} px) "
                "to {min_disparity_2} px."
            ),
            max_disparity=max_disparity,
            min_disparity=min_disparity,
            min_disparity_2=min_disparity + _MAX_RANGE - 1,
        )
    if not 0 <= min_confidence <= 1:
        raise UsageError(
            USAGE_ARGUMENT_INVALID,
            "is {min_confidence:g}; it must be from 0 to 1.",
            DiagnosticLocation(parameter="min_confidence"),
            min_confidence=min_confidence,
        )
    count = -(-(max_disparity - min_disparity + 1) // _DISPARITY_STEP) * _DISPARITY_STEP
    check_memory_available(compute_volume_bytes(first.shape[1], first.shape[0], count))
    found, of_right, _, margin, _ = _kernels.match_pair(
        first, second, lowest=min_disparity, count=count, wanted_threads=threads or 0
    )
    agrees = np.abs(found - _look_up_right_disparity(found, of_right)) <= _LEFT_RIGHT_TOLERANCE

    def compute_medians(known: Mask, wanted: Mask, window: tuple[int, float]) -> tuple[Map, Map, Map]:
        return _kernels.compute_weighted_medians(
            first,
            np.where(known, found, np.float32(np.nan)),
            wanted,
            lowest=min_disparity,
            count=count,
            radius=window[0],
            falloff=window[1],
            wanted_threads=threads or 0,
        )

    median_disparity, agreeing, known = compute_medians(agrees, np.ones_like(agrees), _NARROW_MEDIAN)
    kernel = np.ones((_JUMP_WINDOW, _JUMP_WINDOW), np.uint8)
    highest = cv2.dilate(np.where(agrees, found, np.float32(min_disparity - 1)), kernel)
    lowest = cv2.erode(np.where(agrees, found, np.float32(max_disparity + 1)), kernel)
    doubtful = (highest - lowest > _MIN_JUMP) | ~agrees
    replaced = doubtful & (np.abs(median_disparity - found) > _LEFT_RIGHT_TOLERANCE)
    found = np.where(replaced, median_disparity, found)
    without_support = ~agrees & (known < _MIN_KNOWN_WEIGHT)
    if without_support.any():
        median_disparity, _, _ = compute_medians(agrees, without_support, _WIDE_MEDIAN)
        filled = without_support & np.isfinite(median_disparity)
        found, replaced = np.where(filled, median_disparity, found), replaced | filled
    near = np.ones((_SPREAD_WINDOW, _SPREAD_WINDOW), np.uint8)
    indicators = {
        "margin": np.log1p(np.maximum(margin, 0).astype(np.float32) / _PATH_COUNT),
        "agreeing": agreeing,
        "known": known,
        "matched": cv2.boxFilter(agrees.astype(np.float32), -1, (_MATCHED_WINDOW, _MATCHED_WINDOW)),
        "spread": np.minimum(cv2.dilate(found, near) - cv2.erode(found, near), _MAX_SPREAD),
    }
    logit = np.full(found.shape, _BIAS, np.float32)
    for name, indicator in indicators.items():
        weight, weight_squared = _WEIGHTS[name]
        logit += (weight + weight_squared * indicator) * indicator
    confidence = (1 / (1 + np.exp(-logit))).astype(np.float32)
    # The kernel rounds the range up to multiples of 16; disparities beyond the requested range are dropped.
    outside = (found < min_disparity - 0.5) | (found > max_disparity + 0.5) | ~np.isfinite(found)
    confidence[outside] = 0
    is_confident = (confidence >= min_confidence) & ~outside
    return Disparity(np.where(is_confident, found, np.float32(np.nan)), confidence, replaced)


def compute_volume_bytes(width: int, height: int, count: int) -> int:
    """Return the memory of the cost volumes in bytes.

    Parameters
    ----------
    width, height : image size, pixels.
    count : number of disparities.
    """
    return _VOLUME_BYTES * width * height * count


def _look_up_right_disparity(disparity: Map, of_right: Map) -> Map:
    """Look up the right disparity at the match of each left pixel.

    The result is NaN outside of the image.
    """
    width = disparity.shape[1]
    columns = np.rint(np.arange(width, dtype=np.float32) - disparity)
    inside = (columns >= 0) & (columns < width)
    there = np.take_along_axis(of_right, np.where(inside, columns, 0).astype(np.intp), axis=1)
    return np.where(inside, there, np.float32(np.nan))


def _check_image(image: NDArray[np.uint8], name: str) -> NDArray[np.uint8]:
    if image.dtype != np.uint8 or image.size == 0 or not (image.ndim == 2 or image.shape[2:] == (3,)):
        raise InputError(
            USAGE_ARGUMENT_INVALID,
            "the {name} image is {image_shape} {image_dtype}; (h, w, 3) or (h, w) uint8 is expected.",
            name=name,
            image_shape=image.shape,
            image_dtype=image.dtype,
        )
    colored = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
    return np.ascontiguousarray(colored)


def _format_size(image: NDArray[np.uint8]) -> str:
    return f"{image.shape[1]} × {image.shape[0]}"
