"""Where sheets that only touch have become more of one: edges of more triangles, and triangles twice."""

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
    """Return the vertices (n,) of sheets that must stay with all their neighbours, or the surface changes.

    Each sheet is an oriented manifold, and simplifying it leaves it one. But where sheets touch at two
    vertices, each can come to have an edge between these, or where at three, a triangle: seen by place, that
    is an edge of four triangles, or a triangle upon another, which `mesh` has not.

    Parameters
    ----------
    mesh : the sheets, each with vertices of its own.
    light : what became of them; its sources are vertices of `mesh`.
    """
    left = light.mesh
    stays = np.zeros(len(mesh.vertices), bool)
    if not may_have_equal(left.vertices):
        return stays
    place = equal_sets(mesh.vertices)
    own = equal_sets(left.vertices)
    # What has not moved is at the place it had; only there can sheets touch.
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
    """Return the places of the corners (k, 3) of triangles that have one where several vertices are."""
    is_shared = (np.bincount(place) > 1)[place]
    corners = place[triangles[is_shared[triangles].any(axis=1)]]
    return np.asarray(corners[~repeats_vertex(corners)])


def _edges(corners: Ids) -> Ids:
    """Return the sides (3 k, 2) of triangles."""
    return np.sort(corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)


def _whole(corners: Ids) -> Ids:
    """Return triangles with their corners in ascending order."""
    return np.sort(corners, axis=1)


def _counted(rows: Ids) -> tuple[Ids, NDArray[np.int64]]:
    """Return the different rows in lexicographic order, and how often each occurs."""
    found, count = np.unique(rows, axis=0, return_counts=True)
    return found, count


def _looked_up(rows: Ids, count: NDArray[np.int64], wanted: Ids) -> NDArray[np.int64]:
    """Return how often each of `wanted` occurs among counted rows, 0 for those that do not."""
    both, number = np.unique(np.concatenate([rows, wanted]), axis=0, return_inverse=True)
    times = np.zeros(len(both), np.int64)
    times[number.reshape(-1)[: len(rows)]] = count
    return np.asarray(times[number.reshape(-1)[len(rows) :]])
