"""Small image-space shifts that align photos with the current texture.

Errors of poses, shape and lens displace a point by a pixel or two, differently in every photo. The mean of
such photos is blurred. The textured mesh is therefore rendered from each camera. Optical flow from the
rendering to the photo gives the shift of each pixel (Kroeger, Timofte, Dai and Van Gool 2016, "Fast optical
flow using dense inverse search"). The flow is smoothed and pulled to 0 where the image has little detail.

The idea is from Zhou and Koltun 2014, "Color map optimization for 3D reconstruction with consumer depth
cameras", section 5. Here the grid of shifts is measured directly instead of optimised.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

# float16, with a resolution of 1/100 pixel: the grids of thousands of photos take hundreds of megabytes.
Shifts = NDArray[np.float16]

# Ratios of a photo's width: maximum shift (`_MAX_SHIFT_RATIO`), standard deviation of the smoothing
# (`_SMOOTHING_RATIO`). Number of grid cells along the width (`_GRID_COLUMNS`).
_MAX_SHIFT_RATIO = 6 / 640
_SMOOTHING_RATIO = 10 / 640
_GRID_COLUMNS = 80
# Downscaling factor of the images in which the flow is smoothed: saves time, and smooth fields lose nothing.
_DOWNSCALING = 4
# Gradient descent iterations of the flow per patch. Twice as many take 1.5 times as long and do not reduce
# the error on held-out photos after smoothing. Other ways to save time produce spurious shifts.
_FLOW_ITERATIONS = 12
# Weight of the prior that pulls shifts to 0 where the image has little detail, in squared levels per pixel.
_PRIOR_WEIGHT = 20.0
# Maximum difference after the shift, in levels. Pixels that differ by more show another surface.
_MAX_DIFFERENCE = 25.0


def estimate_shifts(
    rendering: NDArray[np.uint8], mask: NDArray[np.bool_], photo: NDArray[np.uint8]
) -> Shifts:
    """Estimate the shifts from a rendering to a photo on a grid.

    Parameters
    ----------
    rendering : (h, w, 3) uint8, the textured mesh rendered from the photo's camera.
    mask : (h, w) bool, pixels of `rendering` that the mesh covers.
    photo : (h, w, 3) uint8.

    Returns
    -------
    (rows, columns, 2) float16, x and y in pixels from the rendering to the photo, at the corners of grid
    cells.
    """
    import cv2

    height, width = mask.shape
    gray_rendering, gray_photo = (
        np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8) for image in (rendering, photo)
    )
    reference = np.where(mask, gray_rendering, gray_photo)
    # One plane per axis: NumPy is slow over a last axis of length two.
    flow = cv2.split(_compute_flow(reference, gray_photo))
    residual = cv2.absdiff(_warp_image(gray_photo, flow), reference)
    smooth = cv2.GaussianBlur(reference.astype(np.float32), (0, 0), 1.0)
    detail = cv2.Sobel(smooth, cv2.CV_32F, 1, 0) ** 2 + cv2.Sobel(smooth, cv2.CV_32F, 0, 1) ** 2
    max_shift = _MAX_SHIFT_RATIO * width
    is_reliable = (
        mask & (residual < _MAX_DIFFERENCE) & (np.abs(flow[0]) < max_shift) & (np.abs(flow[1]) < max_shift)
    )
    weight = np.where(is_reliable, np.minimum(detail, 4e3), 0).astype(np.float32)
    size = (max(round(width / _DOWNSCALING), 2), max(round(height / _DOWNSCALING), 2))

    def smooth_values(values: NDArray[np.float32]) -> NDArray[np.float32]:
        smaller = cv2.resize(values, size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.GaussianBlur(smaller, (0, 0), _SMOOTHING_RATIO * size[0]), np.float32)

    total = smooth_values(weight) + np.float32(_PRIOR_WEIGHT)
    mean = cv2.merge([smooth_values(weight * image) / total for image in flow])
    columns = _GRID_COLUMNS + 1
    rows = max(round(_GRID_COLUMNS * height / width), 1) + 1
    # The outermost grid corners are at the centres of the photo's corner pixels.
    column_positions, row_positions = (
        ((np.linspace(0, of - 1, cells) + 0.5) * (smaller / of) - 0.5).astype(np.float32)
        for of, smaller, cells in ((width, size[0], columns), (height, size[1], rows))
    )
    x, y = np.meshgrid(column_positions, row_positions)
    grid = cv2.remap(mean, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.ascontiguousarray(grid.clip(-max_shift, max_shift), np.float16)


def limit_resolution(
    rendering: NDArray[np.uint8], mask: NDArray[np.bool_], photo: NDArray[np.uint8], max_pixels: int
) -> tuple[NDArray[np.uint8], NDArray[np.bool_], NDArray[np.uint8]]:
    """Downscale a rendering, its mask and a photo to at most `max_pixels` pixels.

    A pixel of the new mask is set only if the mesh covers all pixels averaged into it.

    Parameters
    ----------
    rendering, photo : (h, w, 3) uint8.
    mask : (h, w) bool, pixels of `rendering` that the mesh covers.
    max_pixels : maximum number of pixels, width × height.

    Returns
    -------
    The rendering, the mask and the photo; the inputs themselves if they are small enough.
    """
    import cv2

    height, width = mask.shape
    scale = (max_pixels / (width * height)) ** 0.5
    if scale >= 1:
        return rendering, mask, photo
    size = (max(round(width * scale), 2), max(round(height * scale), 2))
    covered = cv2.resize(mask.astype(np.uint8) * np.uint8(255), size, interpolation=cv2.INTER_AREA) == 255
    smaller = (cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (rendering, photo))
    rendering, photo = (np.asarray(image, np.uint8) for image in smaller)
    return rendering, covered, photo


def apply_shifts(photo: NDArray[np.uint8], shifts: Shifts) -> NDArray[np.uint8]:
    """Align a photo (h, w, 3) with the texture by its shifts."""
    import cv2

    height, width = photo.shape[:2]
    rows, columns = shifts.shape[:2]
    # The outermost grid corners are at the centres of the photo's corner pixels.
    x = np.broadcast_to(np.linspace(0, columns - 1, width, dtype=np.float32), (height, width))
    y = np.broadcast_to(np.linspace(0, rows - 1, height, dtype=np.float32)[:, None], (height, width))
    return _warp_image(photo, cv2.split(cv2.remap(shifts.astype(np.float32), x, y, cv2.INTER_LINEAR)))


def _warp_image(image: NDArray[np.uint8], offsets: Sequence[NDArray[Any]]) -> NDArray[np.uint8]:
    """Resample an image (h, w[, 3]) at positions displaced by (x, y) offsets in pixels."""
    import cv2

    height, width = image.shape[:2]
    x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    moved = cv2.remap(
        image, x + offsets[0], y + offsets[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(moved, np.uint8)


def _compute_flow(source: NDArray[np.uint8], target: NDArray[np.uint8]) -> NDArray[np.float32]:
    import cv2

    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    search.setGradientDescentIterations(_FLOW_ITERATIONS)
    return np.asarray(search.calc(source, target, np.zeros((*source.shape, 2), np.float32)), np.float32)
