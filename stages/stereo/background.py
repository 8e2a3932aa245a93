"""Where a view shows nothing that could be matched: a backdrop, a clipped sky.

A semi-global matcher fills such places from their rims, in every view alike, so that neither left against
right nor view against view finds out. Plain they are, but so is a thing of plaster. Where the borders of the
images have one colour in all views, what is plain and like it is the backdrop, up to the rim of what stands
before it, and everything else is the scene, however plain. Else all that is plain is taken for background;
the objects' rims must not shield what lies beside them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import ColorImage

Mask = NDArray[np.bool_]

# Differences are averaged over so many pixels each way, odd.
_WINDOW = 9
# Of the images one in so many pixels each way is looked at, for what is dark and what is bright.
_STEP = 4
# The outermost pixels, so many deep, are an image's border.
_BORDER = 3
# Of the border of most images at least this share must look like the backdrop.
_BORDER_SHARE = 0.6
_IMAGES_SHARE = 0.8
# The border spreads about the backdrop's colour by no more than this, grey levels: else there is none.
_SPREAD = 10.0
# What differs from it by less than this share of what tells dark from bright in the differences (Otsu) looks
# like it: light that spills over the rim of a thing, a cloth in the shade; but in these bounds, grey levels.
_SHARE = 0.5
_LEAST, _MOST = 6.0, 40.0


@dataclass(frozen=True, eq=False)
class Backdrop:
    """What a thing stands before in all views.

    Attributes
    ----------
    color : (3,) grey levels.
    tolerance : a pixel none of whose channels differs by more looks like it, grey levels.
    """

    color: NDArray[np.float32]
    tolerance: float

    def alike(self, image: ColorImage) -> Mask:
        """Return which pixels (…) of an image (…, 3) look like the backdrop."""
        return np.asarray(_off(image, self.color) <= self.tolerance)


def common_backdrop(images: Sequence[ColorImage], seen: Sequence[Mask]) -> Backdrop | None:
    """Return the backdrop of views, by the colour that the borders of nearly all have; None if there is none.

    Parameters
    ----------
    images : (h, w, 3) uint8, some of the views.
    seen : (h, w) each, what of them shows anything. Where lens distortion was removed, black may lie around
        what the camera saw; it is no backdrop.
    """
    import cv2

    borders = [border for border in map(_border, images, seen) if len(border)]
    if not borders:
        return None
    color = np.median([np.median(border, axis=0) for border in borders], axis=0).astype(np.float32)
    if np.median(np.concatenate([_off(border, color) for border in borders])) > _SPREAD:
        return None
    off = np.concatenate(
        [
            _off(image[::_STEP, ::_STEP][shown[::_STEP, ::_STEP]], color)
            for image, shown in zip(images, seen, strict=True)
        ]
    )
    dividing, _ = cv2.threshold(off.astype(np.uint8)[None], 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    found = Backdrop(color, float(np.clip(_SHARE * dividing, _LEAST, _MOST)))
    like = [np.mean(found.alike(border)) >= _BORDER_SHARE for border in borders]
    return found if np.mean(like) >= _IMAGES_SHARE else None


def before_backdrop(image: ColorImage, backdrop: Backdrop, least: float) -> Mask:
    """Return where an image (h, w, 3) shows what stands before the backdrop.

    Parameters
    ----------
    least : as of `measurable`; what is like the backdrop but farther than a window from all that is so plain
        belongs to the scene.
    """
    import cv2

    alike = backdrop.alike(image)
    plain = alike & ~_textured(np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8), least)
    reached = cv2.dilate(plain.astype(np.uint8), np.ones((2 * _WINDOW + 1, 2 * _WINDOW + 1), np.uint8)) > 0
    return _without_specks(~(alike & reached))


def measurable(image: NDArray[np.uint8], least: float) -> Mask:
    """Return where an image has texture all around.

    Parameters
    ----------
    image : (h, w) uint8.
    least : grey levels by which pixels two apart, across or down, must differ in the mean of every window
        that holds the pixel.
    """
    import cv2

    found = _textured(image, least).astype(np.uint8)
    return np.asarray(cv2.erode(found, np.ones((_WINDOW, _WINDOW), np.uint8)) > 0)


def steps(image: NDArray[np.uint8], window: int) -> NDArray[np.float32]:
    """Return the sum over the window around each pixel of how much pixels two apart differ, across or down.

    Parameters
    ----------
    image : (h, w) uint8.
    window : px, its width and height.

    Returns
    -------
    (h, w) float32, grey levels.
    """
    import cv2

    across = np.abs(cv2.Sobel(image, cv2.CV_16S, 1, 0, ksize=1))
    down = np.abs(cv2.Sobel(image, cv2.CV_16S, 0, 1, ksize=1))
    total = cv2.boxFilter(
        np.maximum(across, down),
        cv2.CV_32F,
        (window, window),
        normalize=False,
        borderType=cv2.BORDER_REFLECT,
    )
    return np.asarray(total, np.float32)


def _textured(image: NDArray[np.uint8], least: float) -> Mask:
    return np.asarray(steps(image, _WINDOW) >= least * _WINDOW**2)


def _border(image: ColorImage, seen: Mask) -> ColorImage:
    """Return the outermost pixels of what an image shows, (n, 3)."""
    import cv2

    window = np.ones((2 * _BORDER + 1, 2 * _BORDER + 1), np.uint8)
    inner = cv2.erode(seen.astype(np.uint8), window, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(image[seen & (inner == 0)])


def _off(image: ColorImage, color: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return by how many grey levels pixels (…, 3) differ from a colour, at most of the channels."""
    return np.asarray(np.abs(image - color).max(axis=-1))


def _without_specks(shown: Mask) -> Mask:
    """Return a mask without connected pieces smaller than a window: what is left of noise is no thing."""
    import cv2

    _, label, stats, _ = cv2.connectedComponentsWithStats(shown.astype(np.uint8), connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] >= _WINDOW**2
    large[0] = False
    return np.asarray(large[label])
