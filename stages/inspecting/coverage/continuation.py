"""Gaps bridged by straight continuation of the surface.

The middle of a wall that no frame looked at leaves two boundaries. Two stretches of boundary belong together
on two conditions: each is where the surface would continue from the other, and no frame observed the space
between them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.boundary import SurfaceBoundary
from scanloom.stages.inspecting.coverage.carved_space import CarvedSpace
from scanloom.stages.inspecting.coverage.defect_patches import (
    DefectPatch,
    make_squares,
    normalize_vectors,
    split_patch,
)
from scanloom.stages.inspecting.coverage.depth_view import Floats

# Maximum number of boundary stretches. Every pair of stretches is tested.
_MAX_STRETCHES = 4000
_BATCH_SIZE = 250
# Minimum length of the mean outward direction of a stretch. Below it, the boundary winds in all directions.
_MIN_STRAIGHTNESS = 0.5
# Minimum cosine between the continuation direction and the line to the other side, minimum cosine between the
# normals of both sides, maximum sine between the line and the surface.
_MIN_AHEAD_COSINE, _MIN_NORMAL_COSINE, _MAX_LEVEL_SINE = 0.8, 0.8, 0.2
# Minimum distance between both sides, in cells.
_MIN_WIDTH_CELLS = 3.0
# Limits for the cells along a connecting line: minimum ratio of unknown cells, maximum ratio of free cells.
_MIN_UNKNOWN_RATIO, _MAX_FREE_RATIO = 0.6, 0.1
# Maximum distance of neighbouring cells, in cells.
_NEIGHBOUR_DISTANCE_CELLS = 1.8


def find_continuation_gaps(
    border: SurfaceBoundary, space: CarvedSpace, origin: Floats, max_width: float, max_patch_size: float
) -> list[DefectPatch]:
    """Find gaps where the surface would continue, split into patches.

    Parameters
    ----------
    border : boundary of the whole mesh.
    space : space carved by the frames.
    origin : (3,) origin of the coordinates of `space` and of the patches, metres.
    max_width : maximum width of a gap, metres.
    max_patch_size : maximum size of a patch, metres.
    """
    positions, directions, normals = _group_stretches(border, space.cell_size)
    one, other = _pair_stretches(
        positions, directions, normals, _MIN_WIDTH_CELLS * space.cell_size, max_width
    )
    if not len(one):
        return []
    points, of = _sample_segments(positions[one] - origin, positions[other] - origin, space.cell_size)
    is_unknown, is_free = space.classify_points(points)
    steps, unknown, free = (np.bincount(of, flags, len(one)) for flags in (None, is_unknown, is_free))
    kept = is_unknown & ((unknown >= _MIN_UNKNOWN_RATIO * steps) & (free <= _MAX_FREE_RATIO * steps))[of]
    return _make_gap_patches(
        points[kept], (normals[one] + normals[other])[of[kept]], space.cell_size, max_patch_size
    )


def _group_stretches(border: SurfaceBoundary, cell_size: float) -> tuple[Floats, Floats, Floats]:
    """Group the boundary into straight stretches, at most one per cell.

    Returns
    -------
    places, ways, facing : (k, 3) each: positions in metres, unit directions in which the surface would
        continue, unit normals.
    """
    middles = (border.starts + border.ends) / 2
    # Seen against its normal, a triangle is on the left of its halfedges.
    outwards = normalize_vectors(np.cross(border.ends - border.starts, border.normal_sums))
    _, of = np.unique(np.floor(middles / cell_size).astype(np.int64), axis=0, return_inverse=True)
    of = of.reshape(-1)
    counts = np.bincount(of)
    means = [
        _average_groups(values, of, counts)
        for values in (middles, outwards, normalize_vectors(border.normal_sums))
    ]
    (straight,) = np.nonzero(np.linalg.norm(means[1], axis=1) >= _MIN_STRAIGHTNESS)
    chosen = straight[:: max(1, -(-len(straight) // _MAX_STRETCHES))]
    positions, directions, normals = (values[chosen] for values in means)
    normals = normalize_vectors(normals)
    directions = normalize_vectors(directions - (directions * normals).sum(axis=1, keepdims=True) * normals)
    return positions, directions, normals


def _pair_stretches(
    positions: Floats, directions: Floats, normals: Floats, min_width: float, max_width: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Find pairs of boundary stretches that face each other across a gap.

    Parameters
    ----------
    positions, directions, normals : (k, 3) as returned by `_group_stretches`.
    min_width, max_width : minimum and maximum width of the gap, metres.

    Returns
    -------
    Indices (p,) of the first and the second stretch of each pair.
    """
    ones, others = [np.zeros(0, np.intp)], [np.zeros(0, np.intp)]
    for start in range(0, len(positions), _BATCH_SIZE):
        rows = slice(start, start + _BATCH_SIZE)
        lines = positions[None] - positions[rows, None]
        lengths = np.linalg.norm(lines, axis=2)
        lines /= np.maximum(lengths, np.finfo(np.float64).tiny)[..., None]
        fits = (
            (lengths >= min_width)
            & (lengths <= max_width)
            & (normals[rows] @ normals.T >= _MIN_NORMAL_COSINE)
        )
        fits &= np.einsum("ijx,ix->ij", lines, directions[rows]) >= _MIN_AHEAD_COSINE
        fits &= np.einsum("ijx,jx->ij", lines, directions) <= -_MIN_AHEAD_COSINE
        fits &= np.abs(np.einsum("ijx,ix->ij", lines, normals[rows])) <= _MAX_LEVEL_SINE
        one, other = np.nonzero(fits)
        # The relation is symmetric; keep each pair once.
        ones.append(one[one + start < other] + start)
        others.append(other[one + start < other])
    return np.concatenate(ones), np.concatenate(others)


def _sample_segments(first: Floats, second: Floats, spacing: float) -> tuple[Floats, NDArray[np.int64]]:
    """Sample points along line segments, at about `spacing` metres.

    Returns the points (k, 3) and the segment index (k,) of each point.
    """
    lines = second - first
    counts = np.ceil(np.linalg.norm(lines, axis=1) / spacing).astype(np.int64)
    of = np.repeat(np.arange(len(lines)), counts)
    step = np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)
    return first[of] + ((step + 0.5) / counts[of])[:, None] * lines[of], of


def _make_gap_patches(
    points: Floats, normals: Floats, cell_size: float, max_patch_size: float
) -> list[DefectPatch]:
    """Group points into cells, and connected cells into gap patches.

    The normal of a cell is the mean of its points' normals.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if not len(points):
        return []
    _, of = np.unique(np.floor(points / cell_size).astype(np.int64), axis=0, return_inverse=True)
    of = of.reshape(-1)
    counts = np.bincount(of)
    middles, facing = (
        _average_groups(points, of, counts),
        normalize_vectors(_average_groups(normals, of, counts)),
    )
    # An oblique plane passes through more cells per area than an axis-aligned one.
    areas = cell_size**2 / np.maximum(np.abs(facing).sum(axis=1), 1.0)
    pairs = cKDTree(middles).query_pairs(_NEIGHBOUR_DISTANCE_CELLS * cell_size, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs), np.int8), pairs.T), (len(middles), len(middles)))
    _, labels = connected_components(graph, directed=False)
    order = np.argsort(labels, kind="stable")
    found = []
    for members in np.split(order, np.flatnonzero(np.diff(labels[order])) + 1):
        for rows in split_patch(middles[members], facing[members], areas[members], max_patch_size):
            own = members[rows]
            area = float(areas[own].sum())
            corners = make_squares(middles[own], facing[own], cell_size)
            found.append(DefectPatch("gap", middles[own], facing[own], areas[own], area, corners))
    return found


def _average_groups(values: Floats, group: NDArray[np.intp], counts: NDArray[np.intp]) -> Floats:
    return np.stack([np.bincount(group, axis) / counts for axis in values.T], axis=1)
