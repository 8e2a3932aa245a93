"""Triangulation of polygons.

Polygons that are star-shaped about their first corner, as convex ones are, become triangle fans in bulk.
Other quads are cut along their other diagonal. Other polygons are triangulated by mapbox's earcut in the
plane of their mean normal (Newell's method: Sutherland, Sproull and Schumacker, 1974). Every corner stays a
corner of a triangle, so neighbouring polygons stay connected.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import LocationLike
from scanloom.stages.surface.codes import MESH_LEFT_OUT, MESH_POLYGONS_NOT_SIMPLE, MESH_POLYGONS_SPLIT

# Ratios to the polygon's area: a triangle below the first counts as degenerate; areas within the second count
# as equal.
_MIN_AREA_RATIO = 1e-10
_AREA_TOLERANCE = 1e-6

Indices = NDArray[np.int64]
Points = NDArray[np.float64]


def triangulate_polygons(
    lengths: Indices, indices: Indices, vertices: Points, where: LocationLike
) -> tuple[Indices, Indices]:
    """Triangulate polygons, keeping their orientation.

    Diagnostics report the number of triangulated polygons, and those that self-intersect, have no area, or
    have fewer than three corners.

    Parameters
    ----------
    lengths : (p,) corner count of each polygon.
    indices : (c,) vertex index of each corner, polygon by polygon; can be out of range.
    vertices : (n, 3) float64.
    where : file, for messages.

    Returns
    -------
    corners : (m, 3) positions in `indices`.
    source : (m,) polygon of each triangle.
    """
    if (lengths == 3).all():
        return np.arange(3 * len(lengths)).reshape(-1, 3), np.arange(len(lengths))
    fan = np.maximum(lengths - 2, 0)
    source = np.repeat(np.arange(len(fan)), fan)
    within = np.arange(len(source)) - np.repeat(np.cumsum(fan) - fan, fan)
    first = (np.cumsum(lengths) - lengths)[source]
    corners = np.stack((first, first + within + 1, first + within + 2), axis=1)
    if (fan > 1).any():
        split_count = np.count_nonzero(fan > 1)
        emit(
            MESH_POLYGONS_SPLIT.info("{count:,} polygons were split into triangles", where, count=split_count)
        )
        _fix_concave_polygons(corners, source, fan, indices, vertices, where)
    if (fan == 0).any():
        left_out = np.count_nonzero(fan == 0)
        emit(
            MESH_LEFT_OUT.warning(
                "{count:,} faces of fewer than three corners are left out", where, count=left_out
            )
        )
    return corners, source


def _fix_concave_polygons(
    corners: Indices, source: Indices, fan: Indices, indices: Indices, vertices: Points, where: LocationLike
) -> None:
    """Replace fans that contain flipped or degenerate triangles, in place."""
    split = np.flatnonzero((fan > 1)[source])
    used = indices[corners[split]]
    if used.size == 0 or used.min() < 0 or used.max() >= len(vertices):
        return  # the caller refuses indices out of range
    doubled = _compute_doubled_normals(vertices[used])
    polygon, row = np.unique(source[split], return_inverse=True)
    normal: Points = np.stack([np.bincount(row, doubled[:, k]) for k in range(3)], axis=1)
    is_concave = np.bincount(row, ~(_compute_area_ratios(doubled, normal[row]) > _MIN_AREA_RATIO)) > 0
    begins = np.searchsorted(source, polygon)

    is_quad = fan[polygon] == 2
    quads = np.flatnonzero(is_concave & is_quad)
    failed_count = _flip_quad_diagonals(corners, begins[quads], normal[quads], indices, vertices)
    for number in np.flatnonzero(is_concave & ~is_quad).tolist():
        count = int(fan[polygon[number]])
        rows = slice(int(begins[number]), int(begins[number]) + count)
        start = int(corners[rows][0, 0])
        ring = vertices[indices[start : start + count + 2]]
        triangles = _triangulate_ring(ring, normal[number])
        if triangles is None:
            failed_count += 1
        else:
            corners[rows] = start + triangles
    if failed_count:
        emit(
            MESH_POLYGONS_NOT_SIMPLE.warning(
                "{count:,} polygons intersect themselves or have no area: they are split as if convex",
                where,
                count=failed_count,
            )
        )


def _flip_quad_diagonals(
    corners: Indices, first: Indices, normal: Points, indices: Indices, vertices: Points
) -> int:
    """Cut quads along their other diagonal, in place; return the number that stays invalid.

    Parameters
    ----------
    corners : (m, 3) corners of all triangles, modified.
    first : (q,) row in `corners` of the first of each quad's two triangles.
    normal : (q, 3) normals of the quads.
    """
    (a, b, c), d = corners[first].T, corners[first + 1, 2]
    halves = np.stack((np.stack((b, c, d), axis=1), np.stack((b, d, a), axis=1)), axis=1)
    doubled = _compute_doubled_normals(vertices[indices[halves.reshape(-1, 3)]])
    share = _compute_area_ratios(doubled, np.repeat(normal, 2, axis=0)).reshape(-1, 2)
    whole = (share > _MIN_AREA_RATIO).all(axis=1)
    corners[first[whole]], corners[first[whole] + 1] = halves[whole, 0], halves[whole, 1]
    return int((~whole).sum())


def _compute_doubled_normals(triangles: Points) -> Points:
    """Return normals (m, 3) of triangles (m, 3, 3), twice the area long."""
    # Relative to the first corner, for precision of small polygons far from the origin.
    with np.errstate(all="ignore"):
        return np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def _compute_area_ratios(doubled: Points, normal: Points) -> Points:
    """Return each triangle's signed area as a ratio of its polygon's area.

    It is negative for a flipped triangle.
    """
    with np.errstate(all="ignore"):
        return np.asarray((doubled * normal).sum(axis=1) / (normal * normal).sum(axis=1))


def _triangulate_ring(ring: Points, normal: Points) -> Indices | None:
    """Triangulate a polygon of n points with earcut.

    Returns
    -------
    Triangles (n - 2, 3), or None if the polygon self-intersects or has no area.
    """
    from mapbox_earcut import triangulate_float64

    length = np.linalg.norm(normal)
    if not np.isfinite(length) or length == 0 or not np.isfinite(ring).all():
        return None
    flat = _project_to_plane(ring - ring[0], normal / length)
    flat /= abs(flat).max()
    found = triangulate_float64(np.ascontiguousarray(flat), np.array([len(flat)], np.uint32))
    triangles = found.astype(np.int64).reshape(-1, 3)
    doubled = _compute_doubled_areas(flat, triangles)
    # All triangles of earcut have one orientation, which can differ from the polygon's.
    if len(triangles) and doubled.sum() < 0:
        triangles = triangles[:, ::-1]
    after = np.roll(flat, -1, axis=0)
    whole = (flat[:, 0] * after[:, 1] - flat[:, 1] * after[:, 0]).sum()
    if not abs(abs(doubled).sum() - whole) <= _AREA_TOLERANCE * whole:
        return None
    return _restore_dropped_corners(triangles, len(flat))


def _project_to_plane(points: Points, normal: Points) -> Points:
    """Project points (n, 3) to the plane of a unit normal, keeping their orientation."""
    axis = np.eye(3)[abs(normal).argmin()]
    across = np.cross(normal, axis)
    across /= np.linalg.norm(across)
    return np.stack((points @ across, points @ np.cross(normal, across)), axis=1)


def _compute_doubled_areas(flat: Points, triangles: Indices) -> Points:
    a, b, c = flat[triangles].transpose(1, 0, 2)
    ab, ac = b - a, c - a
    return np.asarray(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])


def _restore_dropped_corners(triangles: Indices, count: int) -> Indices | None:
    """Reinsert corners that earcut drops as collinear or duplicate; None if impossible.

    Example: corners d and e were dropped between a and b. They split the triangle a b c into a d c, d e c and
    e b c.
    """
    if len(triangles) == count - 2:
        return triangles
    kept = np.unique(triangles)
    if len(kept) < 3:
        return None
    across = {}
    for a, b, c in triangles.tolist():
        across.update({(a, b): c, (b, c): a, (c, a): b})
    for a, b in zip(kept.tolist(), np.roll(kept, -1).tolist(), strict=True):
        chain = [a, *((a + k) % count for k in range(1, (b - a) % count)), b]
        if len(chain) == 2:
            continue
        apex = across.pop((a, b), None)
        if apex is None:
            return None
        for d, e in pairwise(chain):
            across.update({(d, e): apex, (e, apex): d, (apex, d): e})
    result = sorted({_rotate_to_smallest(a, b, c) for (a, b), c in across.items()})
    return np.array(result, np.int64) if len(result) == count - 2 else None


def _rotate_to_smallest(a: int, b: int, c: int) -> tuple[int, int, int]:
    return min((a, b, c), (b, c, a), (c, a, b))
