"""How sure the depth of a view among others is: a probability, of what the sweep and other views say."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import DepthImage
from scanloom.stages.stereo.agreement import Said
from scanloom.stages.stereo.background import steps
from scanloom.stages.stereo.plane_sweep import HALF_MARGIN

Map = NDArray[np.float32]

# The logistic regression of being right within 5 % of the depth, fitted to 58 views with depth of a sensor
# and adjusted poses: a third of 7-Scenes' red kitchen and a box on a table, as many pixels of each. Second
# numbers are of the sign's square.
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
# Windows over which margins, texture and spread are gathered, px.
_MARGINS, _TEXTURES, _AROUND = 9, 15, 5
# The least texture of any window so wide that holds the pixel: beside an edge it is that of the plainer side,
# which may be drawn along with what the edge is of.
_SIDES = 9
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
    said: Said,
    is_outlined: bool = False,
) -> NDArray[np.uint8]:
    """Return 255 times the probability that depth is right within 5 %; 0 where there is none.

    Parameters
    ----------
    depth : (h, w) float32 metres.
    distinct : (h, w) uint8, 255 times that of the sweep.
    grey : (h, w) uint8, the image.
    said : what other views say. Of those that look there, the more agree, the surer; few may look there.
    is_outlined : the view's depth is that of a thing that is told from what is behind it. A plain place of a
        thing lies on it, where a plain background may lie anywhere.
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
    """Return what the probability is made of, (h, w) each."""
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
    """Return by how much inverse depth differs around each pixel: the logarithm of one more than per cent."""
    import cv2

    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    kernel = np.ones((_AROUND, _AROUND), np.uint8)
    # What has no depth is neither the nearest nor the farthest around.
    nearest = cv2.dilate(inverse, kernel)
    farthest = cv2.erode(np.where(depth > 0, inverse, np.float32(np.inf)), kernel)
    share = np.divide(nearest, farthest, out=np.ones_like(inverse), where=inverse > 0) - 1
    return np.asarray(np.log1p(100 * np.minimum(share, _MOST_SPREAD)), np.float32)


def _texture(grey: NDArray[np.uint8]) -> tuple[Map, Map]:
    """Return the mean step between pixels two apart around each pixel, and of its plainest side, grey levels.

    Of the image as it would be at the size of those that the regression is of: the same thing has smaller
    steps in a larger image.
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
