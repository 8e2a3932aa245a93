"""Confidence of swept and of fused depth as a probability, from sweep and cross-view indicators."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import DepthImage
from scanloom.stages.stereo.background import sum_gradients
from scanloom.stages.stereo.plane_sweep import HALF_MARGIN
from scanloom.stages.stereo.view_consistency import ViewSupport
from scanloom.stages.stereo.view_fusion import FusedDepth

Map = NDArray[np.float32]

# Logistic regression of the event that depth is right within 5 %. The second weights are for the squared
# indicators. Fitted to 58 views with sensor depth and adjusted poses: a third of 7-Scenes' red kitchen, and a
# box on a table, with equal numbers of pixels.
_BIAS = -5.614
_WEIGHTS = {
    "margin": (0.632, 0.0),
    "texture": (2.905, -0.703),
    "textured around": (0.586, -0.034),
    "spread": (-0.172, 0.0),
    "nearly agreeing of open": (0.592, 0.114),
    "agreeing of open": (0.373, 0.0),
    "nearly agreeing of looking": (2.328, 0.0),
}
# The same for depth fused with other views.
_FUSED_BIAS = -0.667
_FUSED_WEIGHTS = {
    "confirming": (3.014, 0.363),
    "contradicting": (-0.827, 0.056),
    "texture": (0.616, -0.182),
    "textured around": (0.184, 0.030),
    "spread": (-0.215, -0.018),
    "consistent": (-0.696, 0.007),
}
# Windows for margins, texture and spread, px.
_MARGIN_WINDOW, _TEXTURE_WINDOW, _SPREAD_WINDOW = 9, 15, 5
# Window for one-sided texture, px: the minimum over all windows that contain the pixel. Next to an edge it is
# the texture of the plainer side, whose depth may be dragged along with the edge.
_SIDE_WINDOW = 9
# Longer side of the images in the regression, px.
_REGRESSION_SIDE_PX = 640
# Minimum texture assumed on an object.
_MIN_OBJECT_TEXTURE = 2.0
# Clipping limits of texture and of the relative spread of inverse depth; beyond them they carry no more
# information.
_MAX_TEXTURE = 3.0
_MAX_SPREAD = 0.5
# Clipping limit of the number of consistent views.
_MAX_CONSISTENT = 12
# Number of aggregation paths, and clipping limit of the cost margin.
_PATH_COUNT = 8
_MAX_MARGIN = 3000.0


def compute_sweep_confidence(
    depth: DepthImage,
    distinctness: NDArray[np.uint8],
    grey: NDArray[np.uint8],
    support: ViewSupport,
    is_outlined: bool = False,
) -> NDArray[np.uint8]:
    """Compute the confidence of swept depth.

    Parameters
    ----------
    depth : (h, w) float32 metres.
    distinctness : (h, w) uint8, 255 times the distinctness of the sweep.
    grey : (h, w) uint8, the image.
    support : counts of other views that support the depth.
    is_outlined : True if the depth belongs to an object with known outline. A plain pixel is then on the
        object, whereas plain background may be at any depth.

    Returns
    -------
    (h, w) uint8, 255 times the probability that depth is right within 5 %; 0 where missing.
    """
    indicators = _compute_indicators(depth, distinctness, grey, support, is_outlined)
    return _compute_probability(depth, indicators, _BIAS, _WEIGHTS)


def compute_fused_confidence(
    fused: FusedDepth, grey: NDArray[np.uint8], is_outlined: bool = False
) -> NDArray[np.uint8]:
    """Compute the confidence of fused depth; parameters and result as in `compute_sweep_confidence`."""
    indicators = _compute_fused_indicators(fused, grey, is_outlined)
    return _compute_probability(fused.depth, indicators, _FUSED_BIAS, _FUSED_WEIGHTS)


def _compute_probability(
    depth: DepthImage, indicators: dict[str, Map], bias: float, weights: dict[str, tuple[float, float]]
) -> NDArray[np.uint8]:
    logit = np.full(depth.shape, np.float32(bias))
    for name, (weight, weight_squared) in weights.items():
        logit += (np.float32(weight) + np.float32(weight_squared) * indicators[name]) * indicators[name]
    return np.where(depth > 0, np.rint(255 / (1 + np.exp(-logit))), 0).astype(np.uint8)


def _compute_fused_indicators(
    fused: FusedDepth, grey: NDArray[np.uint8], is_outlined: bool
) -> dict[str, Map]:
    """Return the indicators of the regression for fused depth by name, (h, w) each."""
    confirming, contradicting = (
        np.log1p(sums.astype(np.float32) / np.float32(255))
        for sums in (fused.confirming, fused.contradicting)
    )
    texture, sides = _compute_texture_indicators(grey, is_outlined)
    return {
        "confirming": confirming,
        "contradicting": contradicting,
        "texture": texture,
        "textured around": sides,
        "spread": _compute_depth_spread(fused.depth),
        "consistent": np.minimum(fused.nearly_consistent, _MAX_CONSISTENT).astype(np.float32),
    }


def _compute_texture_indicators(grey: NDArray[np.uint8], is_outlined: bool) -> list[Map]:
    """Return log texture around each pixel, and of its plainer side."""
    least = _MIN_OBJECT_TEXTURE if is_outlined else 0
    return [np.clip(np.log1p(one), least, _MAX_TEXTURE) for one in _compute_texture(grey)]


def _compute_indicators(
    depth: DepthImage,
    distinctness: NDArray[np.uint8],
    grey: NDArray[np.uint8],
    support: ViewSupport,
    is_outlined: bool,
) -> dict[str, Map]:
    """Return the indicators of the regression by name, (h, w) each."""
    import cv2

    margin = (
        HALF_MARGIN
        * distinctness.astype(np.float32)
        / np.maximum(255 - distinctness.astype(np.float32), 0.255)
    )
    margins = np.log1p(np.minimum(margin, _MAX_MARGIN) / _PATH_COUNT).astype(np.float32)
    texture, sides = _compute_texture_indicators(grey, is_outlined)
    nearly = support.nearly_consistent.astype(np.float32)
    open_, looking = (
        np.maximum(one, 1).astype(np.float32) for one in (support.unoccluded, support.with_depth)
    )
    return {
        "margin": np.asarray(cv2.boxFilter(margins, -1, (_MARGIN_WINDOW, _MARGIN_WINDOW)), np.float32),
        "texture": texture,
        "textured around": sides,
        "spread": _compute_depth_spread(depth),
        "nearly agreeing of open": nearly / open_,
        "agreeing of open": support.consistent.astype(np.float32) / open_,
        "nearly agreeing of looking": nearly / looking,
    }


def _compute_depth_spread(depth: DepthImage) -> Map:
    """Return the log spread of inverse depth around each pixel.

    It is log(1 + the relative difference of the maximum to the minimum, in per cent).
    """
    import cv2

    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    kernel = np.ones((_SPREAD_WINDOW, _SPREAD_WINDOW), np.uint8)
    # Missing depth must not count as nearest or farthest.
    nearest = cv2.dilate(inverse, kernel)
    farthest = cv2.erode(np.where(depth > 0, inverse, np.float32(np.inf)), kernel)
    share = np.divide(nearest, farthest, out=np.ones_like(inverse), where=inverse > 0) - 1
    return np.asarray(np.log1p(100 * np.minimum(share, _MAX_SPREAD)), np.float32)


def _compute_texture(grey: NDArray[np.uint8]) -> tuple[Map, Map]:
    """Return mean texture around each pixel, and of its plainer side.

    Both are in grey levels, on the image scaled to the size of the regression images. A larger image of the
    same object has weaker gradients.
    """
    import cv2

    height, width = grey.shape
    smaller = min(_REGRESSION_SIDE_PX / max(height, width), 1.0)
    size = max(round(width * smaller), 1), max(round(height * smaller), 1)
    small = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
    mean = sum_gradients(small, _TEXTURE_WINDOW) / _TEXTURE_WINDOW**2
    sides = cv2.erode(
        sum_gradients(small, _SIDE_WINDOW) / _SIDE_WINDOW**2, np.ones((_SIDE_WINDOW, _SIDE_WINDOW), np.uint8)
    )
    whole = [cv2.resize(one, (width, height), interpolation=cv2.INTER_LINEAR) for one in (mean, sides)]
    return np.asarray(whole[0], np.float32), np.asarray(whole[1], np.float32)
