"""Detection of the support plane (table or floor) under the scanned object.

Planes through three sampled points each are scored (RANSAC). The plane with the highest weight of inliers
around the object is refined, and accepted if it supports the object: roughly perpendicular to up, below most
points, and with points above it. Otherwise its inliers are removed and the search continues, because the lid
of a box may show more surface than the table. Weights decrease with the distance to the object, because the
floor around the table may be larger, too. The random seed is fixed, so that equal input gives an equal plane.

References
----------
Fischler and Bolles, Random Sample Consensus, 1981; with normals as Schnabel, Wahl and Klein, Efficient RANSAC
for Point-Cloud Shape Detection, 2007.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.posed_depth import PosedDepth
from scanloom.stages.fusion.params import Point
from scanloom.stages.fusion.scene_extent import to_point
from scanloom.stages.printing import format_by_fields
from scanloom.stages.surface.up_direction import estimate_up_from_level_cameras

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_PIXEL_STRIDE = 4
# Only points within the median camera distance from the object are used. One point is kept per cell of a grid
# with this many cells along a side, so that surface area counts, and not the number of observations. At this
# ratio of the camera distance, the weight of a point falls to 1/e.
_GRID_CELLS = 80
_WEIGHT_RADIUS_RATIO = 0.35
# Number of drawn point triples; number of triples scored, among those whose normals agree with their plane;
# number of planes tried; iterations of the plane fit.
_DRAW_COUNT = 50_000
_MAX_CANDIDATES = 1500
_MAX_PLANES = 6
_FIT_ITERATIONS = 10
# Inlier limits. Distance to the plane: the larger of this ratio of the camera distance and this multiple of
# the noise. Angle between normals: degrees; normals of single pixels are rough.
_INLIER_DISTANCE_RATIO = 0.008
_INLIER_DEVIATIONS = 3.0
_MAX_NORMAL_ANGLE_DEG = 35.0
# Maximum error of the up direction estimated from the cameras, degrees.
_MAX_TILT_DEG = 60.0
# Landscape cameras have level x axes. Portrait cameras are assumed if the y axes spread more within a plane
# than the x axes by this ratio, and at least by this second moment.
_PORTRAIT_SPREAD_RATIO = 1.5
_MIN_PORTRAIT_SPREAD = 0.02
# Minimum ratio of the total point weight that is on the plane.
_MIN_INLIER_RATIO = 0.05
# Maximum ratio of the total point weight below the plane; scans show little below a table top.
_MAX_BELOW_RATIO = 0.5
# Within this ratio of the camera distance around the object, at least this ratio of the points must be above
# the plane.
_OBJECT_RADIUS_RATIO = 0.35
_MIN_ABOVE_RATIO = 0.02


@dataclass(frozen=True)
class SupportPlane:
    """Support plane of the scanned object.

    Attributes
    ----------
    normal : unit normal, pointing up.
    offset_m : points p on the plane have normal · p = offset_m, metres.
    spread_m : standard deviation of the inliers' distance to the plane, metres.
    inlier_ratio : ratio of the weight of inliers to the weight of all points around the object.
    """

    normal: Point
    offset_m: float
    spread_m: float
    inlier_ratio: float

    __repr__ = format_by_fields


def find_support_plane(views: Sequence[PosedDepth], center: Floats, noise: float) -> SupportPlane | str:
    """Find the plane that supports the object at `center`.

    Parameters
    ----------
    views : sampled frames of the scan.
    center : (3,) position of the object, metres.
    noise : standard deviation of depth, metres.

    Returns
    -------
    The plane, or the reason why no plane was accepted, as a clause for a message.
    """
    poses = np.array([view.pose for view in views])
    up = _estimate_up(poses)
    camera_distance = float(np.median(np.linalg.norm(poses[:, :3, 3] - center, axis=1)))
    points, normals = _sample_points(views, center, camera_distance)
    if len(points) < 100:
        return (
            f"only {len(points)} points are within {camera_distance:.2g} m of the point the cameras look at"
        )
    inlier_distance = max(_INLIER_DISTANCE_RATIO * camera_distance, _INLIER_DEVIATIONS * noise)
    weights = np.exp(
        -(np.linalg.norm(points - center, axis=1) ** 2) / (_WEIGHT_RADIUS_RATIO * camera_distance) ** 2
    )
    remaining_weights = weights * (
        normals @ up > math.cos(math.radians(_MAX_TILT_DEG + _MAX_NORMAL_ANGLE_DEG))
    )
    rng = np.random.default_rng(0)
    rejections: list[str] = []
    for _ in range(_MAX_PLANES):
        plane = _find_largest_plane(points, normals, remaining_weights, up, inlier_distance, rng)
        if plane is None:
            break
        normal, offset = plane
        fitting = (remaining_weights > 0) & (
            _weigh_inliers(points, normals, normal, offset, inlier_distance) > 0
        )
        ratio = float(weights[fitting].sum() / weights.sum())
        if ratio < _MIN_INLIER_RATIO:
            break
        rejection = _explain_rejection(
            points - center,
            weights,
            normal,
            offset - float(normal @ center),
            inlier_distance,
            camera_distance,
        )
        if rejection is None:
            heights = points[fitting] @ normal - offset
            spread = 1.4826 * float(np.median(np.abs(heights)))
            return SupportPlane(to_point(normal), offset, spread, ratio)
        rejections.append(f"the largest plane ({ratio:.0%} of the points) {rejection}")
        remaining_weights = np.where(np.abs(points @ normal - offset) < inlier_distance, 0, remaining_weights)
    no_plane_reason = (
        f"no plane within {_MAX_TILT_DEG:g}° of level has {_MIN_INLIER_RATIO:.0%} of the "
        "points around the object"
    )
    return rejections[0] if rejections else no_plane_reason


def _estimate_up(poses: Floats) -> Floats:
    """Estimate the up direction (3,) from the cameras.

    Handles cameras in landscape and in portrait orientation.
    """
    if _measure_planar_spread(poses[:, :3, 1]) <= max(
        _PORTRAIT_SPREAD_RATIO * _measure_planar_spread(poses[:, :3, 0]), _MIN_PORTRAIT_SPREAD
    ):
        return estimate_up_from_level_cameras(poses)
    rolled = poses.copy()
    rolled[:, :3, 0], rolled[:, :3, 1] = poses[:, :3, 1], -poses[:, :3, 0]
    up = estimate_up_from_level_cameras(rolled)
    # The sign of the rotation to portrait is unknown; cameras look down on an object on a plane.
    return up if up @ poses[:, :3, 2].mean(axis=0) < 0 else -up


def _measure_planar_spread(axes: Floats) -> float:
    """Measure how far directions (n, 3) spread within a plane.

    Returns
    -------
    The middle minus the smallest second moment.
    """
    moments = np.linalg.eigvalsh(axes.T @ axes / len(axes))
    return float(moments[1] - moments[0])


def _sample_points(views: Sequence[PosedDepth], center: Floats, radius: float) -> tuple[Floats, Floats]:
    """Sample one point per grid cell around a centre, with its normal.

    Returns
    -------
    Points and unit normals, each (n, 3), world. Points are within `radius` metres of the centre.
    """
    points, normals = [], []
    for view in views:
        rows, columns = (
            _PIXEL_STRIDE * index
            for index in np.nonzero(view.surface.depth[::_PIXEL_STRIDE, ::_PIXEL_STRIDE])
        )
        points.append(view.unproject_to_world(rows, columns))
        normal = np.stack([axis[rows, columns] for axis in view.surface.normal], axis=1).astype(np.float64)
        normals.append((normal / np.linalg.norm(normal, axis=1, keepdims=True)) @ view.pose[:3, :3].T)
    places, facing = np.concatenate(points), np.concatenate(normals)
    near = np.linalg.norm(places - center, axis=1) < radius
    places, facing = places[near], facing[near]
    cells = np.floor((places - center) / (2 * radius / _GRID_CELLS)).astype(np.int64)
    first = np.unique(cells, axis=0, return_index=True)[1]
    return places[first], facing[first]


def _find_largest_plane(
    points: Floats,
    normals: Floats,
    point_weights: Floats,
    up: Floats,
    inlier_distance: float,
    rng: np.random.Generator,
) -> tuple[Floats, float] | None:
    """Find the plane with the highest weight of inliers by RANSAC.

    Returns
    -------
    Normal (3,) and offset in metres; None if no plane is roughly level.
    """
    rows = np.flatnonzero(point_weights)
    if len(rows) < 3:
        return None
    points, normals, point_weights = points[rows], normals[rows], point_weights[rows]
    drawn = rng.choice(len(rows), (3, _DRAW_COUNT), p=point_weights / point_weights.sum())
    a, b, c = points[drawn]
    tried = np.cross(b - a, c - a)
    tried /= np.maximum(np.linalg.norm(tried, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    tried *= np.where(tried @ up < 0, -1.0, 1.0)[:, None]
    alike = np.einsum("kni,ni->kn", normals[drawn], tried).min(axis=0) > math.cos(
        math.radians(_MAX_NORMAL_ANGLE_DEG)
    )
    chosen = np.flatnonzero(alike & (tried @ up > math.cos(math.radians(_MAX_TILT_DEG))))[:_MAX_CANDIDATES]
    if not len(chosen):
        return None
    tried, a = tried[chosen], a[chosen]
    offsets = np.einsum("ni,ni->n", tried, a)
    scores = [
        point_weights @ _weigh_inliers(points, normals, normal, offset, inlier_distance)
        for normal, offset in zip(tried, offsets, strict=True)
    ]
    best = int(np.argmax(scores))
    normal, offset = tried[best], float(offsets[best])
    for _ in range(_FIT_ITERATIONS):
        weights = point_weights * _weigh_inliers(points, normals, normal, offset, inlier_distance)
        if np.count_nonzero(weights) < 3:
            return None
        middle = np.average(points, axis=0, weights=weights)
        normal = np.linalg.eigh(np.cov((points - middle).T, aweights=weights))[1][:, 0]
        normal = normal if normal @ up > 0 else -normal
        offset = float(normal @ middle)
    return normal, offset


def _weigh_inliers(
    points: Floats, normals: Floats, normal: Floats, offset: float, inlier_distance: float
) -> Floats:
    """Return the inlier weight (n,) of points.

    The weight is 1 on the plane and falls to 0 at the distance `inlier_distance`, metres.
    """
    weights = np.maximum(1 - ((points @ normal - offset) / inlier_distance) ** 2, 0)
    return np.asarray(weights * (normals @ normal > math.cos(math.radians(_MAX_NORMAL_ANGLE_DEG))))


def _explain_rejection(
    relative_points: Floats,
    weights: Floats,
    normal: Floats,
    offset: float,
    inlier_distance: float,
    camera_distance: float,
) -> str | None:
    """Explain why a plane does not support the object.

    Parameters
    ----------
    relative_points : (n, 3) points relative to the object.
    weights : (n,) weights of the points.
    offset : offset of the plane relative to the object, metres.
    inlier_distance : inlier distance, metres.
    camera_distance : median camera distance to the object, metres.

    Returns
    -------
    The reason, as a clause for a message; None if the plane supports the object.
    """
    heights = relative_points @ normal - offset
    if weights[heights < -2 * inlier_distance].sum() > _MAX_BELOW_RATIO * weights.sum():
        return "has most points below it"
    horizontal_distance = np.linalg.norm(relative_points - np.outer(relative_points @ normal, normal), axis=1)
    is_near = horizontal_distance < _OBJECT_RADIUS_RATIO * camera_distance
    if np.count_nonzero(heights[is_near] > 2 * inlier_distance) < _MIN_ABOVE_RATIO * np.count_nonzero(
        is_near
    ):
        return "has no points above it"
    return None
