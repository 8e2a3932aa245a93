"""Patches of what is missing: points with the way they face and the area that each stands for.

A patch that is too large for one look is cut in two across its longest way, again and again; which way it
faces counts as a way, too, so that what goes around a corner, or around a thing, becomes several.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.views import Floats

# Facing the other way is as far apart as so many of the largest patches.
_TURN = 0.7


@dataclass(frozen=True, eq=False)
class Patch:
    """A patch.

    Attributes
    ----------
    kind : of `scanloom.stages.inspecting.coverage.kinds`.
    points : (k, 3) float64, metres, from the origin on.
    normals : (k, 3) float64, to where one looks at it from.
    areas : (k,) float64, m².
    area : m²; of steps of a grid less than the sum of their faces.
    corners : (t, 3, 3) float64 of triangles that show what is not there, from the origin on; none of what is.
    """

    kind: str
    points: Floats
    normals: Floats
    areas: Floats
    area: float
    corners: Floats

    @property
    def middle(self) -> Floats:
        """Return the point (3,) of it that is nearest to its middle."""
        mean = np.average(self.points, axis=0, weights=self.areas)
        nearest: Floats = self.points[((self.points - mean) ** 2).sum(axis=1).argmin()]
        return nearest

    @property
    def normal(self) -> Floats:
        """Return the mean of where it faces, (3,) of length 1; 0 if it faces all ways."""
        total = self.areas @ self.normals
        return np.asarray(total / max(float(np.linalg.norm(total)), np.finfo(np.float64).tiny))

    @property
    def extent(self) -> float:
        """Return how far its points are apart at most, along an axis of the world, metres."""
        return float(np.ptp(self.points, axis=0).max())


def cut_up(points: Floats, normals: Floats, areas: Floats, size: float) -> Iterator[NDArray[np.int64]]:
    """Yield the rows of patches no larger than `size` metres that make up a larger one."""
    ways = np.concatenate([points, 0.5 * _TURN * size * normals], axis=1)
    waiting = [np.arange(len(points))]
    while waiting:
        rows = waiting.pop()
        own = ways[rows] - np.average(ways[rows], axis=0, weights=areas[rows])
        axis = np.linalg.eigh((own * areas[rows, None]).T @ own)[1][:, -1]
        along = own @ axis
        if len(rows) < 2 or np.ptp(along) <= size:
            yield rows
            continue
        # In the middle of its length: halves of one area would leave a long thin end with most of the way.
        first = along < (along.min() + along.max()) / 2
        waiting += [rows[first], rows[~first]]


def total_area(normals: Floats, areas: Floats) -> float:
    """Return the area of what faces as steps of a grid do, m²: that of the plane through them."""
    return float(np.linalg.norm(areas @ normals))


def squares(points: Floats, normals: Floats, side: float) -> Floats:
    """Return two triangles each, (2 k, 3, 3), for squares about points (k, 3), square to their normals."""
    first = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    first = unit(first) * side / 2
    second = np.cross(normals, first)
    corners = [points + s * first + t * second for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    halves = [np.stack([corners[i] for i in three], axis=1) for three in ((0, 1, 2), (0, 2, 3))]
    return np.stack(halves, axis=1).reshape(-1, 3, 3)


def unit(values: Floats) -> Floats:
    """Return vectors (k, 3) of length 1; 0 for those of none."""
    lengths = np.linalg.norm(values, axis=1, keepdims=True)
    return np.asarray(values / np.maximum(lengths, np.finfo(np.float64).tiny))
