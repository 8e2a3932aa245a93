"""Semi-global matching of a rectified pair, and the check of left against right.

Hirschmüller, "Stereo processing by semiglobal matching and mutual information", 2008, as OpenCV
implements it (Birchfield–Tomasi cost on horizontal gradients, parabolic sub-pixel position). Disparities
are int16 in sixteenths of a pixel here, as the matcher returns them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import MACHINE_OUT_OF_MEMORY
from scanloom.stages.diagnostics.errors import StageError

Grey = NDArray[np.uint8]
Disparity16 = NDArray[np.int16]
Mask = NDArray[np.bool_]

# The matcher's fixed point: disparities are multiples of 1/16 px.
SUBPIXELS = 16
# The largest disparity that fits into int16, and a step less: what is missing lies beyond the range.
LARGEST_DISPARITY = 2000
# The matcher takes its number of disparities in steps of this.
_STEP = 16
# The range is first looked for in images this much smaller, at a sixty-fourth of the work.
_COARSE = 4
# How far beyond the largest disparity found so the range goes on: what is small or thin is lost in
# the small images, and their disparity is known to a pixel of theirs at best.
_MARGIN_PX = 6
_MARGIN_RELATIVE = 0.05
# False matches must not widen the range to all there is: they are few, in small pieces, or where the
# image is flat.
_LARGEST_PERCENTILE = 99.8
_COARSE_PIECE = 50
_COARSE_TEXTURE = 3.0
# Texture is averaged over this many pixels each way.
_TEXTURE_WINDOW = 9


@dataclass(frozen=True)
class SearchRange:
    """Disparities that are tried, pixels: `lowest` to `lowest + count − 1`; `count` is a multiple of 16."""

    lowest: int
    count: int

    @property
    def end(self) -> int:
        """Return one more than the largest disparity."""
        return self.lowest + self.count

    @classmethod
    def covering(cls, lowest: float, highest: float) -> SearchRange:
        """Return the smallest range that holds both ends."""
        first = math.floor(lowest)
        return cls(first, max(-(-(math.ceil(highest) + 1 - first) // _STEP), 1) * _STEP)


@dataclass(frozen=True)
class Matcher:
    """Settings of the matcher, each as OpenCV's StereoSGBM has it.

    Attributes
    ----------
    mode : "3way", "hh4", "sgbm" or "hh": how many paths the costs are gathered along, and how.
    p1, p2 : penalty for a change of disparity by one pixel, and by more.
    """

    mode: str
    block_size: int
    p1: int
    p2: int
    prefilter_cap: int
    uniqueness: int

    def left(self, left: Grey, right: Grey, search: SearchRange) -> Disparity16:
        """Disparity of the left image's pixels; below `16 · search.lowest` where there is none."""
        return self._run(left, right, search.lowest, search.count, self.uniqueness)

    def right(self, left: Grey, right: Grey, search: SearchRange) -> Disparity16:
        """Disparity of the right image's pixels, negated; `−16 · search.end` where there is none."""
        return self._run(right, left, 1 - search.end, search.count, 0)

    def _run(self, image: Grey, other: Grey, lowest: int, count: int, uniqueness: int) -> Disparity16:
        import cv2

        # The matcher leaves out the columns whose search range ends beyond the image: padded by that much, it
        # answers them too, from the part of the range that is inside.
        left, right = max(lowest + count, 0), max(-lowest, 0)
        pair = [cv2.copyMakeBorder(i, 0, 0, left, right, cv2.BORDER_REPLICATE) for i in (image, other)]
        sgbm = cv2.StereoSGBM.create(
            minDisparity=lowest,
            numDisparities=count,
            blockSize=self.block_size,
            P1=self.p1,
            P2=self.p2,
            disp12MaxDiff=-1,
            preFilterCap=self.prefilter_cap,
            uniquenessRatio=uniqueness,
            speckleWindowSize=0,
            speckleRange=0,
            mode=_modes()[self.mode],
        )
        try:
            disparity = sgbm.compute(*pair)
        except cv2.error as error:
            raise StageError(
                MACHINE_OUT_OF_MEMORY,
                (
                    "a pair of {image_shape}×{image_shape_2} with {count} disparities could not "
                    "be matched ({detail}); matcher=3way needs the least memory."
                ),
                image_shape=image.shape[1],
                image_shape_2=image.shape[0],
                count=count,
                detail=error.err or error,
            ) from error
        return np.ascontiguousarray(disparity[:, left : left + image.shape[1]])


def consistency(left: Disparity16, right: Disparity16, search: SearchRange) -> NDArray[np.int16]:
    """How far each left pixel's disparity differs from that of the right pixel it points to, in 1/16 px.

    32767 where either has no match. `right` is negated, as `Matcher.right` returns it.
    """
    import cv2

    height, width = left.shape
    none = np.int16(SUBPIXELS * -search.end)
    rows = np.broadcast_to(np.arange(height, dtype=np.float32)[:, None], left.shape)
    columns = np.arange(width, dtype=np.float32) - left * np.float32(1 / SUBPIXELS)
    seen = cv2.remap(
        right,
        columns,
        np.ascontiguousarray(rows),
        cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=float(none),
    )
    residual = np.abs(left + seen)
    residual[(left < SUBPIXELS * search.lowest) | (seen <= none)] = np.iinfo(np.int16).max
    return np.asarray(residual, np.int16)


def projected(left: Disparity16, search: SearchRange, tolerance: float) -> NDArray[np.int16]:
    """Stand in for `consistency` without a match of the right image, at half the work.

    Where several left pixels claim one of the right image, the nearest surface has it; those whose disparity
    is smaller by more than `tolerance` px are hidden from the right camera: 32767, as what claims a place
    outside the right image; the others 0.
    """
    import cv2

    # Only columns from the end of the range on are looked at, hence the padding.
    before, after = max(search.end, 0), max(-search.lowest, 0)
    none = np.int16(SUBPIXELS * (search.lowest - 1))
    claims = cv2.copyMakeBorder(left, 0, 0, before, after, cv2.BORDER_CONSTANT, value=float(none))
    cv2.validateDisparity(claims, np.negative(claims), search.lowest, search.count, round(tolerance))
    width = left.shape[1]
    columns = SUBPIXELS * np.arange(width, dtype=np.int32) - left
    inside = (columns >= 0) & (columns <= SUBPIXELS * (width - 1))
    kept = inside & (claims[:, before : before + width] != none)
    return np.asarray(np.where(kept, 0, np.iinfo(np.int16).max), np.int16)


def matched_pixels(
    disparity: Disparity16,
    residual: NDArray[np.int16],
    search: SearchRange,
    *,
    tolerance: float,
    speckle_size: int,
    speckle_range: float,
) -> Mask:
    """Return the pixels whose residual is within `tolerance` px, in connected pieces that are no speckles.

    Pieces of fewer than `speckle_size` pixels are; pixels whose disparities differ by more than
    `speckle_range` px are not connected.
    """
    import cv2

    none = SUBPIXELS * (search.lowest - 1)
    pieces = np.where(residual <= round(SUBPIXELS * tolerance), disparity, np.int16(none))
    if speckle_size > 1:
        cv2.filterSpeckles(pieces, none, speckle_size - 1, round(SUBPIXELS * speckle_range))
    return np.asarray(pieces != none)


def textured(image: Grey, least: float) -> Mask:
    """Return where pixels two apart in a row differ by at least so many grey levels, in the mean around."""
    import cv2

    difference = np.abs(cv2.Sobel(image, cv2.CV_16S, 1, 0, ksize=1))
    total = cv2.boxFilter(difference, cv2.CV_32F, (_TEXTURE_WINDOW, _TEXTURE_WINDOW), normalize=False)
    return np.asarray(total >= least * _TEXTURE_WINDOW**2)


def narrowed(left: Grey, right: Grey, search: SearchRange, matcher: Matcher) -> SearchRange:
    """Return the part of a range that the pair uses, found by matching it at a quarter of its size.

    The lower end stays. Where too little matches, so does the upper one.
    """
    import cv2

    size = (left.shape[1] // _COARSE, left.shape[0] // _COARSE)
    coarse = SearchRange.covering(search.lowest / _COARSE, search.end / _COARSE)
    if min(size) <= matcher.block_size or coarse.count <= _STEP:
        return search
    first, second = (
        np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8) for image in (left, right)
    )
    disparity = matcher.left(first, second, coarse)
    residual = consistency(disparity, matcher.right(first, second, coarse), coarse)
    matched = matched_pixels(
        disparity, residual, coarse, tolerance=1, speckle_size=_COARSE_PIECE, speckle_range=1
    )
    # A clear sky matches itself at any disparity.
    found = disparity[matched & textured(first, _COARSE_TEXTURE)]
    if found.size < _COARSE_PIECE:
        return search
    largest = float(np.percentile(found, _LARGEST_PERCENTILE)) * _COARSE / SUBPIXELS
    needed = SearchRange.covering(
        search.lowest, largest + _MARGIN_PX + _MARGIN_RELATIVE * (largest - search.lowest)
    )
    return replace(needed, count=min(needed.count, search.count))


def _modes() -> dict[str, Any]:
    import cv2

    return {
        "3way": cv2.StereoSGBM_MODE_SGBM_3WAY,
        "hh4": cv2.StereoSGBM_MODE_HH4,
        "sgbm": cv2.StereoSGBM_MODE_SGBM,
        "hh": cv2.StereoSGBM_MODE_HH,
    }
