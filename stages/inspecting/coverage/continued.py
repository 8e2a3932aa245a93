"""Where a surface would go on: between its border on one side of a gap, and its border on the other.

A wall that nobody looked at in its middle ends twice, and nothing but a straight line tells where the rest of
it is. Two stretches of border belong together if each lies where the surface would go on from the other, and
no frame has seen anything of what is between them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.borders import Border
from scanloom.stages.inspecting.coverage.patches import Patch, cut_up, squares, unit
from scanloom.stages.inspecting.coverage.space import Space
from scanloom.stages.inspecting.coverage.views import Floats

# Stretches of border at most; each is looked at with all others.
_STRETCHES = 4000
_AT_ONCE = 250
# Of the sum of directions of a stretch of border, the least length: less goes all ways.
_STRAIGHT = 0.5
# Cosines of how far the other side may be off the way that the surface goes on, of how far the surface may
# turn on the way, and sine of how far the line between both may leave it.
_AHEAD, _ALIKE, _LEVEL = 0.8, 0.8, 0.2
# Cells between both sides, at least.
_LEAST = 3.0
# Of what a line comes through, the share of which nothing is known, at least, and that is empty, at most.
_UNKNOWN, _FREE = 0.6, 0.1
# Cells that are neighbours.
_BESIDE = 1.8


def continued(border: Border, space: Space, origin: Floats, reach: float, size: float) -> list[Patch]:
    """Return what lies between the sides of gaps, cut up into patches of `size` metres at most.

    Parameters
    ----------
    border : of all of the mesh.
    reach : metres, how wide gaps may be.
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
    """Return places on the border, which way the surface would go on there, and its normals, (k, 3) each.

    There is one for each cell that the border is in and that it does not wind about in.
    """
    middles = (border.starts + border.ends) / 2
    # A triangle lies to the left of its halfedges, seen from where its normal points.
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
    """Return pairs of stretches of border that belong together."""
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
        # Each pair once.
        ones.append(one[one + start < other] + start)
        others.append(other[one + start < other])
    return np.concatenate(ones), np.concatenate(others)


def _between(first: Floats, second: Floats, spacing: float) -> tuple[Floats, NDArray[np.int64]]:
    """Return points along lines, and which line each is of."""
    lines = second - first
    counts = np.ceil(np.linalg.norm(lines, axis=1) / spacing).astype(np.int64)
    of = np.repeat(np.arange(len(lines)), counts)
    step = np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)
    return first[of] + ((step + 0.5) / counts[of])[:, None] * lines[of], of


def _patches(points: Floats, normals: Floats, cell: float, size: float) -> list[Patch]:
    """Return patches of the cells that points lie in, which face as their points do in the mean."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if not len(points):
        return []
    _, of = np.unique(np.floor(points / cell).astype(np.int64), axis=0, return_inverse=True)
    of = of.reshape(-1)
    counts = np.bincount(of)
    middles, facing = _means(points, of, counts), unit(_means(normals, of, counts))
    # A plane goes through more cells the more it is aslant.
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
