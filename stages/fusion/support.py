"""The plane a thing stands on: table or floor, found in the points that some frames show.

Planes through three points each are tried (RANSAC), the one with most points around the thing is fitted to
them, and taken if it is under the thing: roughly square to up, not above most of what is there, and with
something standing on it. If not, its points go, and the next one is looked for: the lid of a box may be
larger than what is seen of the table. Points count the more the nearer they are to the thing: the floor
around the table may be larger, too. All is drawn from one seed, so that equal input gives an equal plane.

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
# Points are looked at that are as near to the thing as most cameras are; one in each cell of a grid, so that
# surface counts, not how often it was seen. At this share of that distance it counts 1/e of one at the thing.
_CELLS = 80
_NEAR = 0.35
# Of so many threes of points that are drawn, so many are tried of those whose normals are their plane's.
_DRAWS = 50_000
_TRIED = 1500
_PLANES = 6
_FITS = 10
# Points as near to a plane as this share of the cameras' distance, or as three times the noise, lie on it, if
# their normal is as near to the plane's as this many degrees: normals of single pixels are rough.
_ON_SHARE = 0.008
_ON_NOISES = 3.0
_NORMAL = 35.0
# Up in the cameras is off by no more than this, degrees.
_TILT = 60.0
# Cameras are held upright where their y axes spread so much wider in a plane than their x axes, which are
# level otherwise, and at least by so much: second moments.
_WIDER = 1.5
_SPREADING = 0.02
# Least share of the points around the thing, as they count, that lie on the plane.
_LEAST_SHARE = 0.05
# At most this share of the points, as they count, is below the plane: below a table's top little is seen.
_MOST_BELOW = 0.5
# Within this share of the cameras' distance around the thing something must stand on the plane: at least this
# share of the points there.
_WIDTH = 0.35
_LEAST_ON_IT = 0.02


@dataclass(frozen=True)
class Support:
    """The plane a thing stands on.

    Attributes
    ----------
    normal : up from it, of length 1.
    offset_m : a place p is on it where normal · p is this, metres.
    spread_m : standard deviation of the points on it across it, metres.
    share : of the points around the thing, as they count, those on it.
    """

    normal: Point
    offset_m: float
    spread_m: float
    share: float

    __repr__ = by_fields


def find_support(views: Sequence[PosedDepth], center: Floats, noise: float) -> Support | str:
    """Return the plane that what is at `center` stands on, or the reason why there is none.

    Parameters
    ----------
    views : some frames of the scan.
    center : (3,) of the thing, metres.
    noise : standard deviation of depth, metres.
    """
    poses = np.array([view.pose for view in views])
    up = _up(poses)
    distance = float(np.median(np.linalg.norm(poses[:, :3, 3] - center, axis=1)))
    points, normals = _around(views, center, distance)
    if len(points) < 100:
        return f"there are only {len(points)} points within {distance:.2g} m of what the cameras look at"
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
        refused.append(f"the plane of {share:.0%} of the points {why}")
        left = np.where(np.abs(points @ normal - offset) < on, 0, left)
    level = f"no plane within {_TILT:g}° of level has {_LEAST_SHARE:.0%} of the points around the thing"
    return refused[0] if refused else level


def _up(poses: Floats) -> Floats:
    """Return what is roughly up (3,), also for telephones that are held upright."""
    if _spread(poses[:, :3, 1]) <= max(_WIDER * _spread(poses[:, :3, 0]), _SPREADING):
        return up_of_cameras(poses)
    rolled = poses.copy()
    rolled[:, :3, 0], rolled[:, :3, 1] = poses[:, :3, 1], -poses[:, :3, 0]
    up = up_of_cameras(rolled)
    # Whichever way they were turned: they look down on what stands on a plane.
    return up if up @ poses[:, :3, 2].mean(axis=0) < 0 else -up


def _spread(axes: Floats) -> float:
    """Return how far directions (n, 3) spread in a plane, more than across it."""
    moments = np.linalg.eigvalsh(axes.T @ axes / len(axes))
    return float(moments[1] - moments[0])


def _around(views: Sequence[PosedDepth], center: Floats, reach: float) -> tuple[Floats, Floats]:
    """Return points (n, 3) within reach of a place and their normals, one for each cell of a grid."""
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
    """Return normal and offset of the plane that most of the points lie on, as they count; None for none."""
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
    """Return how well points lie on a plane: from 1 on it to 0 (n,)."""
    weights = np.maximum(1 - ((points @ normal - offset) / on) ** 2, 0)
    return np.asarray(weights * (normals @ normal > math.cos(math.radians(_NORMAL))))


def _not_under(
    away: Floats, counts: Floats, normal: Floats, offset: float, on: float, distance: float
) -> str | None:
    """Say why a plane is not what the thing stands on; None if it is.

    Parameters
    ----------
    away : (n, 3) points, from the thing; offset : of the plane, from there as well.
    counts : (n,) how much each counts.
    """
    heights = away @ normal - offset
    if counts[heights < -2 * on].sum() > _MOST_BELOW * counts.sum():
        return "has most of what is there below it"
    beside = np.linalg.norm(away - np.outer(away @ normal, normal), axis=1)
    around = beside < _WIDTH * distance
    if np.count_nonzero(heights[around] > 2 * on) < _LEAST_ON_IT * np.count_nonzero(around):
        return "has nothing standing on it"
    return None
