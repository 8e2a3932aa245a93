"""Side-by-side stereo images, as ZED and many USB cameras record them.

Both views of a pair are the halves of one image.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._opencv import require_opencv
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import decode_color, read_image_bytes, read_image_size
from scanloom.stages.scans.model.scan import PackedImage

# Width / height of the whole image: from two 5:4 images to two 16:9 images.
_ASPECT_RATIO_RANGE = (2.4, 3.7)
# Minimum median correlation between the two halves. Real pairs reach 0.8 (0.6 if a calibration board fills
# the image); ordinary street photos reach at most 0.56.
_MIN_CORRELATION = 0.62
_SAMPLE_COUNT = 7
# Width of each half for the comparison, pixels; and maximum disparity as a ratio of that width.
_COMPARED_WIDTH_PX, _MAX_DISPARITY_RATIO = 96, 0.25


def is_side_by_side(paths: Sequence[Path]) -> bool:
    """Return True if images are side-by-side stereo pairs.

    A sample is tested: the aspect ratio must fit two images, and the two halves must correlate.
    """
    some = paths[:: max(1, len(paths) // _SAMPLE_COUNT)]
    try:
        shapes = [width / height for width, height in map(read_image_size, some)]
        if not shapes or not all(
            _ASPECT_RATIO_RANGE[0] <= shape <= _ASPECT_RATIO_RANGE[1] for shape in shapes
        ):
            return False
        return float(np.median([_correlate_halves(_read_image(path)) for path in some])) >= _MIN_CORRELATION
    except InputError:
        return False


def split_halves(path: Path) -> tuple[PackedImage, PackedImage]:
    """Return the left and right image of a side-by-side pair.

    Both are decoded on demand.
    """
    return PackedImage(path, "left half", partial(_read_half, path, 0)), PackedImage(
        path, "right half", partial(_read_half, path, 1)
    )


def _read_image(path: Path) -> NDArray[np.uint8]:
    return decode_color(read_image_bytes(path), path)


def _read_half(path: Path, side: int) -> NDArray[np.uint8]:
    image = _read_image(path)
    width = image.shape[1] // 2
    return np.ascontiguousarray(image[:, side * width : (side + 1) * width])


def _correlate_halves(image: NDArray[np.uint8]) -> float:
    """Return the maximum correlation between the two halves of an image.

    The centre of the left half is searched in the right half.
    """
    require_opencv()
    import cv2

    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    width = gray.shape[1] // 2
    small = [
        cv2.resize(
            gray[:, at : at + width],
            (_COMPARED_WIDTH_PX, _COMPARED_WIDTH_PX * 3 // 4),
            interpolation=cv2.INTER_AREA,
        )
        for at in (0, width)
    ]
    margin = int(_COMPARED_WIDTH_PX * _MAX_DISPARITY_RATIO)
    # Search four rows up and down as well: cameras are rarely mounted perfectly level.
    found = cv2.matchTemplate(small[1], small[0][4:-4, margin:-margin], cv2.TM_CCOEFF_NORMED)
    return float(np.nan_to_num(found).max())
