"""Boundary surface of a region of space, by marching tetrahedra on selected cells of a grid.

Each cell is divided into the six tetrahedra along one of its diagonals (Kuhn's division), which match across
cells. There are no ambiguous cases, so the surface is closed and manifold. The part in each tetrahedron is
inside of it, so the surface does not intersect itself. Source: Doi and Koide, "An efficient method of
triangulating equi-valued surfaces by using tetrahedral cells", 1991.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations, product
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._open3d import import_open3d
from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.mesh import Mesh, Triangles, Vertices
from scanloom.stages.surface.raycasting import compute_bounding_box

Mask = NDArray[np.bool_]

# Vertices keep this distance from the ends of a grid edge, as a ratio of its length: else triangles would
# have no area.
_MIN_END_RATIO = 1 / 128
# The corners of a cell, and its tetrahedra as corners in positive orientation.
_CORNERS = np.array(list(product((0, 1), repeat=3)))
# Directions of the rays that count crossings. They are oblique, because scans have many axis-parallel edges.
# A ray can miss an edge in single precision, so a third one decides where two disagree.
_DIRECTIONS = np.array([[0.5377, 0.2113, 0.8163], [-0.7431, 0.5501, 0.3811], [0.2719, -0.8919, -0.3613]])
# Rays per query; limits memory.
_RAY_CHUNK = 1 << 16


def _make_tetrahedra() -> NDArray[np.int64]:
    found = []
    for order in permutations(range(3)):
        corner, path = np.zeros(3, int), [0]
        for axis in order:
            corner[axis] = 1
            path.append(int(corner @ (4, 2, 1)))
        a, b, c, d = _CORNERS[path]
        if np.linalg.det(np.stack([b - a, c - a, d - a])) < 0:
            path[1], path[2] = path[2], path[1]
        found.append(path)
    return np.array(found)


def _make_cases() -> list[tuple[list[int], bool] | None]:
    """Return an even permutation of a tetrahedron's corners for each set of inside corners.

    Inside corners come first, or the only outside corner does; the flag is True in the latter case.
    """
    cases: list[tuple[list[int], bool] | None] = [None] * 16
    for bits in range(1, 15):
        inside = [i for i in range(4) if bits >> i & 1]
        is_reversed = len(inside) == 3
        first = [i for i in range(4) if i not in inside] if is_reversed else inside
        rest = [i for i in range(4) if i not in first]
        order = first + rest
        inversions = sum(order[i] > order[j] for i in range(4) for j in range(i + 1, 4))
        if inversions % 2:
            order[2], order[3] = order[3], order[2]
        cases[bits] = order, is_reversed
    return cases


_TETRAHEDRA = _make_tetrahedra()
_CASES = _make_cases()


class SolidRegion(Protocol):
    """A region of space."""

    def is_inside(self, points: Vertices) -> Mask:
        """Return a mask (k,) of the points (k, 3) that are in the region."""

    def find_crossings(self, inner: Vertices, outer: Vertices) -> NDArray[np.float64]:
        """Return the boundary on segments from inside to outside, (k,) as ratios of their lengths."""


def extract_boundary(region: SolidRegion, cells: Ids, size: float) -> Mesh:
    """Extract the boundary of a region that does not reach the outside of some grid cells.

    Parameters
    ----------
    cells : (c, 3) integer coordinates of distinct cells, among them all that the boundary crosses. The
        corners of a cell are multiples of `size`.
    size : edge length of a cell, metres.

    Returns
    -------
    Oriented manifold; without triangles if no cell has nodes on both sides.
    """
    low, span = cells.min(axis=0), np.ptp(cells, axis=0) + 2
    strides = np.array([span[1] * span[2], span[2], 1])
    keys, nodes = np.unique(((cells - low) @ strides)[:, None] + _CORNERS @ strides, return_inverse=True)
    nodes = nodes.reshape(-1, 8)
    positions = (np.stack(np.unravel_index(keys, tuple(span)), axis=1) + low) * size
    inside = region.is_inside(positions)
    count = inside[nodes].sum(axis=1)
    tetrahedra = nodes[(count > 0) & (count < 8)][:, _TETRAHEDRA].reshape(-1, 4)
    bits = inside[tetrahedra] @ np.array([1, 2, 4, 8])
    triangles = _list_triangles(tetrahedra, bits)
    if len(triangles) == 0:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    pairs = np.sort(triangles.reshape(-1, 2), axis=1) @ np.array([len(keys), 1])
    pairs, index = np.unique(pairs, return_inverse=True)
    first, second = np.divmod(pairs, len(keys))
    inner, outer = np.where(inside[first], (first, second), (second, first))
    ratios = region.find_crossings(positions[inner], positions[outer])
    ratios = ratios.clip(_MIN_END_RATIO, 1 - _MIN_END_RATIO)[:, None]
    vertices = positions[inner] + ratios * (positions[outer] - positions[inner])
    return Mesh(vertices, index.reshape(-1, 3).astype(np.int32))


def _list_triangles(tetrahedra: Ids, bits: Ids) -> Ids:
    """Return the triangles (k, 3, 2), each corner as a pair of grid nodes."""
    found = [np.zeros((0, 3, 2), np.int64)]
    for case, entry in enumerate(_CASES):
        own = tetrahedra[bits == case]
        if entry is None or len(own) == 0:
            continue
        order, is_reversed = entry
        a, b, c, d = own[:, order].T
        if case.bit_count() == 2:
            corners = [np.stack(pair, axis=1) for pair in ((a, c), (a, d), (b, d), (b, c))]
            found += [np.stack([corners[i] for i in rows], axis=1) for rows in ((0, 1, 2), (0, 2, 3))]
        else:
            rows = (0, 2, 1) if is_reversed else (0, 1, 2)
            corners = [np.stack((a, other), axis=1) for other in (b, c, d)]
            found.append(np.stack([corners[i] for i in rows], axis=1))
    return np.concatenate(found)


class _Hits(NamedTuple):
    """Intersections of rays: ray, +1 where it leaves the surface and −1 where it enters, and distance."""

    rays: Ids
    signs: Ids
    distances: NDArray[np.float64]


class WindingNumbers:
    """Winding numbers of a closed oriented surface, by counting crossings of rays.

    Parameters
    ----------
    mesh : closed oriented mesh; it can intersect itself.
    """

    def __init__(self, mesh: Mesh) -> None:
        box = compute_bounding_box(mesh)
        self._center, self._scale = box.mean(axis=0), 1 / float(np.linalg.norm(box[1] - box[0]))
        o3d = import_open3d()
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            o3d.core.Tensor(((mesh.vertices - self._center) * self._scale).astype(np.float32)),
            o3d.core.Tensor(mesh.triangles.astype(np.uint32)),
        )
        a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
        self._normals = np.cross(b - a, c - a)

    def is_inside(self, points: Vertices) -> Mask:
        """Return a mask (k,) of the points that the surface winds around at least once."""
        one, other = (self._count_crossings(points, direction) > 0 for direction in _DIRECTIONS[:2])
        (unsure,) = np.nonzero(one != other)
        one[unsure] = self._count_crossings(points[unsure], _DIRECTIONS[2]) > 0
        return one

    def find_crossings(self, inner: Vertices, outer: Vertices) -> NDArray[np.float64]:
        """Return where segments leave the surface for the last time, (k,) as ratios of their lengths."""
        found = np.full(len(inner), -1.0)
        for rows, hits in self._list_hits(inner, outer - inner):
            leaves = (hits.signs > 0) & (hits.distances < 1)
            np.maximum.at(found[rows], hits.rays[leaves], hits.distances[leaves])
        return np.where(found < 0, 0.5, found)

    def _count_crossings(self, points: Vertices, direction: NDArray[np.float64]) -> Ids:
        found = np.zeros(len(points), np.int64)
        for rows, hits in self._list_hits(points, np.broadcast_to(direction, points.shape)):
            np.add.at(found[rows], hits.rays, hits.signs)
        return found

    def _list_hits(self, points: Vertices, directions: Vertices) -> Iterator[tuple[slice, _Hits]]:
        """Yield all intersections of rays, for some rays at a time."""
        o3d = import_open3d()
        for start in range(0, len(points), _RAY_CHUNK):
            rows = slice(start, start + _RAY_CHUNK)
            rays = np.empty((len(points[rows]), 6), np.float32)
            rays[:, :3] = (points[rows] - self._center) * self._scale
            rays[:, 3:] = directions[rows] * self._scale
            hits = self._scene.list_intersections(o3d.core.Tensor(rays))
            triangles = hits["primitive_ids"].numpy().astype(np.int64)
            ray = hits["ray_ids"].numpy().astype(np.int64)
            facing = np.einsum("kx,kx->k", self._normals[triangles], directions[rows][ray])
            yield rows, _Hits(ray, np.sign(facing).astype(np.int64), hits["t_hit"].numpy().astype(np.float64))


def list_cells(points: Vertices, size: float, rings: int) -> Ids:
    """Return the distinct cells (c, 3) that contain points, and some rings of cells around."""
    if len(points) == 0:
        return np.zeros((0, 3), np.int64)
    cells = np.floor(points / size).astype(np.int64)
    low = cells.min(axis=0) - rings
    span = cells.max(axis=0) + rings + 1 - low
    strides = np.array([span[1] * span[2], span[2], 1])
    keys = np.unique((cells - low) @ strides)
    for stride in strides.tolist():
        keys = np.unique((keys[:, None] + stride * np.arange(-rings, rings + 1)).reshape(-1))
    return np.asarray(np.stack(np.unravel_index(keys, tuple(span)), axis=1) + low)


def sample_surface(vertices: Vertices, triangles: Triangles, spacing: float) -> Vertices:
    """Return points on triangles, at most `spacing` apart along each of their axes."""
    corners = vertices[triangles]
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    steps = np.maximum(np.ceil(lengths / spacing).astype(np.int64), 1)
    found = [np.zeros((0, 3))]
    for count in np.unique(steps).tolist():
        i, j = (axis.reshape(-1) for axis in np.mgrid[: count + 1, : count + 1])
        i, j = i[i + j <= count], j[i + j <= count]
        weights = np.stack([count - i - j, i, j], axis=1) / count
        found.append(np.einsum("kc,tcx->tkx", weights, corners[steps == count]).reshape(-1, 3))
    return np.concatenate(found)
