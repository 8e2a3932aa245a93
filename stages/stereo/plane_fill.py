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
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.scans.model.prefetch import read_ahead
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Scan, SkippedFrame
from scanloom.stages.scans.model.threads import threads_to_use
from scanloom.stages.stereo.depth_map import DepthMap
from scanloom.stages.stereo.filling import filled_again, without_images
from scanloom.stages.stereo.kept_maps import KeptMaps
from scanloom.stages.stereo.params import DepthParams
from scanloom.stages.stereo.posed_views import PosedView

Mask = NDArray[np.bool_]
# Projection matrix (3, 4) from pixels to another view, and the depth map of that view.
_Seen = tuple[NDArray[np.float64], DepthImage]
Numbers = NDArray[np.float64]

# Maximum gradient of a plain pixel in any channel, grey levels per pixel, after a blur of one pixel.
_PLAIN = 3.0
# Minimum patch area relative to the image; margin around a patch for depth, px, because edges displace depth.
_LEAST_PATCH, _RIM = 1e-3, 3
# Minimum confidence of 255 for fitting planes. Less certain depth next to plain areas belongs to nearer
# objects.
_SURE = 230
# Depth is averaged in squares of this side, px, with at least this number of valid pixels; neighbouring
# pixels share their noise.
_SQUARE, _IN_A_SQUARE = 8, 6
# Minimum number of inlier squares, their minimum ratio, and the relative inlier distance in depth.
_LEAST_SQUARES, _SHARE, _NOISE = 12, 0.6, 0.01
# Squares this far behind the plane, relative to depth, may be at most this ratio of all: the border of a
# surface is its own edge or an object in front.
_BEHIND, _MOST_BEHIND = 0.03, 0.05
_SAMPLES = 120
# Maximum variance of the plane's depth relative to the variance of a square.
_MOST_LEVERAGE = 0.3
# Relative differences of depth between views: maximum for agreement, and for no contradiction.
_SAME, _NEARLY = 0.02, 0.04


def filled_on_planes(
    checked: Iterator[DepthMap | SkippedFrame],
    scan: Scan,
    views: Sequence[PosedView],
    chosen: Sequence[Sequence[int]],
    within: Callable[[int, DepthImage], DepthImage],
    params: DepthParams,
    folder: Path,
    progress: Callable[[int], object],
) -> Iterator[DepthMap | SkippedFrame]:
    """Fill depth maps of all views from planes.

    Parameters
    ----------
    checked : depth maps after the consistency check, in the order of the views.
    scan, views : frames and posed views.
    chosen : for each view, indices of the views that its depth is checked against.
    within : function from view index and depth to the depth inside the mask, box and hull.
    params : parameters of the depth stage.
    folder : folder for maps while not all of them are checked.
    progress : called with the number of checked maps.

    Returns
    -------
    Iterator over the filled maps in the order of the views.
    """
    measured, whole = KeptMaps(folder / "measured"), KeptMaps(folder / "whole")

    def keep(numbered: tuple[int, DepthMap | SkippedFrame]) -> DepthMap | SkippedFrame:
        at, one = numbered
        if isinstance(one, SkippedFrame):
            return one
        told = within(at, on_planes(one.depth, one.confidence, one.color, seed=at))
        measured.put(at, one.depth, one.confidence)
        whole.put(at, np.where(one.depth > 0, one.depth, told), one.confidence)
        return without_images(one)

    threads = params.threads or threads_to_use()
    rest: list[DepthMap | SkippedFrame] = []
    for kept in read_ahead(keep, enumerate(checked), threads=threads, ahead=threads):
        rest.append(kept)
        progress(len(rest))

    def depths(at: int, _: ColorImage) -> tuple[DepthImage, NDArray[np.uint8], DepthImage]:
        depth = measured.depth(at)
        told = np.where(depth > 0, np.float32(0), whole.depth(at))
        others = [other for other in chosen[at] if isinstance(rest[other], DepthMap)]
        ways = [views[at].pixels_to(views[other]) for other in others]
        all_told, all_measured = (
            list(zip(ways, map(maps.depth, others), strict=True)) for maps in (whole, measured)
        )
        told[~_agreed(told, all_told, all_measured, params.agreeing_views)] = 0
        return depth, measured.confidence(at), told

    yield from filled_again(rest, scan.frames, depths, threads)


def _agreed(told: DepthImage, whole: Sequence[_Seen], measured: Sequence[_Seen], least: int) -> Mask:
    """Return a mask (h, w) of filled depth that other views confirm.

    Parameters
    ----------
    told : (h, w) filled depth, metres.
    whole, measured : other views with their filled, and only measured, depth.
    least : minimum number of agreeing views. Measured depth may contradict in no more views than agree.
    """
    same, _ = _kernels.agreeing(told, whole, tolerances=(_SAME, _NEARLY), wanted_threads=1)
    _, nearly = _kernels.agreeing(told, measured, tolerances=(_SAME, _NEARLY), wanted_threads=1)
    looking = _kernels.not_before(told, measured, share=0.0, wanted_threads=1)
    return np.asarray((told > 0) & (same >= least) & (looking.astype(int) - nearly <= nearly))


def on_planes(depth: DepthImage, trust: NDArray[np.uint8], color: ColorImage, *, seed: int = 0) -> DepthImage:
    """Compute depth of unmeasured pixels in plain patches from planes.

    Parameters
    ----------
    depth : (h, w) float32 metres, 0 where not measured.
    trust : (h, w) uint8, 255 times the probability that depth is right.
    color : (h, w, 3) uint8 RGB, undistorted.
    seed : seed of the random samples.

    Returns
    -------
    (h, w) float32 metres; 0 at measured pixels and where no plane was found.
    """
    import cv2

    height, width = depth.shape
    told = np.zeros_like(depth)
    sure = (depth > 0) & (trust >= _SURE)
    _, patches, stats, _ = cv2.connectedComponentsWithStats(_is_plain(color).astype(np.uint8), connectivity=4)
    random = np.random.default_rng(seed)
    window = np.ones((2 * _RIM + 1, 2 * _RIM + 1), np.uint8)
    areas = stats[1:, cv2.CC_STAT_AREA]
    for patch in 1 + np.flatnonzero(areas >= _LEAST_PATCH * height * width):
        left, top, wide, high = (int(value) for value in stats[patch, :4])
        rows = slice(max(0, top - _RIM), top + high + _RIM)
        columns = slice(max(0, left - _RIM), left + wide + _RIM)
        inside = patches[rows, columns] == patch
        bare = inside & (depth[rows, columns] == 0)
        around = cv2.dilate(inside.astype(np.uint8), window) > 0
        squares = _squares(depth[rows, columns], around & sure[rows, columns])
        if len(squares) < _LEAST_SQUARES or not bare.any():
            continue
        taken = plane_of(squares, random)
        if taken is not None:
            part = told[rows, columns]
            part[bare] = _between(squares[taken], bare)
    return told


def _is_plain(color: ColorImage) -> Mask:
    """Return a mask (h, w) of pixels without gradient."""
    import cv2

    soft = cv2.GaussianBlur(color, (0, 0), 1.0).astype(np.float32)
    across, down = (cv2.Sobel(soft, -1, *way, ksize=3, scale=1 / 8) for way in ((1, 0), (0, 1)))
    return np.asarray(np.hypot(across, down).max(axis=2) < _PLAIN)


def _squares(depth: DepthImage, known: Mask) -> Numbers:
    """Average known depth in squares of the image.

    Returns
    -------
    (n, 3) column and row (px), and inverse depth (1/m).
    """
    rows, columns = np.nonzero(known)
    if not len(rows):
        return np.zeros((0, 3))
    across = -(-depth.shape[1] // _SQUARE)
    square = rows // _SQUARE * across + columns // _SQUARE
    order = np.argsort(square, kind="stable")
    _, first, counts = np.unique(square[order], return_index=True, return_counts=True)
    values = np.stack([columns, rows, 1 / depth[rows, columns].astype(np.float64)], axis=1)
    means = np.add.reduceat(values[order], first, axis=0) / counts[:, None]
    return np.asarray(means[counts >= _IN_A_SQUARE])


def plane_of(squares: Numbers, random: np.random.Generator) -> Mask | None:
    """Fit a plane to squares by RANSAC.

    Parameters
    ----------
    squares : (n, 3) column and row, px, and inverse depth, 1/m.

    Returns
    -------
    (n,) mask of inliers; None if most squares are not on one plane.
    """
    if len(squares) < _LEAST_SQUARES:
        return None
    # For a square at depth z, z · (a, b, c) · (column, row, 1) is 1 on the plane, and larger behind it.
    scaled = _homogeneous(squares) / squares[:, 2:]
    triples = scaled[random.integers(len(squares), size=(_SAMPLES, 3))]
    with np.errstate(all="ignore"):
        usable = np.abs(np.linalg.det(triples)) > 1e-9 * np.abs(triples).max(axis=(1, 2)) ** 3
    if not usable.any():
        return None
    planes = np.linalg.solve(triples[usable], np.ones((int(usable.sum()), 3, 1)))[..., 0]
    near = np.abs(planes @ scaled.T - 1) < _NOISE
    taken = near[near.sum(axis=1).argmax()]
    off = np.zeros(len(squares))
    for _ in range(3):
        if taken.sum() < _LEAST_SQUARES:
            return None
        plane = np.linalg.lstsq(scaled[taken], np.ones(int(taken.sum())), rcond=None)[0]
        off = scaled @ plane - 1
        taken = np.abs(off) < _NOISE
    is_surface = taken.mean() >= _SHARE and np.mean(off > _BEHIND) <= _MOST_BEHIND
    return taken if is_surface and taken.sum() >= _LEAST_SQUARES else None


def _between(squares: Numbers, bare: Mask) -> NDArray[np.float32]:
    """Return the plane's depth at the pixels of a mask.

    Depth is 0 outside of the convex hull of the squares, and where the plane is not well determined.
    """
    import cv2

    scaled = _homogeneous(squares) / squares[:, 2:]
    plane = np.linalg.lstsq(scaled, np.ones(len(squares)), rcond=None)[0]
    rows, columns = np.nonzero(bare)
    pixels = np.stack([columns, rows, np.ones(len(rows))], axis=1)
    inverse = pixels @ plane
    hull = cv2.convexHull(np.rint(squares[:, :2]).astype(np.int32))
    within = cv2.fillConvexPoly(np.zeros(bare.shape, np.uint8), hull, 1)[rows, columns] > 0
    spread = np.linalg.pinv(scaled.T @ scaled)
    with np.errstate(divide="ignore", invalid="ignore"):
        leverage = np.einsum("ni,ij,nj->n", pixels, spread, pixels) / inverse**2
        told = within & (inverse > 0) & (leverage < _MOST_LEVERAGE)
        return np.where(told, 1 / inverse, 0).astype(np.float32)


def _homogeneous(squares: Numbers) -> Numbers:
    return np.column_stack([squares[:, :2], np.ones(len(squares))])
