"""Gaps bridged by straight continuation of the surface.

The middle of a wall that no frame looked at leaves two boundaries. Two stretches of boundary belong together
on two conditions: each is where the surface would continue from the other, and no frame observed the space
between them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.borders import Border
from scanloom.stages.inspecting.coverage.patches import Patch, cut_up, squares, unit
from scanloom.stages.inspecting.coverage.space import Space
from scanloom.stages.inspecting.coverage.views import Floats

# Maximum number of boundary stretches. Every pair of stretches is tested.
_STRETCHES = 4000
_AT_ONCE = 250
# Minimum length of the mean outward direction of a stretch. Below it, the boundary winds in all directions.
_STRAIGHT = 0.5
# Minimum cosine between the continuation direction and the line to the other side, minimum cosine between the
# normals of both sides, maximum sine between the line and the surface.
_AHEAD, _ALIKE, _LEVEL = 0.8, 0.8, 0.2
# Minimum distance between both sides, in cells.
_LEAST = 3.0
# Limits for the cells along a connecting line: minimum ratio of unknown cells, maximum ratio of free cells.
_UNKNOWN, _FREE = 0.6, 0.1
# Maximum distance of neighbouring cells, in cells.
_BESIDE = 1.8


def continued(border: Border, space: Space, origin: Floats, reach: float, size: float) -> list[Patch]:
    """Find gaps where the surface would continue, split into patches.

    Parameters
    ----------
    border : boundary of the whole mesh.
    space : space carved by the frames.
    origin : (3,) origin of the coordinates of `space` and of the patches, metres.
    reach : maximum width of a gap, metres.
    size : maximum size of a patch, metres.
    """
    places, ways, facing = _stretches(border, space.cell)
    one, other = _pairs(places, ways, facing, _LEAST * space.cell, reach)
    if not len(one):
        return []
    points, of = _between(places[one] - origin, places[other] - origin, space.cell)
    is_unknown, is_free = space.unknown_and_free(points)
    steps, unknown, free = (np.bincount(of, flags, len(one)) for flags in (None, is_unknown, is_free))
    kept = is_unknown & ((unknown >= _UNKNOWN * steps) & (free <= _FREE * steps))[of]
    return _patches(points[kept], (facing[one] + facing[other])[of[kept]], space.cell, size)


def _stretches(border: Border, cell: float) -> tuple[Floats, Floats, Floats]:
    """Group the boundary into straight stretches, at most one per cell.

    Returns
    -------
    places, ways, facing : (k, 3) each: positions in metres, unit directions in which the surface would
        continue, unit normals.
    """
    middles = (border.starts + border.ends) / 2
    # Seen against its normal, a triangle is on the left of its halfedges.
    outwards = unit(np.cross(border.ends - border.starts, border.facing))
    _, of = np.unique(np.floor(middles / cell).astype(np.int64), axis=0, return_inverse=True)
    of = of.reshape(-1)
    counts = np.bincount(of)
    means = [_means(values, of, counts) for values in (middles, outwards, unit(border.facing))]
    (straight,) = np.nonzero(np.linalg.norm(means[1], axis=1) >= _STRAIGHT)
    chosen = straight[:: max(1, -(-len(straight) // _STRETCHES))]
    places, ways, facing = (values[chosen] for values in means)
    facing = unit(facing)
    ways = unit(ways - (ways * facing).sum(axis=1, keepdims=True) * facing)
    return places, ways, facing


def _pairs(
    places: Floats, ways: Floats, facing: Floats, least: float, reach: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Find pairs of stretches that face each other across a gap.

    Parameters
    ----------
    places, ways, facing : (k, 3) as returned by `_stretches`.
    least, reach : minimum and maximum width of the gap, metres.

    Returns
    -------
    Indices (p,) of the first and the second stretch of each pair.
    """
    ones, others = [np.zeros(0, np.intp)], [np.zeros(0, np.intp)]
    for start in range(0, len(places), _AT_ONCE):
        rows = slice(start, start + _AT_ONCE)
        lines = places[None] - places[rows, None]
        lengths = np.linalg.norm(lines, axis=2)
        lines /= np.maximum(lengths, np.finfo(np.float64).tiny)[..., None]
        fits = (lengths >= least) & (lengths <= reach) & (facing[rows] @ facing.T >= _ALIKE)
        fits &= np.einsum("ijx,ix->ij", lines, ways[rows]) >= _AHEAD
        fits &= np.einsum("ijx,jx->ij", lines, ways) <= -_AHEAD
        fits &= np.abs(np.einsum("ijx,ix->ij", lines, facing[rows])) <= _LEVEL
        one, other = np.nonzero(fits)
        # The relation is symmetric; keep each pair once.
        ones.append(one[one + start < other] + start)
        others.append(other[one + start < other])
    return np.concatenate(ones), np.concatenate(others)


def _between(first: Floats, second: Floats, spacing: float) -> tuple[Floats, NDArray[np.int64]]:
    """Sample points along line segments, at about `spacing` metres.

    Returns the points (k, 3) and the segment index (k,) of each point.
    """
    lines = second - first
    counts = np.ceil(np.linalg.norm(lines, axis=1) / spacing).astype(np.int64)
    of = np.repeat(np.arange(len(lines)), counts)
    step = np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)
    return first[of] + ((step + 0.5) / counts[of])[:, None] * lines[of], of


def _patches(points: Floats, normals: Floats, cell: float, size: float) -> list[Patch]:
    """Group points into cells, and connected cells into gap patches.

    The normal of a cell is the mean of its points' normals.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if not len(points):
        return []
    _, of = np.unique(np.floor(points / cell).astype(np.int64), axis=0, return_inverse=True)
    of = of.reshape(-1)
    counts = np.bincount(of)
    middles, facing = _means(points, of, counts), unit(_means(normals, of, counts))
    # An oblique plane passes through more cells per area than an axis-aligned one.
    areas = cell**2 / np.maximum(np.abs(facing).sum(axis=1), 1.0)
    pairs = cKDTree(middles).query_pairs(_BESIDE * cell, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs), np.int8), pairs.T), (len(middles), len(middles)))
    _, labels = connected_components(graph, directed=False)
    order = np.argsort(labels, kind="stable")
    found = []
    for members in np.split(order, np.flatnonzero(np.diff(labels[order])) + 1):
        for rows in cut_up(middles[members], facing[members], areas[members], size):
            own = members[rows]
            area = float(areas[own].sum())
            corners = squares(middles[own], facing[own], cell)
            found.append(Patch("gap", middles[own], facing[own], areas[own], area, corners))
    return found


def _means(values: Floats, of: NDArray[np.intp], counts: NDArray[np.intp]) -> Floats:
    return np.stack([np.bincount(of, axis) / counts for axis in values.T], axis=1)
