"""Patches of coverage defects: oriented points with areas.

A patch that is too large for one view is split recursively across its longest dimension. The normal counts as
an additional dimension, so that a defect around a corner or an object becomes several patches.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.depth_view import Floats

# Distance between opposite normals, as multiple of the maximum patch size.
_NORMAL_WEIGHT = 0.7


@dataclass(frozen=True, eq=False)
class DefectPatch:
    """Patch of a coverage defect.

    Attributes
    ----------
    kind : key of `KINDS`.
    points : (k, 3) float64, metres, relative to the origin.
    normals : (k, 3) float64, towards the viewer.
    areas : (k,) float64, m².
    area : m²; for faces of a grid, less than the sum of `areas`.
    display_triangles : (t, 3, 3) float64, triangles to display missing surface, relative to the origin; empty
        for
        existing surface.
    """

    kind: str
    points: Floats
    normals: Floats
    areas: Floats
    area: float
    display_triangles: Floats

    @property
    def middle(self) -> Floats:
        """Point (3,) of the patch nearest to its centroid."""
        mean = np.average(self.points, axis=0, weights=self.areas)
        nearest: Floats = self.points[((self.points - mean) ** 2).sum(axis=1).argmin()]
        return nearest

    @property
    def normal(self) -> Floats:
        """Mean unit normal (3,); 0 if the normals cancel out."""
        total = self.areas @ self.normals
        return np.asarray(total / max(float(np.linalg.norm(total)), np.finfo(np.float64).tiny))

    @property
    def extent(self) -> float:
        """Longest side of the axis-aligned bounding box, metres."""
        return float(np.ptp(self.points, axis=0).max())


def split_patch(
    points: Floats, normals: Floats, areas: Floats, max_size: float
) -> Iterator[NDArray[np.int64]]:
    """Split a patch recursively into parts of at most `max_size` metres.

    Yields the rows of each part.
    """
    features = np.concatenate([points, 0.5 * _NORMAL_WEIGHT * max_size * normals], axis=1)
    pending = [np.arange(len(points))]
    while pending:
        rows = pending.pop()
        own = features[rows] - np.average(features[rows], axis=0, weights=areas[rows])
        axis = np.linalg.eigh((own * areas[rows, None]).T @ own)[1][:, -1]
        along = own @ axis
        if len(rows) < 2 or np.ptp(along) <= max_size:
            yield rows
            continue
        # Split at half the length. Splitting at half the area would leave long thin ends.
        first = along < (along.min() + along.max()) / 2
        pending += [rows[first], rows[~first]]


def compute_plane_area(normals: Floats, areas: Floats) -> float:
    """Compute the area that a staircase of grid faces approximates, m².

    The area is measured on the plane through the faces.
    """
    return float(np.linalg.norm(areas @ normals))


def make_squares(points: Floats, normals: Floats, side_length: float) -> Floats:
    """Build squares around points, perpendicular to their normals.

    Returns the corners (2k, 3, 3) of two triangles per square.
    """
    first = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    first = normalize_vectors(first) * side_length / 2
    second = np.cross(normals, first)
    corners = [points + s * first + t * second for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    halves = [np.stack([corners[i] for i in three], axis=1) for three in ((0, 1, 2), (0, 2, 3))]
    return np.stack(halves, axis=1).reshape(-1, 3, 3)


def normalize_vectors(values: Floats) -> Floats:
    """Normalise vectors (k, 3); zero vectors stay zero."""
    lengths = np.linalg.norm(values, axis=1, keepdims=True)
    return np.asarray(values / np.maximum(lengths, np.finfo(np.float64).tiny))
