"""How sure the depth of a view among others is: a probability, of what the sweep and other views say."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.scans.scan import DepthImage
from stages.stereo.background import steps
from stages.stereo.plane_sweep import HALF_MARGIN

# The logistic regression of being right within 5 % of the depth, fitted to 58 views with depth of a sensor
# and adjusted poses: a third of 7-Scenes' red kitchen and a box on a table, as many pixels of each.
_BIAS = -5.905
_MARGIN = 0.835
_TEXTURE, _TEXTURE_SQUARED = 3.747, -0.835
_AGREEING, _AGREEING_SQUARED, _NEARLY = 0.084, 0.087, 0.914
_SPREAD = -0.33
# Windows over which margins, texture and spread are gathered, px.
_MARGINS, _TEXTURES, _AROUND = 9, 15, 5
# The longer side of the images of the regression, px.
_USUAL_PX = 640
# A thing's texture counts as this at least.
_OF_A_THING = 2.0
# Texture of more, and a wider spread of inverse depth, say no more.
_MOST_TEXTURE = 3.0
_MOST_SPREAD = 0.5
# Of sums of costs over eight paths, one path's part.
_PATHS = 8
_LARGEST_MARGIN = 3000.0


def views_confidence(
    depth: DepthImage,
    distinct: NDArray[np.uint8],
    grey: NDArray[np.uint8],
    agreeing: NDArray[np.uint8],
    nearly: NDArray[np.uint8],
    is_outlined: bool = False,
) -> NDArray[np.uint8]:
    """Return 255 times the probability that depth is right within 5 %; 0 where there is none.

    Parameters
    ----------
    depth : (h, w) float32 metres.
    distinct : (h, w) uint8, 255 times that of the sweep.
    grey : (h, w) uint8, the image.
    agreeing, nearly : (h, w) uint8, how many other views have the same depth, and nearly the same.
    is_outlined : the view's depth is that of a thing that is told from what is behind it. A plain place of a
        thing lies on it, where a plain background may lie anywhere.
    """
    import cv2

    share = distinct.astype(np.float32) / 255
    margin = np.minimum(HALF_MARGIN * share / np.maximum(1 - share, 1e-3), _LARGEST_MARGIN)
    margins = cv2.boxFilter(np.log1p(margin / _PATHS).astype(np.float32), -1, (_MARGINS, _MARGINS))
    texture = np.clip(np.log1p(_texture(grey)), _OF_A_THING if is_outlined else 0, _MOST_TEXTURE)
    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    kernel = np.ones((_AROUND, _AROUND), np.uint8)
    # What has no depth is neither the nearest nor the farthest around.
    nearest = cv2.dilate(inverse, kernel)
    farthest = cv2.erode(np.where(depth > 0, inverse, np.float32(np.inf)), kernel)
    spread = np.divide(nearest, farthest, out=np.ones_like(inverse), where=inverse > 0) - 1
    same = np.log1p(agreeing.astype(np.float32))
    logit = (
        _BIAS
        + _MARGIN * margins
        + (_TEXTURE + _TEXTURE_SQUARED * texture) * texture
        + (_AGREEING + _AGREEING_SQUARED * same) * same
        + _NEARLY * np.log1p(nearly.astype(np.float32))
        + _SPREAD * np.log1p(100 * np.minimum(spread, _MOST_SPREAD))
    )
    probability = 1 / (1 + np.exp(-logit))
    return np.where(depth > 0, np.rint(255 * probability), 0).astype(np.uint8)


def _texture(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the mean step between pixels two apart around each pixel, (h, w) grey levels.

    Of the image as it would be at the size of those that the regression is of: the same thing has smaller
    steps in a larger image.
    """
    import cv2

    height, width = grey.shape
    smaller = min(_USUAL_PX / max(height, width), 1.0)
    size = max(round(width * smaller), 1), max(round(height * smaller), 1)
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    mean = steps(np.asarray(small, np.uint8), _TEXTURES) / _TEXTURES**2
    return np.asarray(cv2.resize(mean, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
