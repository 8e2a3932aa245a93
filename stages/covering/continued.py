"""Where a surface would go on: between its border on one side of a gap, and what is on the other side.

A wall that nobody looked at in its middle ends twice, and nothing but a straight line tells where the rest of
it is. From the border rays go on along the surface; what they meet not far away is the other side, if they
come through space that no frame has seen anything of.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.covering.patches import Patch, cut_up, squares, unit
from stages.covering.space import Space
from stages.covering.views import Floats
from stages.surface.edges import edges_of, next_corner
from stages.surface.mesh import Mesh
from stages.surface.raycasting import Surface

# Degrees that rays are turned out of the surface, and within it: borders are ragged, and surfaces bent.
_TILTS = (-10.0, -5.0, 0.0, 5.0, 10.0)
_TURNS = (-30.0, 0.0, 30.0)
# Of the sum of directions of a stretch of border, the least length: less goes all ways.
_STRAIGHT = 0.5
# Cells from the border on where rays begin, and how many there are to the other side at least.
_START, _LEAST = 1.5, 3.0
# Of what a ray comes through, the share of which nothing is known, at least, and that is empty, at most.
_UNKNOWN, _FREE = 0.6, 0.1
# Rays through a cell; a single one may be astray.
_RAYS = 2


def continued(
    mesh: Mesh, normals: Floats, space: Space, surface: Surface, origin: Floats, reach: float, size: float
) -> list[Patch]:
    """Return what lies between the sides of gaps, cut up into patches of `size` metres at most.

    Parameters
    ----------
    normals : (n, 3) of the vertices.
    surface : of the mesh.
    reach : metres, how wide gaps may be.
    """
    places, ways, facing = _border(mesh, normals, space.cell)
    if not len(places):
        return []
    across = np.cross(facing, ways)
    turns, tilts = np.radians(_TURNS), np.radians(_TILTS)
    level = np.cos(turns)[:, None, None] * ways + np.sin(turns)[:, None, None] * across
    rays = np.cos(tilts)[:, None, None, None] * level + np.sin(tilts)[:, None, None, None] * facing
    count = len(_TURNS) * len(_TILTS)
    rays = rays.reshape(-1, 3)
    starts = np.tile(places, (count, 1)) + _START * space.cell * rays
    hits = surface.cast(starts, rays)
    lengths = hits.distances.astype(np.float64)
    near = (lengths <= reach) & (lengths >= _LEAST * space.cell)
    chosen, lengths = hits.rays[near], lengths[near]
    points, of = _along(starts[chosen] - origin, rays[chosen], lengths, space.cell)
    is_unknown, is_free = space.unknown_and_free(points)
    steps, unknown, free = (np.bincount(of, flags, len(chosen)) for flags in (None, is_unknown, is_free))
    kept = is_unknown & ((unknown >= _UNKNOWN * steps) & (free <= _FREE * steps))[of]
    facing = np.tile(facing, (count, 1))[chosen][of[kept]]
    return list(_patches(points[kept], facing, space, size))


def _border(mesh: Mesh, normals: Floats, cell: float) -> tuple[Floats, Floats, Floats]:
    """Return places on the border, which way the surface would go on there, and its normals, (k, 3) each.

    There is one for each cell that the border is in and that it does not wind about in.
    """
    edges = edges_of(mesh.triangles, len(mesh.vertices))
    border = edges.halfedges[edges.start[edges.count == 1]]
    corners = mesh.triangles.reshape(-1)
    first, second = corners[border], corners[next_corner(border)]
    middles = (mesh.vertices[first] + mesh.vertices[second]) / 2
    facing = normals[first] + normals[second]
    # A triangle lies to the left of its halfedges, seen from where its normal points.
    outwards = unit(np.cross(mesh.vertices[second] - mesh.vertices[first], facing))
    _, of = np.unique(np.floor(middles / cell).astype(np.int64), axis=0, return_inverse=True)
    of = of.reshape(-1)
    counts = np.bincount(of)
    means = [_means(values, of, counts) for values in (middles, outwards, unit(facing))]
    straight = np.linalg.norm(means[1], axis=1) >= _STRAIGHT
    places, ways, facing = (values[straight] for values in means)
    facing = unit(facing)
    ways = unit(ways - (ways * facing).sum(axis=1, keepdims=True) * facing)
    return places, ways, facing


def _along(starts: Floats, rays: Floats, lengths: Floats, spacing: float) -> tuple[Floats, NDArray[np.int64]]:
    """Return points along rays, and which ray each is of."""
    counts = np.ceil(lengths / spacing).astype(np.int64)
    of = np.repeat(np.arange(len(rays)), counts)
    step = np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = (step + 0.5) / counts[of]
    return starts[of] + (share * lengths[of])[:, None] * rays[of], of


def _patches(points: Floats, normals: Floats, space: Space, size: float) -> list[Patch]:
    """Return patches of the cells that points lie in, which face as their points do in the mean."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if not len(points):
        return []
    _, of = np.unique(np.floor(points / space.cell).astype(np.int64), axis=0, return_inverse=True)
    of = of.reshape(-1)
    counts = np.bincount(of)
    crossed = counts >= _RAYS
    if not crossed.any():
        return []
    middles = _means(points, of, counts)[crossed]
    facing = unit(_means(normals, of, counts)[crossed])
    # A plane goes through more cells the more it is aslant.
    areas = space.cell**2 / np.maximum(np.abs(facing).sum(axis=1), 1.0)
    pairs = cKDTree(middles).query_pairs(1.8 * space.cell, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs), np.int8), pairs.T), (len(middles), len(middles)))
    _, labels = connected_components(graph, directed=False)
    found = []
    for label in range(labels.max() + 1):
        (members,) = np.nonzero(labels == label)
        for rows in cut_up(middles[members], facing[members], areas[members], size):
            own = members[rows]
            area = float(areas[own].sum())
            corners = squares(middles[own], facing[own], space.cell)
            found.append(Patch("gap", middles[own], facing[own], areas[own], area, corners))
    return found


def _means(values: Floats, of: NDArray[np.intp], counts: NDArray[np.intp]) -> Floats:
    return np.stack([np.bincount(of, axis) / counts for axis in values.T], axis=1)
