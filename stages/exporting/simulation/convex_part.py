"""Convex polytopes that make up collision geometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Half-space tests treat points within this ratio of the largest coordinate as inside. Planes of a hull and
# products of coordinates have rounding errors of that size.
_ROUNDING_RATIO = 1e-13
# Extent of a part along its thinnest axis, as a ratio of its longest one. Simulators refuse flat hulls.
_MIN_THICKNESS_RATIO = 1e-3


@dataclass(frozen=True, eq=False)
class ConvexPart:
    """Convex hull with its faces and their half-spaces.

    Attributes
    ----------
    vertices : (k, 3) corners in metres.
    triangles : (f, 3) int32 faces, counter-clockwise seen from outside.
    planes : (f, 4) outward unit normals and offsets; a point x is inside where normal · x + offset ≤ 0.
    """

    vertices: Floats
    triangles: NDArray[np.int32]
    planes: Floats

    @property
    def slack_m(self) -> float:
        """Rounding error of half-space tests."""
        return _ROUNDING_RATIO * float(np.abs(self.vertices).max())

    def compute_heights(self, points: Floats) -> Floats:
        """Compute the largest signed distance (n,) of points to the planes; negative inside."""
        if not len(points):
            return np.zeros(0)
        heights = points @ self.planes[:, :3].T + self.planes[:, 3]
        return np.asarray(heights.max(axis=1))

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """Return a mask (n,) of the points inside or on the boundary."""
        slack = self.slack_m
        low, high = self.vertices.min(axis=0) - slack, self.vertices.max(axis=0) + slack
        inside = np.asarray(((points >= low) & (points <= high)).all(axis=1))
        near = np.flatnonzero(inside)
        inside[near] = self.compute_heights(points[near]) <= slack
        return inside


def build_part(points: Floats) -> ConvexPart:
    """Build the convex hull of points, which must span a volume."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    index = np.zeros(len(points), np.int32)
    index[hull.vertices] = np.arange(len(hull.vertices), dtype=np.int32)
    triangles = index[hull.simplices]
    vertices = np.ascontiguousarray(points[hull.vertices], np.float64)
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    is_inward = np.einsum("fx,fx->f", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    triangles[is_inward] = triangles[is_inward][:, ::-1]
    return ConvexPart(vertices, triangles, np.asarray(hull.equations, np.float64))


def thicken_points(points: Floats, min_thickness_m: float = 0.0) -> Floats:
    """Return points whose hull contains the given points and spans a volume.

    Points that are flat, or flatter than `min_thickness_m`, are copied to both sides along the thin axes.
    """
    center = points.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((points - center).T))
    along = (points - center) @ axes
    extents = np.ptp(along, axis=0)
    wanted = max(min_thickness_m, _MIN_THICKNESS_RATIO * float(extents.max()))
    for axis in np.flatnonzero(extents < wanted):
        offset = axes[:, axis] * (wanted - extents[axis]) / 2
        points = np.concatenate((points + offset, points - offset))
    return points


def split_part(part: ConvexPart, overlap_m: float) -> tuple[ConvexPart, ConvexPart]:
    """Split a part across its longest axis in two halves that overlap by `overlap_m`."""
    center = part.vertices.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((part.vertices - center).T))
    along = (part.vertices - center) @ axes[:, 2]
    middle = (along.min() + along.max()) / 2
    return (
        _cut_part(part, along - middle - overlap_m / 2),
        _cut_part(part, middle - overlap_m / 2 - along),
    )


def _cut_part(part: ConvexPart, heights: Floats) -> ConvexPart:
    """Cut off the side of a part at which the heights (k,) of its corners are positive."""
    a, b = np.concatenate((part.triangles[:, :2], part.triangles[:, 1:], part.triangles[:, ::2])).T
    crossing = heights[a] * heights[b] < 0
    a, b = a[crossing], b[crossing]
    ratio = (heights[a] / (heights[a] - heights[b]))[:, None]
    on_plane = part.vertices[a] * (1 - ratio) + part.vertices[b] * ratio
    return build_part(thicken_points(np.concatenate((part.vertices[heights <= 0], on_plane))))


def concatenate_faces(parts: Sequence[ConvexPart]) -> tuple[Floats, NDArray[np.int32], NDArray[np.int64]]:
    """Return vertices and triangles of all parts, and the part (f,) of each triangle."""
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts)])[:-1]
    triangles = [part.triangles + offset for part, offset in zip(parts, offsets.tolist(), strict=True)]
    return (
        np.concatenate([part.vertices for part in parts]),
        np.concatenate(triangles).astype(np.int32),
        np.repeat(np.arange(len(parts)), [len(part.triangles) for part in parts]),
    )
