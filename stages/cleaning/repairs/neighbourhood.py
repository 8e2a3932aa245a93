"""Submesh around defects, with local indices.

Repair costs thereby scale with the number of defects.

It contains all defects and some rings of triangles around them. Vertices on its boundary have triangles
outside. Operations that need those triangles wait for the next, larger neighbourhood.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.cleaning.repairs.edited import GONE, Edited
from scanloom.stages.cleaning.repairs.ragged import spread
from scanloom.stages.surface.edges import Edges, Ids, edges_of
from scanloom.stages.surface.mesh import Vertices
from scanloom.stages.surface.topology import repeats_vertex


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """Submesh around defects.

    Attributes
    ----------
    rows : (k,) indices of the triangles in the mesh, ascending.
    vertices : (j,) indices of the vertices in the mesh, first vertex at each position, ascending.
    corner : (k, 3) input corner of each corner.
    triangles : (k, 3) local vertex indices.
    places : (j, 3) positions in metres.
    is_inner : (j,) True if all triangles of a vertex are in the submesh.
    """

    rows: Ids
    vertices: Ids
    corner: Ids
    triangles: Ids
    places: Vertices
    is_inner: NDArray[np.bool_]

    @cached_property
    def edges(self) -> Edges:
        """Edges of the submesh, in which no triangle uses a vertex twice."""
        return edges_of(self.triangles.astype(np.int32), len(self.vertices))

    @cached_property
    def _corners_by_vertex(self) -> tuple[Ids, Ids, Ids]:
        flat = self.triangles.reshape(-1)
        count = np.bincount(flat, minlength=len(self.vertices))
        return np.argsort(flat, kind="stable"), np.cumsum(count) - count, count

    def corners_at(self, vertices: Ids) -> tuple[Ids, Ids]:
        """Find the corners at the given vertices.

        Returns
        -------
        owner : position of the corner's vertex in `vertices`.
        corner : local corner index, equal to the index of the halfedge that starts there.
        """
        order, start, count = self._corners_by_vertex
        owner, where = spread(start[vertices], count[vertices])
        return owner, order[where]

    def vertices_where(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return a mask (j,) of the ends of the selected edges."""
        found = np.zeros(len(self.vertices), bool)
        found[self.edges.ends[chosen]] = True
        return found


def grown(triangles: Ids, vertex_count: int, rows: Ids, rings: int) -> Ids:
    """Grow a set of triangles by rings of adjacent triangles.

    Adjacent triangles share a vertex. The result is ascending.
    """
    chosen = np.zeros(len(triangles), bool)
    chosen[rows] = True
    for _ in range(rings):
        # GONE (−1) addresses the extra last element.
        near = np.zeros(vertex_count + 1, bool)
        near[triangles[chosen]] = True
        near[GONE] = False
        chosen = np.asarray(near[triangles].any(axis=1))
    return np.flatnonzero(chosen)


def neighbourhood(edited: Edited, rows: Ids, is_inner: NDArray[np.bool_]) -> Neighbourhood:
    """Extract triangles of the edited mesh, without deleted and collapsed ones.

    Parameters
    ----------
    edited : mesh under repair.
    rows : triangles to extract.
    is_inner : (n,) True if all triangles of a vertex are in `rows`.
    """
    rows = rows[edited.is_there(rows)]
    triangles = edited.triangles[rows]
    proper = ~repeats_vertex(triangles)
    rows, triangles = rows[proper], triangles[proper]
    vertices, index = np.unique(triangles, return_inverse=True)
    return Neighbourhood(
        rows=rows,
        vertices=vertices,
        corner=edited.corner[rows],
        triangles=index.reshape(-1, 3),
        places=edited.places[vertices],
        is_inner=is_inner[vertices],
    )


def inner(triangles: Ids, vertex_count: int, rows: Ids) -> NDArray[np.bool_]:
    """Return a mask (n,) of vertices with all triangles in `rows`."""
    outside = np.ones(len(triangles), bool)
    outside[rows] = False
    found = np.ones(vertex_count + 1, bool)
    found[triangles[outside]] = False
    return found[:-1]
