"""From pixels of colour images to points: the depth there, looked up through both cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import Cameras, carried, inverted_all
from scanloom.stages.adjusting.lens import project, rays
from scanloom.stages.adjusting.shutter import as_read, in_the_middle, late_of
from scanloom.stages.adjusting.view import View

# Where the cameras stand apart, the depth along a ray is found by steps; it is found once the last one
# changes it by less than this share.
_STEPS, _SETTLED = 6, 0.01
# Pixels to each side that tell how a surface slopes; depth that changes more is an edge.
_BESIDE, _BENT = 2, 0.1


def lifted(
    views: Sequence[View], cameras: Cameras, view: NDArray[np.intp], pixels: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Return the (n, 3) points that pixels show, metres, in the axes of the depth cameras as they are read.

    What has no depth is NaN.

    Parameters
    ----------
    view : (n,) which view each pixel is of.
    pixels : (n, 2), of the colour image.
    """
    way = rays(pixels, cameras.lenses[view])
    apart = cameras.color_from_depth[view]
    back = inverted_all(cameras.color_from_depth)[view]
    typical = np.array([_median(one) for one in views])
    z = typical[view]
    seen = np.zeros((len(view), 3))
    before = z
    known = np.zeros(len(view), bool)
    for _ in range(_STEPS):
        seen = carried(back, way * z[:, None])
        measured = depth_at(views, view, seen)
        known = measured > 0
        # Beside what was measured, depth is searched from where the ray was.
        seen *= (np.where(known, measured, seen[:, 2]) / seen[:, 2])[:, None]
        before, z = z, np.maximum(carried(apart, seen)[:, 2], 1e-3)
    known &= np.abs(z - before) < _SETTLED * z
    return np.where(known[:, None], seen, np.nan)


def depth_at(
    views: Sequence[View], view: NDArray[np.intp], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the depth (n,) that views measure where they see points of their own axes; 0 where none."""
    lenses = np.stack([one.depth_lens for one in views])[view]
    return _sampled(views, view, _depth_pixels(lenses, points))


def planes_at(
    views: Sequence[View], view: NDArray[np.intp], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the planes that views measure where they see points of their own axes.

    The inverse depth of a plane is linear in the image: 1/z = a x + b y + c where aX + bY + cZ = 1.

    Returns
    -------
    normals : (n, 3); `normals @ point - depth` is how far behind the plane a point is, metres of depth.
    depth : (n,) metres, 0 where none is measured.
    slope : (n,) metres that depth changes by in a pixel.
    """
    lenses = np.stack([one.depth_lens for one in views])[view]
    pixels = _depth_pixels(lenses, points)
    depth = _sampled(views, view, pixels)
    known = np.where(depth > 0, depth, 1)
    normals = np.zeros((len(points), 3))
    for axis in range(2):
        step = np.eye(2)[axis] * _BESIDE
        low, high = (_sampled(views, view, pixels + sign * step) for sign in (-1, 1))
        both = (low > 0) & (high > 0) & (np.abs(high - low) < _BENT * known)
        change = 1 / np.where(both, high, 1) - 1 / np.where(both, low, 1)
        normals[:, axis] = known * change / (2 * _BESIDE)
    slope = known * np.hypot(*normals[:, :2].T)
    # From a change in a pixel to one in the ray.
    normals[:, :2] *= lenses[:, :2]
    normals[:, 2] = 1 - (normals[:, :2] * points[:, :2]).sum(axis=1) / np.maximum(points[:, 2], 1e-3)
    return normals, depth, slope


def _depth_pixels(lenses: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    z = np.where(points[:, 2] > 1e-3, points[:, 2], np.nan)[:, None]
    return np.asarray(points[:, :2] / z * lenses[:, :2] + lenses[:, 2:])


def _sampled(
    views: Sequence[View], view: NDArray[np.intp], pixels: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the depth (n,) at pixels (n, 2) of depth maps; 0 beside them, and for NaN."""
    width, height = np.array([one.depth.shape[::-1] for one in views])[view].T
    columns, rows = np.rint(np.nan_to_num(pixels, nan=-1.0).clip(-1, 1e6)).astype(np.intp).T
    inside = (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
    result = np.zeros(len(pixels))
    at = np.flatnonzero(inside)
    at = at[np.argsort(view[at], kind="stable")]
    ends = np.searchsorted(view[at], np.arange(len(views) + 1))
    for number, one in enumerate(views):
        here = at[ends[number] : ends[number + 1]]
        result[here] = one.depth[rows[here], columns[here]]
    return result


def in_world(
    cameras: Cameras, view: NDArray[np.intp], points: NDArray[np.float64], late: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return points of the views' own axes, as rows are read that late (n,), in the world."""
    return carried(cameras.poses[view], in_the_middle(points, cameras.turns[view], late))


def in_color(
    cameras: Cameras, view: NDArray[np.intp], points: NDArray[np.float64], late: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return points of the world in the axes of colour cameras, as rows are read that late (n,)."""
    middle = carried(inverted_all(cameras.poses)[view], points)
    return carried(cameras.color_from_depth[view], as_read(middle, cameras.turns[view], late))


def transfer_errors(
    views: Sequence[View],
    cameras: Cameras,
    couples: NDArray[np.intp],
    pixels: tuple[NDArray[np.floating], NDArray[np.floating]],
) -> NDArray[np.float64]:
    """Return how far from its match a point lands in the other view, (n,) pixels; NaN where it has no depth.

    Parameters
    ----------
    couples : (n, 2) the two views of each match.
    pixels : of the first and of the second view, (n, 2) each.
    """
    here, other = couples.T
    seen = lifted(views, cameras, here, pixels[0])
    points = in_world(cameras, here, seen, late_of(views, here, pixels[0]))
    there = in_color(cameras, other, points, late_of(views, other, pixels[1]))
    there[:, 2] = np.where(there[:, 2] > 1e-3, there[:, 2], np.nan)
    off = project(there, cameras.lenses[other]) - pixels[1]
    return np.asarray(np.hypot(*off.T))


def _median(view: View) -> float:
    some = view.depth[::8, ::8]
    some = some[some > 0]
    return float(np.median(some)) if len(some) else 1.0
