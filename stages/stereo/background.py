"""Detection of background without texture: a backdrop or a clipped sky.

A semi-global matcher fills such areas from their borders, in all views alike. Left–right and cross-view
checks therefore do not reject this depth. A plain object, such as a plaster cast, looks similar.

If the image borders have one colour in all views, this colour is the backdrop. Plain pixels of this colour
are background, up to the outline of the object, and all other pixels belong to the scene. Without a backdrop,
all plain pixels are background, including plain pixels next to an object's outline.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import ColorImage

Mask = NDArray[np.bool_]

# Window for mean differences, pixels, odd.
_WINDOW = 9
# Pixel stride for the Otsu threshold.
_STEP = 4
# Width of the image border, pixels.
_BORDER = 3
# Minimum ratio of an image's border pixels with the backdrop's colour, and of images with such a border.
_BORDER_SHARE = 0.6
_IMAGES_SHARE = 0.8
# Maximum median deviation of the borders from the backdrop's colour, grey levels.
_SPREAD = 10.0
# Tolerance of the backdrop's colour relative to the Otsu threshold between backdrop and scene, and its limits
# in grey levels. It includes light that spills over an object's outline and shaded folds of a cloth.
_SHARE = 0.5
_LEAST, _MOST = 6.0, 40.0


@dataclass(frozen=True, eq=False)
class Backdrop:
    """Uniform background around an object in all views.

    Attributes
    ----------
    color : (3,) grey levels.
    tolerance : maximum difference of any channel for pixels that match the backdrop, grey levels.
    """

    color: NDArray[np.float32]
    tolerance: float

    def alike(self, image: ColorImage) -> Mask:
        """Return a mask of pixels (…, 3) that match the backdrop's colour."""
        return np.asarray(_off(image, self.color) <= self.tolerance)


def common_backdrop(images: Sequence[ColorImage], seen: Sequence[Mask]) -> Backdrop | None:
    """Detect a backdrop from the colour of the image borders.

    Parameters
    ----------
    images : (h, w, 3) uint8, sampled views.
    seen : (h, w) each, valid pixels. Undistorted images have black, invalid areas at the border.

    Returns
    -------
    The backdrop; None if the borders have no common colour.
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
    """Segment the foreground in front of the backdrop.

    Parameters
    ----------
    image : (h, w, 3) uint8.
    least : texture threshold, as in `measurable`. Pixels of the backdrop's colour are foreground if no plain
        pixel of this colour is within a window of them.

    Returns
    -------
    (h, w) mask of the foreground.
    """
    import cv2

    alike = backdrop.alike(image)
    plain = alike & ~_textured(np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8), least)
    reached = cv2.dilate(plain.astype(np.uint8), np.ones((2 * _WINDOW + 1, 2 * _WINDOW + 1), np.uint8)) > 0
    return _without_specks(~(alike & reached))


def measurable(image: NDArray[np.uint8], least: float) -> Mask:
    """Return a mask of pixels with texture on all sides.

    Parameters
    ----------
    image : (h, w) uint8.
    least : minimum mean difference between pixels two apart (horizontally or vertically), grey levels. It
        must hold in every window that contains the pixel.
    """
    import cv2

    found = _textured(image, least).astype(np.uint8)
    return np.asarray(cv2.erode(found, np.ones((_WINDOW, _WINDOW), np.uint8)) > 0)


def steps(image: NDArray[np.uint8], window: int) -> NDArray[np.float32]:
    """Sum the local gradients in a window around each pixel.

    A gradient is the larger of the horizontal and the vertical difference between pixels two apart.

    Parameters
    ----------
    image : (h, w) uint8.
    window : width and height of the window, pixels.

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
    """Return the pixels (n, 3) at the border of the valid area."""
    import cv2

    window = np.ones((2 * _BORDER + 1, 2 * _BORDER + 1), np.uint8)
    inner = cv2.erode(seen.astype(np.uint8), window, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(image[seen & (inner == 0)])


def _off(image: ColorImage, color: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the maximum channel difference of pixels (…, 3) to a colour."""
    return np.asarray(np.abs(image - color).max(axis=-1))


def _without_specks(shown: Mask) -> Mask:
    """Remove connected components smaller than a window, which are noise."""
    import cv2

    _, label, stats, _ = cv2.connectedComponentsWithStats(shown.astype(np.uint8), connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] >= _WINDOW**2
    large[0] = False
    return np.asarray(large[label])
