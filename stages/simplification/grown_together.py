"""Contacts between sheets: non-manifold edges and duplicate triangles created by simplification."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.simplification.result import Simplified
from scanloom.stages.simplification.seams.similar import equal_sets, may_have_equal
from scanloom.stages.surface.mesh import Mesh, Triangles
from scanloom.stages.surface.topology import repeats_vertex

Ids = NDArray[np.integer[Any]]


def grown_together(mesh: Mesh, light: Simplified[Any]) -> NDArray[np.bool_]:
    """Find vertices (n,) to lock so that touching sheets stay separate.

    Simplification keeps each sheet an oriented manifold. But two sheets that touch at two vertices may both
    get an edge between them. After welding, this is a non-manifold edge with four triangles. Sheets that
    touch at three vertices may get coincident triangles. The result marks vertices of contacts that `mesh`
    does not have, and their neighbours.

    Parameters
    ----------
    mesh : the sheets, with separate vertices.
    light : simplified sheets; its sources are vertices of `mesh`.
    """
    left = light.mesh
    stays = np.zeros(len(mesh.vertices), bool)
    if not may_have_equal(left.vertices):
        return stays
    place = equal_sets(mesh.vertices)
    own = equal_sets(left.vertices)
    # Sheets touch only at vertices that have not moved.
    of_source = np.zeros(int(own.max(initial=-1)) + 1, np.int64)
    of_source[own] = place[light.vertex_source]
    joined = np.zeros(len(of_source), bool)
    light_corners, corners = _where_shared(own, left.triangles), _where_shared(place, mesh.triangles)
    for sides, most in ((_edges, 2), (_whole, 1)):
        now, count = _counted(sides(light_corners))
        now, count = now[count > most], count[count > most]
        before, had = _counted(sides(corners))
        is_new = count > _looked_up(before, had, np.sort(of_source[now], axis=1))
        joined[now[is_new]] = True
    stays[light.vertex_source[joined[own]]] = True
    if not stays.any():
        return stays
    around = mesh.triangles[stays[mesh.triangles].any(axis=1)]
    stays[around] = True
    return stays


def _where_shared(place: Ids, triangles: Triangles) -> Ids:
    """Return the triangles (k, 3) with a vertex at a shared position.

    Corners are given as position indices.
    """
    is_shared = (np.bincount(place) > 1)[place]
    corners = place[triangles[is_shared[triangles].any(axis=1)]]
    return np.asarray(corners[~repeats_vertex(corners)])


def _edges(corners: Ids) -> Ids:
    """Return the edges (3 k, 2) of triangles, smaller index first."""
    return np.sort(corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)


def _whole(corners: Ids) -> Ids:
    """Return triangles (k, 3) with sorted vertices."""
    return np.sort(corners, axis=1)


def _counted(rows: Ids) -> tuple[Ids, NDArray[np.int64]]:
    """Count distinct rows, in lexicographic order."""
    found, count = np.unique(rows, axis=0, return_counts=True)
    return found, count


def _looked_up(rows: Ids, count: NDArray[np.int64], wanted: Ids) -> NDArray[np.int64]:
    """Look up the counts of the `wanted` rows; 0 if missing."""
    both, number = np.unique(np.concatenate([rows, wanted]), axis=0, return_inverse=True)
    times = np.zeros(len(both), np.int64)
    times[number.reshape(-1)[: len(rows)]] = count
    return np.asarray(times[number.reshape(-1)[len(rows) :]])
