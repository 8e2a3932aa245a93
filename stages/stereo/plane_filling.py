"""Filling of textureless planar patches from measured depth around them.

Areas without texture match anything and are not measured, but floors, walls and table tops are flat. Each
connected patch of the photo without gradients is assumed to be one surface. The inverse depth of a plane is
linear in image coordinates. A plane is fitted by RANSAC (Fischler and Bolles, 1981) to reliable depth in the
patch and at its border.

The plane fills pixels only between measured depth, where it is well determined. Filled depth of other views
must agree, and their measured depth must not contradict. Similar planes guide PatchMatch in ACMP (Xu and Tao,
"Planar prior assisted PatchMatch multi-view stereo", 2020), which requires no such agreement.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial, reduce
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.scans.model.prefetch import map_ordered
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Scan, SkippedFrame
from scanloom.stages.scans.model.threads import get_thread_count
from scanloom.stages.stereo.depth_filling import restore_and_fill, strip_images
from scanloom.stages.stereo.depth_map import DepthMap
from scanloom.stages.stereo.depth_map_store import DepthMapStore
from scanloom.stages.stereo.params import DepthParams
from scanloom.stages.stereo.posed_views import PosedView

Mask = NDArray[np.bool_]
# Projection matrix (3, 4) from pixels to another view, and the depth map of that view.
_ProjectedMap = tuple[NDArray[np.float64], DepthImage]
Numbers = NDArray[np.float64]

# Maximum gradient of a plain pixel in any channel, grey levels per pixel, after a blur of one pixel.
_MAX_PLAIN_GRADIENT = 3.0
# Minimum patch area relative to the image; margin around a patch for depth, px, because edges displace depth.
_MIN_PATCH_RATIO, _PATCH_MARGIN_PX = 1e-3, 3
# Minimum confidence of 255 for fitting planes. Less certain depth next to plain areas belongs to nearer
# objects.
_MIN_CONFIDENCE = 230
# Depth is averaged in squares of this side, px, with at least this number of valid pixels; neighbouring
# pixels share their noise.
_SQUARE_SIDE_PX, _MIN_SQUARE_PIXELS = 8, 6
# Minimum number of inlier squares, their minimum ratio, and the relative inlier distance in depth.
_MIN_SQUARES, _MIN_INLIER_RATIO, _INLIER_TOLERANCE = 12, 0.6, 0.01
# Squares this far behind the plane, relative to depth, may be at most this ratio of all: the border of a
# surface is its own edge or an object in front.
_BEHIND_TOLERANCE, _MAX_BEHIND_RATIO = 0.03, 0.05
_RANSAC_SAMPLES = 120
# Maximum variance of the plane's depth relative to the variance of a square.
_MAX_LEVERAGE = 0.3
# Relative differences of depth between views: maximum for agreement, and for no contradiction.
_TOLERANCE, _LOOSE_TOLERANCE = 0.02, 0.04


def fill_from_planes(
    depth_maps: Iterator[DepthMap | SkippedFrame],
    scan: Scan,
    views: Sequence[PosedView],
    checked_views: Sequence[Sequence[int]],
    crop_depth: Callable[[int, DepthImage], DepthImage],
    params: DepthParams,
    folder: Path,
    progress: Callable[[int], object],
) -> Iterator[DepthMap | SkippedFrame]:
    """Fill depth maps of all views from planes.

    Parameters
    ----------
    depth_maps : depth maps after the consistency check, in the order of the views.
    scan, views : frames and posed views.
    checked_views : for each view, indices of the views that its depth is checked against.
    crop_depth : function from view index and depth to the depth inside the mask, box and hull.
    params : parameters of the depth stage.
    folder : folder for maps while not all of them are checked.
    progress : called with the number of checked maps.

    Returns
    -------
    Iterator over the filled maps in the order of the views.
    """
    measured, whole = DepthMapStore(folder / "measured"), DepthMapStore(folder / "whole")

    def store_map(numbered: tuple[int, DepthMap | SkippedFrame]) -> DepthMap | SkippedFrame:
        at, one = numbered
        if isinstance(one, SkippedFrame):
            return one
        told = crop_depth(at, compute_plane_depth(one.depth, one.confidence, one.color, seed=at))
        measured.store(at, one.depth, one.confidence)
        whole.store(at, np.where(one.depth > 0, one.depth, told), one.confidence)
        return strip_images(one)

    threads = params.threads or get_thread_count()
    rest: list[DepthMap | SkippedFrame] = []
    for kept in map_ordered(store_map, enumerate(depth_maps), threads=threads, max_pending=threads):
        rest.append(kept)
        progress(len(rest))

    def compute_depths(at: int, _: ColorImage) -> tuple[DepthImage, NDArray[np.uint8], DepthImage]:
        depth = measured.load_depth(at)
        told = np.where(depth > 0, np.float32(0), whole.load_depth(at))
        others = [other for other in checked_views[at] if isinstance(rest[other], DepthMap)]
        ways = [views[at].compute_projection_to(views[other]) for other in others]
        all_told, all_measured = (
            list(zip(ways, map(maps.load_depth, others), strict=True)) for maps in (whole, measured)
        )
        told[~_mask_confirmed(told, all_told, all_measured, params.min_consistent_views)] = 0
        return depth, measured.load_confidence(at), told

    yield from restore_and_fill(rest, scan.frames, compute_depths, threads)


def _mask_confirmed(
    filled_depth: DepthImage,
    filled_maps: Sequence[_ProjectedMap],
    measured_maps: Sequence[_ProjectedMap],
    min_view_count: int,
) -> Mask:
    """Return a mask (h, w) of filled depth that other views confirm.

    Parameters
    ----------
    filled_depth : (h, w) filled depth, metres.
    filled_maps, measured_maps : other views with their filled, and only measured, depth.
    min_view_count : minimum number of agreeing views. Measured depth may contradict in no more views than
        agree.
    """
    count = partial(
        _kernels.count_supporting_views,
        filled_depth,
        tolerances=(_TOLERANCE, _LOOSE_TOLERANCE),
        min_depth_ratio=0.0,
        wanted_threads=1,
    )
    same, *_ = count(filled_maps)
    _, nearly, _, looking = count(measured_maps)
    return np.asarray(
        (filled_depth > 0) & (same >= min_view_count) & (looking.astype(int) - nearly <= nearly)
    )


def compute_plane_depth(
    depth: DepthImage, confidence: NDArray[np.uint8], color: ColorImage, *, seed: int = 0
) -> DepthImage:
    """Compute depth of unmeasured pixels in plain patches from planes.

    Parameters
    ----------
    depth : (h, w) float32 metres, 0 where not measured.
    confidence : (h, w) uint8, 255 times the probability that depth is right.
    color : (h, w, 3) uint8 RGB, undistorted.
    seed : seed of the random samples.

    Returns
    -------
    (h, w) float32 metres; 0 at measured pixels and where no plane was found.
    """
    import cv2

    height, width = depth.shape
    filled_depth = np.zeros_like(depth)
    is_reliable = (depth > 0) & (confidence >= _MIN_CONFIDENCE)
    _, patches, stats, _ = cv2.connectedComponentsWithStats(_is_plain(color).astype(np.uint8), connectivity=4)
    random = np.random.default_rng(seed)
    window = np.ones((2 * _PATCH_MARGIN_PX + 1, 2 * _PATCH_MARGIN_PX + 1), np.uint8)
    areas = stats[1:, cv2.CC_STAT_AREA]
    for patch in 1 + np.flatnonzero(areas >= _MIN_PATCH_RATIO * height * width):
        left, top, wide, high = (int(value) for value in stats[patch, :4])
        rows = slice(max(0, top - _PATCH_MARGIN_PX), top + high + _PATCH_MARGIN_PX)
        columns = slice(max(0, left - _PATCH_MARGIN_PX), left + wide + _PATCH_MARGIN_PX)
        inside = patches[rows, columns] == patch
        is_unmeasured = inside & (depth[rows, columns] == 0)
        around = cv2.dilate(inside.astype(np.uint8), window) > 0
        squares = _average_in_squares(depth[rows, columns], around & is_reliable[rows, columns])
        if len(squares) < _MIN_SQUARES or not is_unmeasured.any():
            continue
        inliers = fit_plane(squares, random)
        if inliers is not None:
            part = filled_depth[rows, columns]
            part[is_unmeasured] = _evaluate_plane(squares[inliers], is_unmeasured)
    return filled_depth


def _is_plain(color: ColorImage) -> Mask:
    """Return a mask (h, w) of pixels without gradient."""
    import cv2

    soft = cv2.GaussianBlur(color, (0, 0), 1.0).astype(np.float32)
    across, down = (cv2.Sobel(soft, -1, *way, ksize=3, scale=1 / 8) for way in ((1, 0), (0, 1)))
    squares = across * across + down * down
    # Faster than the maximum along an axis of three.
    return np.asarray(reduce(np.maximum, cv2.split(squares)) < _MAX_PLAIN_GRADIENT**2)


def _average_in_squares(depth: DepthImage, known: Mask) -> Numbers:
    """Average known depth in squares of the image.

    Returns
    -------
    (n, 3) column and row (px), and inverse depth (1/m).
    """
    rows, columns = np.nonzero(known)
    if not len(rows):
        return np.zeros((0, 3))
    across = -(-depth.shape[1] // _SQUARE_SIDE_PX)
    square = rows // _SQUARE_SIDE_PX * across + columns // _SQUARE_SIDE_PX
    order = np.argsort(square, kind="stable")
    _, first, counts = np.unique(square[order], return_index=True, return_counts=True)
    values = np.stack([columns, rows, 1 / depth[rows, columns].astype(np.float64)], axis=1)
    means = np.add.reduceat(values[order], first, axis=0) / counts[:, None]
    return np.asarray(means[counts >= _MIN_SQUARE_PIXELS])


def fit_plane(squares: Numbers, random: np.random.Generator) -> Mask | None:
    """Fit a plane to squares by RANSAC.

    Parameters
    ----------
    squares : (n, 3) column and row, px, and inverse depth, 1/m.

    Returns
    -------
    (n,) mask of inliers; None if most squares are not on one plane.
    """
    if len(squares) < _MIN_SQUARES:
        return None
    # For a square at depth z, z · (a, b, c) · (column, row, 1) is 1 on the plane, and larger behind it.
    scaled = _to_homogeneous(squares) / squares[:, 2:]
    triples = scaled[random.integers(len(squares), size=(_RANSAC_SAMPLES, 3))]
    with np.errstate(all="ignore"):
        usable = np.abs(np.linalg.det(triples)) > 1e-9 * np.abs(triples).max(axis=(1, 2)) ** 3
    if not usable.any():
        return None
    planes = np.linalg.solve(triples[usable], np.ones((int(usable.sum()), 3, 1)))[..., 0]
    near = np.abs(planes @ scaled.T - 1) < _INLIER_TOLERANCE
    inliers = near[near.sum(axis=1).argmax()]
    residuals = np.zeros(len(squares))
    for _ in range(3):
        if inliers.sum() < _MIN_SQUARES:
            return None
        plane = np.linalg.lstsq(scaled[inliers], np.ones(int(inliers.sum())), rcond=None)[0]
        residuals = scaled @ plane - 1
        inliers = np.abs(residuals) < _INLIER_TOLERANCE
    is_surface = (
        inliers.mean() >= _MIN_INLIER_RATIO and np.mean(residuals > _BEHIND_TOLERANCE) <= _MAX_BEHIND_RATIO
    )
    return inliers if is_surface and inliers.sum() >= _MIN_SQUARES else None


def _evaluate_plane(squares: Numbers, mask: Mask) -> NDArray[np.float32]:
    """Return the plane's depth at the pixels of a mask.

    Depth is 0 outside of the convex hull of the squares, and where the plane is not well determined.
    """
    import cv2

    scaled = _to_homogeneous(squares) / squares[:, 2:]
    plane = np.linalg.lstsq(scaled, np.ones(len(squares)), rcond=None)[0]
    rows, columns = np.nonzero(mask)
    pixels = np.stack([columns, rows, np.ones(len(rows))], axis=1)
    inverse = pixels @ plane
    hull = cv2.convexHull(np.rint(squares[:, :2]).astype(np.int32))
    is_inside_hull = cv2.fillConvexPoly(np.zeros(mask.shape, np.uint8), hull, 1)[rows, columns] > 0
    covariance = np.linalg.pinv(scaled.T @ scaled)
    with np.errstate(divide="ignore", invalid="ignore"):
        leverage = np.einsum("ni,ij,nj->n", pixels, covariance, pixels) / inverse**2
        is_valid = is_inside_hull & (inverse > 0) & (leverage < _MAX_LEVERAGE)
        return np.where(is_valid, 1 / inverse, 0).astype(np.float32)


def _to_homogeneous(squares: Numbers) -> Numbers:
    return np.column_stack([squares[:, :2], np.ones(len(squares))])
