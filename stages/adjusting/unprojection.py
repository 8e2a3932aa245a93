"""Unprojection of colour pixels with the depth maps of the views."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import Cameras, invert_poses, transform_points
from scanloom.stages.adjusting.lens import compute_rays, project_with_distortion
from scanloom.stages.adjusting.rolling_shutter import (
    compute_readout_times,
    transform_to_middle_row,
    transform_to_readout,
)
from scanloom.stages.adjusting.view import AdjustmentView

# Maximum iterations of the search for depth along a ray, and the relative change at convergence. The search
# is needed because colour and depth camera have different positions.
_MAX_ITERATIONS, _CONVERGENCE_RATIO = 6, 0.01
# Distance in pixels over which the slope of a surface is measured; larger relative depth changes are edges.
_SLOPE_RADIUS_PX, _MAX_DEPTH_CHANGE_RATIO = 2, 0.1


def unproject_pixels(
    views: Sequence[AdjustmentView],
    cameras: Cameras,
    view_indices: NDArray[np.intp],
    pixels: NDArray[np.floating],
) -> NDArray[np.float64]:
    """Unproject colour pixels to points in depth-camera axes.

    Parameters
    ----------
    views : views with depth maps.
    cameras : cameras of the views.
    view_indices : (n,) index of the view of each pixel.
    pixels : (n, 2) in the colour image.

    Returns
    -------
    (n, 3) metres, at the readout time of the pixel's row; NaN without depth.
    """
    way = compute_rays(pixels, cameras.lenses[view_indices])
    apart = cameras.color_from_depth[view_indices]
    back = invert_poses(cameras.color_from_depth)[view_indices]
    typical = np.array([_compute_median_depth(one) for one in views])
    z = typical[view_indices]
    seen = np.zeros((len(view_indices), 3))
    before = z
    known = np.zeros(len(view_indices), bool)
    for _ in range(_MAX_ITERATIONS):
        seen = transform_points(back, way * z[:, None])
        measured = sample_depth(views, view_indices, seen)
        known = measured > 0
        # Without depth at the projection, the search continues from the same point of the ray.
        seen *= (np.where(known, measured, seen[:, 2]) / seen[:, 2])[:, None]
        before, z = z, np.maximum(transform_points(apart, seen)[:, 2], 1e-3)
    known &= np.abs(z - before) < _CONVERGENCE_RATIO * z
    return np.where(known[:, None], seen, np.nan)


def sample_depth(
    views: Sequence[AdjustmentView], view_indices: NDArray[np.intp], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Look up the depth of views at the projections of points.

    Parameters
    ----------
    view_indices : (n,) index of the view of each point.
    points : (n, 3) metres, axes of the depth camera of that view.

    Returns
    -------
    (n,) metres; 0 without depth.
    """
    lenses = np.stack([one.depth_lens for one in views])[view_indices]
    return _sample_nearest(views, view_indices, project_to_depth_map(lenses, points))


def measure_planes(
    views: Sequence[AdjustmentView], view_indices: NDArray[np.intp], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Measure tangent planes of the depth maps at the projections of points.

    The inverse depth of a plane is linear in the image: 1/z = a x + b y + c for aX + bY + cZ = 1.

    Parameters
    ----------
    view_indices : (n,) index of the view of each point.
    points : (n, 3) metres, axes of the depth camera of that view.

    Returns
    -------
    normals : (n, 3); `normals @ point - depth` is the distance of a point behind its plane, metres of depth.
    depth : (n,) metres; 0 without depth.
    slope : (n,) change of depth per pixel, metres.
    """
    lenses = np.stack([one.depth_lens for one in views])[view_indices]
    pixels = project_to_depth_map(lenses, points)
    depth = _sample_nearest(views, view_indices, pixels)
    known = np.where(depth > 0, depth, 1)
    normals = np.zeros((len(points), 3))
    for axis in range(2):
        step = np.eye(2)[axis] * _SLOPE_RADIUS_PX
        low, high = (_sample_nearest(views, view_indices, pixels + sign * step) for sign in (-1, 1))
        both = (low > 0) & (high > 0) & (np.abs(high - low) < _MAX_DEPTH_CHANGE_RATIO * known)
        change = 1 / np.where(both, high, 1) - 1 / np.where(both, low, 1)
        normals[:, axis] = known * change / (2 * _SLOPE_RADIUS_PX)
    slope = known * np.hypot(*normals[:, :2].T)
    # Convert derivatives per pixel to derivatives per unit of the ray.
    normals[:, :2] *= lenses[:, :2]
    normals[:, 2] = 1 - (normals[:, :2] * points[:, :2]).sum(axis=1) / np.maximum(points[:, 2], 1e-3)
    return normals, depth, slope


def compute_depth_basis(
    views: Sequence[AdjustmentView], view_indices: NDArray[np.intp], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute the basis of the depth correction at points.

    Parameters
    ----------
    view_indices : (n,) index of the view of each point.
    points : (n, 3) metres, axes of the depth camera of that view.

    Returns
    -------
    (n, d) derivatives of the relative correction by its d coefficients; 0 behind the camera.
    """
    correction, step = views[0].depth_correction, views[0].depth_step
    assert correction is not None
    lenses = np.stack([one.depth_lens for one in views])[view_indices]
    pixels = np.nan_to_num(project_to_depth_map(lenses, points)) * step
    basis = correction.compute_basis(pixels[:, 0], pixels[:, 1], points[:, 2])
    return basis * (points[:, 2] > 1e-3)[:, None]


def project_to_depth_map(lenses: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Project points (n, 3) to pixels (n, 2) of depth maps with intrinsics (n, 4); NaN behind the camera."""
    z = np.where(points[:, 2] > 1e-3, points[:, 2], np.nan)[:, None]
    return np.asarray(points[:, :2] / z * lenses[:, :2] + lenses[:, 2:])


def _sample_nearest(
    views: Sequence[AdjustmentView], view_indices: NDArray[np.intp], pixels: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Look up depth (n,) at pixels (n, 2), rounded to the nearest.

    Depth is corrected if the views have a correction. The depth is 0 outside the depth map, and for NaN.
    """
    width, height = np.array([one.depth.shape[::-1] for one in views])[view_indices].T
    columns, rows = np.rint(np.nan_to_num(pixels, nan=-1.0).clip(-1, 1e6)).astype(np.intp).T
    inside = (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
    result = np.zeros(len(pixels))
    at = np.flatnonzero(inside)
    at = at[np.argsort(view_indices[at], kind="stable")]
    ends = np.searchsorted(view_indices[at], np.arange(len(views) + 1))
    for number, one in enumerate(views):
        here = at[ends[number] : ends[number + 1]]
        result[here] = one.depth[rows[here], columns[here]]
    correction = views[0].depth_correction if len(views) else None
    if correction is None:
        return result
    # All views have the same depth camera if depth is corrected.
    step = views[0].depth_step
    return correction.correct_at(columns * step, rows * step, result)


def transform_to_world(
    cameras: Cameras,
    view_indices: NDArray[np.intp],
    points: NDArray[np.float64],
    readout_times: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Transform points from the axes of their views to the world.

    Parameters
    ----------
    view_indices : (n,) index of the view of each point.
    points : (n, 3) metres, depth-camera axes at the readout time of their row.
    readout_times : (n,) readout times of the rows, see stages/adjusting/rolling_shutter.py.
    """
    return transform_points(
        cameras.poses[view_indices],
        transform_to_middle_row(points, cameras.readout_rotations[view_indices], readout_times),
    )


def transform_to_color_camera(
    cameras: Cameras,
    view_indices: NDArray[np.intp],
    points: NDArray[np.float64],
    readout_times: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Transform world points to the axes of the colour cameras.

    Parameters
    ----------
    view_indices : (n,) index of the view of each point.
    points : (n, 3) metres.
    readout_times : (n,) readout times of the rows that see the points.
    """
    middle = transform_points(invert_poses(cameras.poses)[view_indices], points)
    return transform_points(
        cameras.color_from_depth[view_indices],
        transform_to_readout(middle, cameras.readout_rotations[view_indices], readout_times),
    )


def compute_transfer_errors(
    views: Sequence[AdjustmentView],
    cameras: Cameras,
    pair_indices: NDArray[np.intp],
    pixels: tuple[NDArray[np.floating], NDArray[np.floating]],
) -> NDArray[np.float64]:
    """Compute the transfer errors of matches, pixels.

    The keypoint of the first view is unprojected and reprojected into the second view. The error is the
    distance to its match there.

    Parameters
    ----------
    pair_indices : (n, 2) indices of the two views of each match.
    pixels : (n, 2) pixels in the first views, and (n, 2) in the second views.

    Returns
    -------
    (n,) pixels; NaN if the first view has no depth there, or the point is behind the second camera.
    """
    here, other = pair_indices.T
    seen = unproject_pixels(views, cameras, here, pixels[0])
    points = transform_to_world(cameras, here, seen, compute_readout_times(views, here, pixels[0]))
    there = transform_to_color_camera(cameras, other, points, compute_readout_times(views, other, pixels[1]))
    there[:, 2] = np.where(there[:, 2] > 1e-3, there[:, 2], np.nan)
    off = project_with_distortion(there, cameras.lenses[other]) - pixels[1]
    return np.asarray(np.hypot(*off.T))


def _compute_median_depth(view: AdjustmentView) -> float:
    some = view.depth[::8, ::8]
    some = some[some > 0]
    return float(np.median(some)) if len(some) else 1.0
