"""Confidence of swept depth as a probability, from sweep and cross-view indicators."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import DepthImage
from scanloom.stages.stereo.agreement import Said
from scanloom.stages.stereo.background import steps
from scanloom.stages.stereo.plane_sweep import HALF_MARGIN

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
# Windows for margins, texture and spread, px.
_MARGINS, _TEXTURES, _AROUND = 9, 15, 5
# Window for one-sided texture, px: the minimum over all windows that contain the pixel. Next to an edge it is
# the texture of the plainer side, whose depth may be dragged along with the edge.
_SIDES = 9
# Longer side of the images in the regression, px.
_USUAL_PX = 640
# Minimum texture assumed on an object.
_OF_A_THING = 2.0
# Clipping limits of texture and of the relative spread of inverse depth; beyond them they carry no more
# information.
_MOST_TEXTURE = 3.0
_MOST_SPREAD = 0.5
# Number of aggregation paths, and clipping limit of the cost margin.
_PATHS = 8
_LARGEST_MARGIN = 3000.0


def views_confidence(
    depth: DepthImage,
    distinct: NDArray[np.uint8],
    grey: NDArray[np.uint8],
    said: Said,
    is_outlined: bool = False,
) -> NDArray[np.uint8]:
    """Compute the confidence of swept depth.

    Parameters
    ----------
    depth : (h, w) float32 metres.
    distinct : (h, w) uint8, 255 times the distinctness of the sweep.
    grey : (h, w) uint8, the image.
    said : counts of other views that support the depth.
    is_outlined : True if the depth belongs to an object with known outline. A plain pixel is then on the
        object, whereas plain background may be at any depth.

    Returns
    -------
    (h, w) uint8, 255 times the probability that depth is right within 5 %; 0 where missing.
    """
    signs = _signs(depth, distinct, grey, said, is_outlined)
    logit = np.full(depth.shape, np.float32(_BIAS))
    for name, (weight, weight_squared) in _WEIGHTS.items():
        logit += (np.float32(weight) + np.float32(weight_squared) * signs[name]) * signs[name]
    return np.where(depth > 0, np.rint(255 / (1 + np.exp(-logit))), 0).astype(np.uint8)


def _signs(
    depth: DepthImage,
    distinct: NDArray[np.uint8],
    grey: NDArray[np.uint8],
    said: Said,
    is_outlined: bool,
) -> dict[str, Map]:
    """Return the indicators of the regression by name, (h, w) each."""
    import cv2

    margin = HALF_MARGIN * distinct.astype(np.float32) / np.maximum(255 - distinct.astype(np.float32), 0.255)
    margins = np.log1p(np.minimum(margin, _LARGEST_MARGIN) / _PATHS).astype(np.float32)
    least = _OF_A_THING if is_outlined else 0
    texture, sides = (np.clip(np.log1p(one), least, _MOST_TEXTURE) for one in _texture(grey))
    nearly = said.nearly.astype(np.float32)
    open_, looking = (np.maximum(one, 1).astype(np.float32) for one in (said.open, said.looking))
    return {
        "margin": np.asarray(cv2.boxFilter(margins, -1, (_MARGINS, _MARGINS)), np.float32),
        "texture": texture,
        "textured around": sides,
        "spread": _spread(depth),
        "nearly agreeing of open": nearly / open_,
        "agreeing of open": said.agreeing.astype(np.float32) / open_,
        "nearly agreeing of looking": nearly / looking,
    }


def _spread(depth: DepthImage) -> Map:
    """Return the log spread of inverse depth around each pixel.

    It is log(1 + the relative difference of the maximum to the minimum, in per cent).
    """
    import cv2

    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    kernel = np.ones((_AROUND, _AROUND), np.uint8)
    # Missing depth must not count as nearest or farthest.
    nearest = cv2.dilate(inverse, kernel)
    farthest = cv2.erode(np.where(depth > 0, inverse, np.float32(np.inf)), kernel)
    share = np.divide(nearest, farthest, out=np.ones_like(inverse), where=inverse > 0) - 1
    return np.asarray(np.log1p(100 * np.minimum(share, _MOST_SPREAD)), np.float32)


def _texture(grey: NDArray[np.uint8]) -> tuple[Map, Map]:
    """Return mean texture around each pixel, and of its plainer side.

    Both are in grey levels, on the image scaled to the size of the regression images. A larger image of the
    same object has weaker gradients.
    """
    import cv2

    height, width = grey.shape
    smaller = min(_USUAL_PX / max(height, width), 1.0)
    size = max(round(width * smaller), 1), max(round(height * smaller), 1)
    small = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
    mean = steps(small, _TEXTURES) / _TEXTURES**2
    sides = cv2.erode(steps(small, _SIDES) / _SIDES**2, np.ones((_SIDES, _SIDES), np.uint8))
    whole = [cv2.resize(one, (width, height), interpolation=cv2.INTER_LINEAR) for one in (mean, sides)]
    return np.asarray(whole[0], np.float32), np.asarray(whole[1], np.float32)
