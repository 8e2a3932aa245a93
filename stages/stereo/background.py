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
_TEXTURE_WINDOW = 9
# Pixel stride for the Otsu threshold.
_PIXEL_STRIDE = 4
# Width of the image border, pixels.
_BORDER_WIDTH = 3
# Minimum ratio of an image's border pixels with the backdrop's colour, and of images with such a border.
_MIN_BORDER_RATIO = 0.6
_MIN_IMAGE_RATIO = 0.8
# Maximum median deviation of the borders from the backdrop's colour, grey levels.
_MAX_BORDER_DEVIATION = 10.0
# Tolerance of the backdrop's colour relative to the Otsu threshold between backdrop and scene, and its limits
# in grey levels. It includes light that spills over an object's outline and shaded folds of a cloth.
_TOLERANCE_RATIO = 0.5
_MIN_TOLERANCE, _MAX_TOLERANCE = 6.0, 40.0


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

    def match_pixels(self, image: ColorImage) -> Mask:
        """Return a mask of pixels (…, 3) that match the backdrop's colour."""
        return np.asarray(_compute_channel_difference(image, self.color) <= self.tolerance)


def detect_backdrop(images: Sequence[ColorImage], valid_masks: Sequence[Mask]) -> Backdrop | None:
    """Detect a backdrop from the colour of the image borders.

    Parameters
    ----------
    images : (h, w, 3) uint8, sampled views.
    valid_masks : (h, w) each, valid pixels. Undistorted images have black, invalid areas at the border.

    Returns
    -------
    The backdrop; None if the borders have no common colour.
    """
    import cv2

    borders = [border for border in map(_select_border_pixels, images, valid_masks) if len(border)]
    if not borders:
        return None
    color = np.median([np.median(border, axis=0) for border in borders], axis=0).astype(np.float32)
    if (
        np.median(np.concatenate([_compute_channel_difference(border, color) for border in borders]))
        > _MAX_BORDER_DEVIATION
    ):
        return None
    differences = np.concatenate(
        [
            _compute_channel_difference(
                image[::_PIXEL_STRIDE, ::_PIXEL_STRIDE][shown[::_PIXEL_STRIDE, ::_PIXEL_STRIDE]], color
            )
            for image, shown in zip(images, valid_masks, strict=True)
        ]
    )
    otsu_threshold, _ = cv2.threshold(
        differences.astype(np.uint8)[None], 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU
    )
    found = Backdrop(color, float(np.clip(_TOLERANCE_RATIO * otsu_threshold, _MIN_TOLERANCE, _MAX_TOLERANCE)))
    is_like = [np.mean(found.match_pixels(border)) >= _MIN_BORDER_RATIO for border in borders]
    return found if np.mean(is_like) >= _MIN_IMAGE_RATIO else None


def segment_foreground(image: ColorImage, backdrop: Backdrop, min_texture: float) -> Mask:
    """Segment the foreground in front of the backdrop.

    Parameters
    ----------
    image : (h, w, 3) uint8.
    min_texture : texture threshold, as in `mask_textured_surroundings`. Pixels of the backdrop's colour are
        foreground if no plain
        pixel of this colour is within a window of them.

    Returns
    -------
    (h, w) mask of the foreground.
    """
    import cv2

    alike = backdrop.match_pixels(image)
    plain = alike & ~_mask_textured(
        np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8), min_texture
    )
    reached = (
        cv2.dilate(
            plain.astype(np.uint8), np.ones((2 * _TEXTURE_WINDOW + 1, 2 * _TEXTURE_WINDOW + 1), np.uint8)
        )
        > 0
    )
    return _remove_small_components(~(alike & reached))


def mask_textured_surroundings(image: NDArray[np.uint8], min_texture: float) -> Mask:
    """Return a mask of pixels with texture on all sides.

    Parameters
    ----------
    image : (h, w) uint8.
    min_texture : minimum mean difference between pixels two apart (horizontally or vertically), grey levels.
        It
        must hold in every window that contains the pixel.
    """
    import cv2

    found = _mask_textured(image, min_texture).astype(np.uint8)
    return np.asarray(cv2.erode(found, np.ones((_TEXTURE_WINDOW, _TEXTURE_WINDOW), np.uint8)) > 0)


def sum_gradients(image: NDArray[np.uint8], window: int) -> NDArray[np.float32]:
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


def _mask_textured(image: NDArray[np.uint8], min_texture: float) -> Mask:
    return np.asarray(sum_gradients(image, _TEXTURE_WINDOW) >= min_texture * _TEXTURE_WINDOW**2)


def _select_border_pixels(image: ColorImage, valid: Mask) -> ColorImage:
    """Return the pixels (n, 3) at the border of the valid area."""
    import cv2

    window = np.ones((2 * _BORDER_WIDTH + 1, 2 * _BORDER_WIDTH + 1), np.uint8)
    inner = cv2.erode(valid.astype(np.uint8), window, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(image[valid & (inner == 0)])


def _compute_channel_difference(image: ColorImage, color: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the maximum channel difference of pixels (…, 3) to a colour."""
    return np.asarray(np.abs(image - color).max(axis=-1))


def _remove_small_components(mask: Mask) -> Mask:
    """Remove connected components smaller than a window, which are noise."""
    import cv2

    _, label, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] >= _TEXTURE_WINDOW**2
    large[0] = False
    return np.asarray(large[label])
