"""Semi-global matching of rectified pairs with OpenCV, and the left–right check.

Hirschmüller, "Stereo processing by semiglobal matching and mutual information", 2008, as OpenCV implements it
(Birchfield–Tomasi cost on horizontal gradients, parabolic sub-pixel position). Disparities are int16 in
sixteenths of a pixel, as OpenCV returns them.
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

# Fixed point of OpenCV: disparities are multiples of 1/16 px.
SUBPIXELS = 16
# Maximum disparity whose fixed point fits int16, with one step left for the marker of missing values.
LARGEST_DISPARITY = 2000
# OpenCV requires a multiple of this number of disparities.
_DISPARITY_STEP = 16
# Downscaling factor for narrowing the search range; it takes 1/64 of the work.
_COARSE_FACTOR = 4
# Margin beyond the maximum disparity of the downscaled pair: small or thin objects may be missing there, and
# its disparities are accurate to one downscaled pixel at best.
_MARGIN_PX = 6
_MARGIN_RATIO = 0.05
# Filters against false matches, which would widen the range: they are few, in small components, or in plain
# areas.
_LARGEST_PERCENTILE = 99.8
_COARSE_MIN_COMPONENT_PX = 50
_COARSE_MIN_TEXTURE = 3.0
# Window for mean texture, pixels.
_TEXTURE_WINDOW = 9


@dataclass(frozen=True)
class SearchRange:
    """Disparity search range, pixels.

    Attributes
    ----------
    lowest : smallest disparity.
    count : number of disparities, a multiple of 16.
    """

    lowest: int
    count: int

    @property
    def end(self) -> int:
        """Return the exclusive upper end of the range."""
        return self.lowest + self.count

    @classmethod
    def from_bounds(cls, lowest: float, highest: float) -> SearchRange:
        """Create the smallest range that contains both ends."""
        first = math.floor(lowest)
        return cls(first, max(-(-(math.ceil(highest) + 1 - first) // _DISPARITY_STEP), 1) * _DISPARITY_STEP)


@dataclass(frozen=True)
class OpenCVMatcher:
    """Settings of OpenCV's StereoSGBM.

    Attributes
    ----------
    mode : "3way", "hh4", "sgbm" or "hh": number of aggregation paths and memory layout.
    block_size : width of the matched blocks, pixels.
    p1, p2 : penalty for a change of disparity by one pixel, and by more.
    prefilter_cap : clipping limit of the horizontal gradients, grey levels.
    uniqueness : margin by which the best match must beat every other, per cent.
    """

    mode: str
    block_size: int
    p1: int
    p2: int
    prefilter_cap: int
    uniqueness: int

    def match_left(self, left: Grey, right: Grey, search: SearchRange) -> Disparity16:
        """Compute the disparity of the left image, 1/16 px.

        Values below `16 · search.lowest` are missing.
        """
        return self._run(left, right, search.lowest, search.count, self.uniqueness)

    def match_right(self, left: Grey, right: Grey, search: SearchRange) -> Disparity16:
        """Compute the negated disparity of the right image, 1/16 px.

        The value `−16 · search.end` is missing.
        """
        return self._run(right, left, 1 - search.end, search.count, 0)

    def _run(self, image: Grey, other: Grey, lowest: int, count: int, uniqueness: int) -> Disparity16:
        import cv2

        # OpenCV skips columns whose search range ends outside the image. Padding by the range matches these
        # columns, too, within the part of the range that is inside.
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
            mode=_map_opencv_modes()[self.mode],
        )
        try:
            disparity = sgbm.compute(*pair)
        except cv2.error as error:
            raise StageError(
                MACHINE_OUT_OF_MEMORY,
                (
                    "a pair of {image_shape}×{image_shape_2} px with {count} disparities cannot be matched "
                    "({detail}); matcher=3way needs less memory than the other modes."
                ),
                image_shape=image.shape[1],
                image_shape_2=image.shape[0],
                count=count,
                detail=error.err or error,
            ) from error
        return np.ascontiguousarray(disparity[:, left : left + image.shape[1]])


def compute_left_right_residual(
    left: Disparity16, right: Disparity16, search: SearchRange
) -> NDArray[np.int16]:
    """Return the left–right residual of each left pixel, 1/16 px.

    The residual is the difference between the pixel's disparity and the disparity of its match in the right
    image. It is 32767 where either is missing. `match_right` is negated, as `OpenCVMatcher.match_right`
    returns it.
    """
    import cv2

    height, width = left.shape
    none = np.int16(SUBPIXELS * -search.end)
    rows = np.broadcast_to(np.arange(height, dtype=np.float32)[:, None], left.shape)
    columns = np.arange(width, dtype=np.float32) - left * np.float32(1 / SUBPIXELS)
    right_at_match = cv2.remap(
        right,
        columns,
        np.ascontiguousarray(rows),
        cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=float(none),
    )
    residual = np.abs(left + right_at_match)
    residual[(left < SUBPIXELS * search.lowest) | (right_at_match <= none)] = np.iinfo(np.int16).max
    return np.asarray(residual, np.int16)


def approximate_left_right_residual(
    left: Disparity16, search: SearchRange, tolerance: float
) -> NDArray[np.int16]:
    """Approximate `compute_left_right_residual` without matching the right image.

    This halves the work. If several left pixels map to one right pixel, the nearest surface wins. Pixels
    whose disparity is smaller by more than `tolerance` px are occluded in the right image.

    Returns
    -------
    (h, w) int16; 0 for visible pixels, 32767 for occluded pixels and for matches outside the right image.
    """
    import cv2

    # OpenCV ignores columns below the end of the range, hence the padding.
    before, after = max(search.end, 0), max(-search.lowest, 0)
    none = np.int16(SUBPIXELS * (search.lowest - 1))
    claims = cv2.copyMakeBorder(left, 0, 0, before, after, cv2.BORDER_CONSTANT, value=float(none))
    cv2.validateDisparity(claims, np.negative(claims), search.lowest, search.count, round(tolerance))
    width = left.shape[1]
    columns = SUBPIXELS * np.arange(width, dtype=np.int32) - left
    inside = (columns >= 0) & (columns <= SUBPIXELS * (width - 1))
    kept = inside & (claims[:, before : before + width] != none)
    return np.asarray(np.where(kept, 0, np.iinfo(np.int16).max), np.int16)


def mask_matched_pixels(
    disparity: Disparity16,
    residual: NDArray[np.int16],
    search: SearchRange,
    *,
    tolerance: float,
    speckle_size: int,
    speckle_range: float,
) -> Mask:
    """Return a mask of pixels that pass left–right check and speckle filter.

    Parameters
    ----------
    residual : (h, w) int16, 1/16 px, as returned by `compute_left_right_residual`.
    tolerance : maximum residual, pixels.
    speckle_size : connected components with fewer pixels are removed.
    speckle_range : neighbours whose disparities differ by more are not connected, pixels.
    """
    import cv2

    none = SUBPIXELS * (search.lowest - 1)
    pieces = np.where(residual <= round(SUBPIXELS * tolerance), disparity, np.int16(none))
    if speckle_size > 1:
        cv2.filterSpeckles(pieces, none, speckle_size - 1, round(SUBPIXELS * speckle_range))
    return np.asarray(pieces != none)


def mask_textured_pixels(image: Grey, min_texture: float) -> Mask:
    """Return a mask of pixels with enough horizontal texture.

    Parameters
    ----------
    min_texture : minimum mean difference between pixels two apart in a row, grey levels.
    """
    import cv2

    difference = np.abs(cv2.Sobel(image, cv2.CV_16S, 1, 0, ksize=1))
    total = cv2.boxFilter(difference, cv2.CV_32F, (_TEXTURE_WINDOW, _TEXTURE_WINDOW), normalize=False)
    return np.asarray(total >= min_texture * _TEXTURE_WINDOW**2)


def narrow_search_range(left: Grey, right: Grey, search: SearchRange, matcher: OpenCVMatcher) -> SearchRange:
    """Narrow a search range to the disparities that a pair uses.

    The pair is matched at a quarter of its size. Only the upper end changes. It stays as well if too few
    pixels match.
    """
    import cv2

    size = (left.shape[1] // _COARSE_FACTOR, left.shape[0] // _COARSE_FACTOR)
    coarse = SearchRange.from_bounds(search.lowest / _COARSE_FACTOR, search.end / _COARSE_FACTOR)
    if min(size) <= matcher.block_size or coarse.count <= _DISPARITY_STEP:
        return search
    first, second = (
        np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8) for image in (left, right)
    )
    disparity = matcher.match_left(first, second, coarse)
    residual = compute_left_right_residual(disparity, matcher.match_right(first, second, coarse), coarse)
    matched = mask_matched_pixels(
        disparity, residual, coarse, tolerance=1, speckle_size=_COARSE_MIN_COMPONENT_PX, speckle_range=1
    )
    # A clear sky matches at any disparity.
    found = disparity[matched & mask_textured_pixels(first, _COARSE_MIN_TEXTURE)]
    if found.size < _COARSE_MIN_COMPONENT_PX:
        return search
    largest = float(np.percentile(found, _LARGEST_PERCENTILE)) * _COARSE_FACTOR / SUBPIXELS
    needed = SearchRange.from_bounds(
        search.lowest, largest + _MARGIN_PX + _MARGIN_RATIO * (largest - search.lowest)
    )
    return replace(needed, count=min(needed.count, search.count))


def _map_opencv_modes() -> dict[str, Any]:
    import cv2

    return {
        "3way": cv2.StereoSGBM_MODE_SGBM_3WAY,
        "hh4": cv2.StereoSGBM_MODE_HH4,
        "sgbm": cv2.StereoSGBM_MODE_SGBM,
        "hh": cv2.StereoSGBM_MODE_HH,
    }
