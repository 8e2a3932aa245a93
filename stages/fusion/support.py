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
from scanloom.stages.fusion.scene import point_of
from scanloom.stages.printing import by_fields
from scanloom.stages.surface.upright import up_of_cameras

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_STEP = 4
# Only points within the median camera distance from the object are used. One point is kept per cell of a grid
# with this many cells along a side, so that surface area counts, and not the number of observations. At this
# ratio of the camera distance, the weight of a point falls to 1/e.
_CELLS = 80
_NEAR = 0.35
# Number of drawn point triples; number of triples scored, among those whose normals agree with their plane;
# number of planes tried; iterations of the plane fit.
_DRAWS = 50_000
_TRIED = 1500
_PLANES = 6
_FITS = 10
# Inlier limits. Distance to the plane: the larger of this ratio of the camera distance and this multiple of
# the noise. Angle between normals: degrees; normals of single pixels are rough.
_ON_SHARE = 0.008
_ON_NOISES = 3.0
_NORMAL = 35.0
# Maximum error of the up direction estimated from the cameras, degrees.
_TILT = 60.0
# Landscape cameras have level x axes. Portrait cameras are assumed if the y axes spread more within a plane
# than the x axes by this ratio, and at least by this second moment.
_WIDER = 1.5
_SPREADING = 0.02
# Minimum ratio of the total point weight that is on the plane.
_LEAST_SHARE = 0.05
# Maximum ratio of the total point weight below the plane; scans show little below a table top.
_MOST_BELOW = 0.5
# Within this ratio of the camera distance around the object, at least this ratio of the points must be above
# the plane.
_WIDTH = 0.35
_LEAST_ON_IT = 0.02


@dataclass(frozen=True)
class Support:
    """Support plane of the scanned object.

    Attributes
    ----------
    normal : unit normal, pointing up.
    offset_m : points p on the plane have normal · p = offset_m, metres.
    spread_m : standard deviation of the inliers' distance to the plane, metres.
    share : ratio of the weight of inliers to the weight of all points around the object.
    """

    normal: Point
    offset_m: float
    spread_m: float
    share: float

    __repr__ = by_fields


def find_support(views: Sequence[PosedDepth], center: Floats, noise: float) -> Support | str:
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
    up = _up(poses)
    distance = float(np.median(np.linalg.norm(poses[:, :3, 3] - center, axis=1)))
    points, normals = _around(views, center, distance)
    if len(points) < 100:
        return f"only {len(points)} points are within {distance:.2g} m of the point the cameras look at"
    on = max(_ON_SHARE * distance, _ON_NOISES * noise)
    counts = np.exp(-(np.linalg.norm(points - center, axis=1) ** 2) / (_NEAR * distance) ** 2)
    left = counts * (normals @ up > math.cos(math.radians(_TILT + _NORMAL)))
    draw = np.random.default_rng(0)
    refused: list[str] = []
    for _ in range(_PLANES):
        found = _largest(points, normals, left, up, on, draw)
        if found is None:
            break
        normal, offset = found
        fitting = (left > 0) & (_fit(points, normals, normal, offset, on) > 0)
        share = float(counts[fitting].sum() / counts.sum())
        if share < _LEAST_SHARE:
            break
        why = _not_under(points - center, counts, normal, offset - float(normal @ center), on, distance)
        if why is None:
            heights = points[fitting] @ normal - offset
            spread = 1.4826 * float(np.median(np.abs(heights)))
            return Support(point_of(normal), offset, spread, share)
        refused.append(f"the largest plane ({share:.0%} of the points) {why}")
        left = np.where(np.abs(points @ normal - offset) < on, 0, left)
    level = f"no plane within {_TILT:g}° of level has {_LEAST_SHARE:.0%} of the points around the object"
    return refused[0] if refused else level


def _up(poses: Floats) -> Floats:
    """Estimate the up direction (3,) from the cameras.

    Handles cameras in landscape and in portrait orientation.
    """
    if _spread(poses[:, :3, 1]) <= max(_WIDER * _spread(poses[:, :3, 0]), _SPREADING):
        return up_of_cameras(poses)
    rolled = poses.copy()
    rolled[:, :3, 0], rolled[:, :3, 1] = poses[:, :3, 1], -poses[:, :3, 0]
    up = up_of_cameras(rolled)
    # The sign of the rotation to portrait is unknown; cameras look down on an object on a plane.
    return up if up @ poses[:, :3, 2].mean(axis=0) < 0 else -up


def _spread(axes: Floats) -> float:
    """Measure how far directions (n, 3) spread within a plane.

    Returns
    -------
    The middle minus the smallest second moment.
    """
    moments = np.linalg.eigvalsh(axes.T @ axes / len(axes))
    return float(moments[1] - moments[0])


def _around(views: Sequence[PosedDepth], center: Floats, reach: float) -> tuple[Floats, Floats]:
    """Sample one point per grid cell around a centre, with its normal.

    Returns
    -------
    Points and unit normals, each (n, 3), world. Points are within `reach` metres of the centre.
    """
    points, normals = [], []
    for view in views:
        rows, columns = (_STEP * index for index in np.nonzero(view.surface.depth[::_STEP, ::_STEP]))
        points.append(view.world_points(rows, columns))
        normal = np.stack([axis[rows, columns] for axis in view.surface.normal], axis=1).astype(np.float64)
        normals.append((normal / np.linalg.norm(normal, axis=1, keepdims=True)) @ view.pose[:3, :3].T)
    places, facing = np.concatenate(points), np.concatenate(normals)
    near = np.linalg.norm(places - center, axis=1) < reach
    places, facing = places[near], facing[near]
    cells = np.floor((places - center) / (2 * reach / _CELLS)).astype(np.int64)
    first = np.unique(cells, axis=0, return_index=True)[1]
    return places[first], facing[first]


def _largest(
    points: Floats, normals: Floats, counts: Floats, up: Floats, on: float, draw: np.random.Generator
) -> tuple[Floats, float] | None:
    """Find the plane with the highest weight of inliers by RANSAC.

    Returns
    -------
    Normal (3,) and offset in metres; None if no plane is roughly level.
    """
    rows = np.flatnonzero(counts)
    if len(rows) < 3:
        return None
    points, normals, counts = points[rows], normals[rows], counts[rows]
    drawn = draw.choice(len(rows), (3, _DRAWS), p=counts / counts.sum())
    a, b, c = points[drawn]
    tried = np.cross(b - a, c - a)
    tried /= np.maximum(np.linalg.norm(tried, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    tried *= np.where(tried @ up < 0, -1.0, 1.0)[:, None]
    alike = np.einsum("kni,ni->kn", normals[drawn], tried).min(axis=0) > math.cos(math.radians(_NORMAL))
    chosen = np.flatnonzero(alike & (tried @ up > math.cos(math.radians(_TILT))))[:_TRIED]
    if not len(chosen):
        return None
    tried, a = tried[chosen], a[chosen]
    offsets = np.einsum("ni,ni->n", tried, a)
    scores = [
        counts @ _fit(points, normals, normal, offset, on)
        for normal, offset in zip(tried, offsets, strict=True)
    ]
    best = int(np.argmax(scores))
    normal, offset = tried[best], float(offsets[best])
    for _ in range(_FITS):
        weights = counts * _fit(points, normals, normal, offset, on)
        if np.count_nonzero(weights) < 3:
            return None
        middle = np.average(points, axis=0, weights=weights)
        normal = np.linalg.eigh(np.cov((points - middle).T, aweights=weights))[1][:, 0]
        normal = normal if normal @ up > 0 else -normal
        offset = float(normal @ middle)
    return normal, offset


def _fit(points: Floats, normals: Floats, normal: Floats, offset: float, on: float) -> Floats:
    """Return the inlier weight (n,) of points.

    The weight is 1 on the plane and falls to 0 at the distance `on`, metres.
    """
    weights = np.maximum(1 - ((points @ normal - offset) / on) ** 2, 0)
    return np.asarray(weights * (normals @ normal > math.cos(math.radians(_NORMAL))))


def _not_under(
    away: Floats, counts: Floats, normal: Floats, offset: float, on: float, distance: float
) -> str | None:
    """Explain why a plane does not support the object.

    Parameters
    ----------
    away : (n, 3) points relative to the object.
    counts : (n,) weights of the points.
    offset : offset of the plane relative to the object, metres.
    on : inlier distance, metres.
    distance : median camera distance to the object, metres.

    Returns
    -------
    The reason, as a clause for a message; None if the plane supports the object.
    """
    heights = away @ normal - offset
    if counts[heights < -2 * on].sum() > _MOST_BELOW * counts.sum():
        return "has most points below it"
    beside = np.linalg.norm(away - np.outer(away @ normal, normal), axis=1)
    around = beside < _WIDTH * distance
    if np.count_nonzero(heights[around] > 2 * on) < _LEAST_ON_IT * np.count_nonzero(around):
        return "has no points above it"
    return None
