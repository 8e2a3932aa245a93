"""Small shifts of photos that bring them where the others say they are.

Poses, shape and lens are never quite right, so a point is seen a pixel or two beside where it should be, in
every photo elsewhere, and their mean is blurred. The mesh with the texture so far is drawn from each camera;
optical flow (Kroeger, Timofte, Dai and Van Gool 2016, "Fast optical flow using dense inverse search") from it
to the photo, smoothed where there is little to see, says by how much. This is the idea of Zhou and Koltun
2014, "Color map optimization for 3D reconstruction with consumer depth cameras", section 5, with the grid of
shifts found directly.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Of thousands of photos they take hundreds of megabytes; a hundredth of a pixel is enough.
Shifts = NDArray[np.float16]

# Of a photo's width: largest shift, spread of the smoothing, and of a cell of the grid.
_MOST = 6 / 640
_SMOOTH = 10 / 640
_CELLS = 80
# It is smoothed in images that are smaller by this.
_SHARE = 4
# How often the flow of each patch is bettered. Twice as often takes half as long again, and smoothed as it is
# here, photos that were left out are met no better; other savings find shifts where there are none.
_STEPS = 12
# What holds shifts to 0 where there is little to see: squared levels a pixel.
_PRIOR = 20.0
# Differences of levels, after the shift, beyond which a pixel shows something else.
_ELSE = 25.0


def shifts_of(drawn: NDArray[np.uint8], shown: NDArray[np.bool_], photo: NDArray[np.uint8]) -> Shifts:
    """Return by how much a photo is off what is drawn, (rows, columns, 2) pixels at the corners of a grid.

    Parameters
    ----------
    drawn : (h, w, 3) uint8, the textured mesh from the photo's camera.
    shown : (h, w), where it shows the mesh.
    photo : (h, w, 3) uint8.
    """
    import cv2

    height, width = shown.shape
    there, after = (np.asarray(cv2.cvtColor(one, cv2.COLOR_RGB2GRAY), np.uint8) for one in (drawn, photo))
    before = np.where(shown, there, after)
    # A plane for each axis: NumPy is slow over a last axis of two.
    flow = cv2.split(_flow(before, after))
    rest = cv2.absdiff(_moved(after, flow), before)
    smooth = cv2.GaussianBlur(before.astype(np.float32), (0, 0), 1.0)
    detail = cv2.Sobel(smooth, cv2.CV_32F, 1, 0) ** 2 + cv2.Sobel(smooth, cv2.CV_32F, 0, 1) ** 2
    most = _MOST * width
    sound = shown & (rest < _ELSE) & (np.abs(flow[0]) < most) & (np.abs(flow[1]) < most)
    weight = np.where(sound, np.minimum(detail, 4e3), 0).astype(np.float32)
    size = (max(round(width / _SHARE), 2), max(round(height / _SHARE), 2))

    def smoothed(values: NDArray[np.float32]) -> NDArray[np.float32]:
        smaller = cv2.resize(values, size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.GaussianBlur(smaller, (0, 0), _SMOOTH * size[0]), np.float32)

    total = smoothed(weight) + np.float32(_PRIOR)
    mean = cv2.merge([smoothed(weight * one) / total for one in flow])
    columns = _CELLS + 1
    rows = max(round(_CELLS * height / width), 1) + 1
    # The corners of the grid lie in the corners of the photo, in the middle of its pixels.
    across, down = (
        ((np.linspace(0, of - 1, cells) + 0.5) * (smaller / of) - 0.5).astype(np.float32)
        for of, smaller, cells in ((width, size[0], columns), (height, size[1], rows))
    )
    x, y = np.meshgrid(across, down)
    grid = cv2.remap(mean, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.ascontiguousarray(grid.clip(-most, most), np.float16)


def no_larger(
    drawn: NDArray[np.uint8], shown: NDArray[np.bool_], photo: NDArray[np.uint8], most: int
) -> tuple[NDArray[np.uint8], NDArray[np.bool_], NDArray[np.uint8]]:
    """Return what is drawn, where it shows the mesh, and the photo, of no more than so many pixels.

    A pixel shows the mesh where all that it is a mean of does.
    """
    import cv2

    height, width = shown.shape
    share = (most / (width * height)) ** 0.5
    if share >= 1:
        return drawn, shown, photo
    size = (max(round(width * share), 2), max(round(height * share), 2))
    covered = cv2.resize(shown.astype(np.uint8) * np.uint8(255), size, interpolation=cv2.INTER_AREA) == 255
    smaller = (cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in (drawn, photo))
    drawn, photo = (np.asarray(one, np.uint8) for one in smaller)
    return drawn, covered, photo


def shifted(photo: NDArray[np.uint8], shifts: Shifts) -> NDArray[np.uint8]:
    """Return a photo (h, w, 3) as it is where the texture says that it is."""
    import cv2

    height, width = photo.shape[:2]
    rows, columns = shifts.shape[:2]
    # The corners of the grid are in the corners of the photo.
    x = np.broadcast_to(np.linspace(0, columns - 1, width, dtype=np.float32), (height, width))
    y = np.broadcast_to(np.linspace(0, rows - 1, height, dtype=np.float32)[:, None], (height, width))
    return _moved(photo, cv2.split(cv2.remap(shifts.astype(np.float32), x, y, cv2.INTER_LINEAR)))


def _moved(image: NDArray[np.uint8], by: Sequence[NDArray[Any]]) -> NDArray[np.uint8]:
    """Return an image (h, w[, 3]) of what lies so many pixels to the right and down of each pixel."""
    import cv2

    height, width = image.shape[:2]
    x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    moved = cv2.remap(image, x + by[0], y + by[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, np.uint8)


def _flow(before: NDArray[np.uint8], after: NDArray[np.uint8]) -> NDArray[np.float32]:
    import cv2

    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    search.setGradientDescentIterations(_STEPS)
    return np.asarray(search.calc(before, after, np.zeros((*before.shape, 2), np.float32)), np.float32)
