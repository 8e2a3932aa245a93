"""Contacts between sheets: non-manifold edges and duplicate triangles created by simplification."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.simplification.seams.similar_vertices import (
    group_equal_vertices,
    has_possible_duplicates,
)
from scanloom.stages.surface.mesh import Mesh, Triangles
from scanloom.stages.surface.topology import has_repeated_vertex

Ids = NDArray[np.integer[Any]]


def find_merging_contacts(mesh: Mesh, simplified: SimplificationResult[Any]) -> NDArray[np.bool_]:
    """Find vertices (n,) to lock so that touching sheets stay separate.

    Simplification keeps each sheet an oriented manifold. But two sheets that touch at two vertices may both
    get an edge between them. After welding, this is a non-manifold edge with four triangles. Sheets that
    touch at three vertices may get coincident triangles. The result marks vertices of contacts that `mesh`
    does not have, and their neighbours.

    Parameters
    ----------
    mesh : the sheets, with separate vertices.
    simplified : simplified sheets; its sources are vertices of `mesh`.
    """
    simplified_mesh = simplified.mesh
    is_locked = np.zeros(len(mesh.vertices), bool)
    if not has_possible_duplicates(simplified_mesh.vertices):
        return is_locked
    place = group_equal_vertices(mesh.vertices)
    own = group_equal_vertices(simplified_mesh.vertices)
    # Sheets touch only at vertices that have not moved.
    of_source = np.zeros(int(own.max(initial=-1)) + 1, np.int64)
    of_source[own] = place[simplified.vertex_source]
    joined = np.zeros(len(of_source), bool)
    light_corners, corners = (
        _select_shared_triangles(own, simplified_mesh.triangles),
        _select_shared_triangles(place, mesh.triangles),
    )
    for sides, max_count in ((_list_edges, 2), (_sort_corners, 1)):
        now, count = _count_rows(sides(light_corners))
        now, count = now[count > max_count], count[count > max_count]
        # Splits put equal vertices on an edge where sheets touch. Their sources are ends of that edge, so its
        # parts are no new contacts.
        sources = np.sort(of_source[now], axis=1)
        is_part = (sources[:, 1:] == sources[:, :-1]).any(axis=1)
        now, count, sources = now[~is_part], count[~is_part], sources[~is_part]
        before, counts_before = _count_rows(sides(corners))
        is_new = count > _look_up_counts(before, counts_before, sources)
        joined[now[is_new]] = True
    is_locked[simplified.vertex_source[joined[own]]] = True
    if not is_locked.any():
        return is_locked
    around = mesh.triangles[is_locked[mesh.triangles].any(axis=1)]
    is_locked[around] = True
    return is_locked


def _select_shared_triangles(place: Ids, triangles: Triangles) -> Ids:
    """Return the triangles (k, 3) with a vertex at a shared position.

    Corners are given as position indices.
    """
    is_shared = (np.bincount(place) > 1)[place]
    corners = place[triangles[is_shared[triangles].any(axis=1)]]
    return np.asarray(corners[~has_repeated_vertex(corners)])


def _list_edges(corners: Ids) -> Ids:
    """Return the edges (3 k, 2) of triangles, smaller index first."""
    return np.sort(corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)


def _sort_corners(corners: Ids) -> Ids:
    """Return triangles (k, 3) with sorted vertices."""
    return np.sort(corners, axis=1)


def _count_rows(rows: Ids) -> tuple[Ids, NDArray[np.int64]]:
    """Count distinct rows, in lexicographic order."""
    found, count = np.unique(rows, axis=0, return_counts=True)
    return found, count


def _look_up_counts(rows: Ids, count: NDArray[np.int64], wanted: Ids) -> NDArray[np.int64]:
    """Look up the counts of the `wanted` rows; 0 if missing."""
    both, number = np.unique(np.concatenate([rows, wanted]), axis=0, return_inverse=True)
    times = np.zeros(len(both), np.int64)
    times[number.reshape(-1)[: len(rows)]] = count
    return np.asarray(times[number.reshape(-1)[len(rows) :]])
