"""Convex polytopes that make up collision geometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Half-space tests treat points within this ratio of the largest coordinate as inside. Planes of a hull and
# products of coordinates have rounding errors of that size.
_ROUNDING_RATIO = 1e-13
# Extent of a part along its thinnest axis, as a ratio of its longest one. Simulators refuse flat hulls.
_MIN_THICKNESS_RATIO = 1e-3


@dataclass(frozen=True, eq=False)
class OrientedBox:
    """Oriented box.

    Attributes
    ----------
    center : (3,) metres.
    axes : (3, 3) orthogonal unit vectors in rows, right-handed.
    half_sizes : (3,) half the extents along the axes, metres.
    """

    center: Floats
    axes: Floats
    half_sizes: Floats


@dataclass(frozen=True, eq=False)
class ConvexPart:
    """Convex hull with its faces and their half-spaces.

    Attributes
    ----------
    vertices : (k, 3) corners in metres.
    triangles : (f, 3) int32 faces, counter-clockwise seen from outside.
    planes : (f, 4) outward unit normals and offsets; a point x is inside where normal · x + offset ≤ 0.
    box : the part as a box; None for other shapes.
    """

    vertices: Floats
    triangles: NDArray[np.int32]
    planes: Floats
    box: OrientedBox | None = None

    @property
    def slack_m(self) -> float:
        """Rounding error of half-space tests."""
        return _ROUNDING_RATIO * float(np.abs(self.vertices).max())

    def translate(self, offset: Floats) -> ConvexPart:
        """Return a copy that is moved by an offset (3,); it is no box."""
        planes = self.planes.copy()
        planes[:, 3] -= planes[:, :3] @ offset
        return ConvexPart(self.vertices + offset, self.triangles, planes)

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


def try_build_part(points: Floats) -> ConvexPart | None:
    """Build the convex hull of points; None if it is flat or thinner than simulators accept."""
    from scipy.spatial import QhullError

    if len(points) < 4 or len(thicken_points(points)) > len(points):
        return None
    try:
        return build_part(points)
    except QhullError:
        return None


def build_box(points: Floats, axes: Floats, depth_m: float) -> ConvexPart:
    """Build the box along given axes that contains points and extends by `depth_m` along the last axis."""
    along = points @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    low[2] -= depth_m
    # Larger than rounding errors, so that the box contains the points.
    margin = 10 * _ROUNDING_RATIO * float(np.abs(points).max())
    box = OrientedBox((low + high) / 2 @ axes, axes, (high - low) / 2 + margin)
    signs = np.array(list(product((-1, 1), repeat=3)))
    part = build_part(box.center + signs * box.half_sizes @ axes)
    return replace(part, box=box)


def fit_rectangle(points: Floats, normal: Floats) -> Floats:
    """Return the axes (3, 3) of the smallest rectangle around points; the normal is the last axis."""
    first = np.linalg.svd(normal[None])[2][1]
    across = np.stack([first, np.cross(normal, first)])
    flat = points @ across.T
    outline = build_outline(flat)
    # One side of the smallest rectangle is on a side of the hull.
    areas = [np.ptp(flat @ (x, y)) * np.ptp(flat @ (-y, x)) for x, y in outline[:, :2].tolist()]
    x, y = outline[int(np.argmin(areas)), :2]
    side = x * across[0] + y * across[1]
    return np.stack([side, np.cross(normal, side), normal])


def build_outline(points: Floats) -> Floats:
    """Return the lines (k, 3) of the convex hull of 2-D points: outward unit normals and offsets."""
    from scipy.spatial import ConvexHull

    return np.asarray(ConvexHull(points).equations, np.float64)


def compute_separation(first: ConvexPart, second: ConvexPart) -> tuple[float, Floats, bool]:
    """Compute by how much a face plane of one of two parts separates them.

    Returns
    -------
    separation : metres. The parts are apart if it is positive. The depth of an overlap is at most minus the
        result.
    plane : (4,) outward normal and offset of the face.
    is_of_first : the face is one of the first part.
    """
    found = []
    for own, other in ((first, second), (second, first)):
        heights = (other.vertices @ own.planes[:, :3].T + own.planes[:, 3]).min(axis=0)
        face = int(heights.argmax())
        found.append((float(heights[face]), own.planes[face], own is first))
    return max(found, key=lambda one: one[0])


def measure_separation(first: ConvexPart, second: ConvexPart) -> float:
    """Return the separation of `compute_separation`, metres."""
    return compute_separation(first, second)[0]


def find_separating_plane(below: Floats, above: Floats) -> Floats | None:
    """Find a plane between two sets of points by linear programming.

    Returns
    -------
    (4,) unit normal and offset: normal · x + offset is negative for `below`, positive for `above`, and zero
    in the middle between both. None if no plane is found.
    """
    from scipy.optimize import linprog

    # Lengths are relative to the size of both sets, because the solver has absolute tolerances.
    center = below.mean(axis=0)
    size = max(float(np.abs(below - center).max()), float(np.abs(above - center).max()))
    rows = np.concatenate(
        [
            np.column_stack([(below - center) / size, -np.ones(len(below)), np.ones(len(below))]),
            np.column_stack([(center - above) / size, np.ones(len(above)), np.ones(len(above))]),
        ]
    )
    # Largest margin on both sides of the plane; the normal is bounded, so that a margin exists.
    bounds = [(-1, 1)] * 3 + [(None, None)] * 2
    solved = linprog([0, 0, 0, 0, -1], rows, np.zeros(len(rows)), bounds=bounds)
    if solved.status != 0 or not solved.x[:3].any():
        return None
    normal = solved.x[:3] / np.linalg.norm(solved.x[:3])
    low, high = float((below @ normal).max()), float((above @ normal).min())
    return np.append(normal, -(low + high) / 2) if low < high else None


def is_apart(first: ConvexPart, second: ConvexPart) -> bool:
    """Return True if a plane is proven to separate two parts."""
    return find_separating_plane(first.vertices, second.vertices) is not None


class PartSet:
    """Parts that are searched by bounding box.

    Parameters
    ----------
    parts : parts in the axes of the query.
    """

    def __init__(self, parts: Sequence[ConvexPart]) -> None:
        self._parts = parts
        self._low = np.array([part.vertices.min(axis=0) for part in parts]).reshape(-1, 3)
        self._high = np.array([part.vertices.max(axis=0) for part in parts]).reshape(-1, 3)

    def list_touching(self, part: ConvexPart) -> list[ConvexPart]:
        """List the parts that neither their bounding box nor a face plane separates from a part."""
        low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
        near = np.flatnonzero(((self._low < high) & (self._high > low)).all(axis=1))
        return [self._parts[row] for row in near.tolist() if measure_separation(self._parts[row], part) < 0]

    def is_clear(self, part: ConvexPart) -> bool:
        """Return True if a part touches none of the set."""
        return not self.list_touching(part)


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
        clip_part(part, along - middle - overlap_m / 2),
        clip_part(part, middle - overlap_m / 2 - along),
    )


def clip_part(part: ConvexPart, heights: Floats) -> ConvexPart:
    """Cut off the side of a part at which the heights (k,) of its corners are positive."""
    return part if heights.max() <= 0 else build_part(thicken_points(cut_points(part, heights)))


def cut_points(part: ConvexPart, heights: Floats) -> Floats:
    """Return the corners of the side of a part at which the heights (k,) of its corners are not positive."""
    a, b = np.concatenate((part.triangles[:, :2], part.triangles[:, 1:], part.triangles[:, ::2])).T
    crossing = heights[a] * heights[b] < 0
    a, b = a[crossing], b[crossing]
    ratio = (heights[a] / (heights[a] - heights[b]))[:, None]
    on_plane = part.vertices[a] * (1 - ratio) + part.vertices[b] * ratio
    return np.concatenate((part.vertices[heights <= 0], on_plane))


def concatenate_faces(parts: Sequence[ConvexPart]) -> tuple[Floats, NDArray[np.int32], NDArray[np.int64]]:
    """Return vertices and triangles of all parts, and the part (f,) of each triangle."""
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts)])[:-1]
    triangles = [part.triangles + offset for part, offset in zip(parts, offsets.tolist(), strict=True)]
    return (
        np.concatenate([part.vertices for part in parts]),
        np.concatenate(triangles).astype(np.int32),
        np.repeat(np.arange(len(parts)), [len(part.triangles) for part in parts]),
    )
