"""The part of a mesh that repairs look at, with numbers of its own, so that work grows with the defects.

All that is irregular lies in it with some rings of triangles around. Vertices at its rim have triangles
outside: what would need these waits for the next neighbourhood.
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
    """Triangles around a few places.

    Attributes
    ----------
    rows : (k,) numbers of the triangles in the mesh, ascending.
    vertices : (j,) numbers of the vertices in the mesh, the first in each place, ascending.
    corner : (k, 3) the given corner each corner is.
    triangles : (k, 3) by the vertices' numbers here.
    places : (j, 3) m.
    is_inner : (j,) whether all triangles of a vertex are here.
    """

    rows: Ids
    vertices: Ids
    corner: Ids
    triangles: Ids
    places: Vertices
    is_inner: NDArray[np.bool_]

    @cached_property
    def edges(self) -> Edges:
        """Edges; no triangle here repeats a vertex."""
        return edges_of(self.triangles.astype(np.int32), len(self.vertices))

    @cached_property
    def _corners_by_vertex(self) -> tuple[Ids, Ids, Ids]:
        flat = self.triangles.reshape(-1)
        count = np.bincount(flat, minlength=len(self.vertices))
        return np.argsort(flat, kind="stable"), np.cumsum(count) - count, count

    def corners_at(self, vertices: Ids) -> tuple[Ids, Ids]:
        """Return the corners (numbers as of halfedges) at each vertex, and which of the vertices it is at."""
        order, start, count = self._corners_by_vertex
        owner, where = spread(start[vertices], count[vertices])
        return owner, order[where]

    def vertices_where(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return (j,) which vertices are ends of the chosen edges."""
        found = np.zeros(len(self.vertices), bool)
        found[self.edges.ends[chosen]] = True
        return found


def grown(triangles: Ids, vertex_count: int, rows: Ids, rings: int) -> Ids:
    """Return triangles and, so many rings around, those that share a vertex with them; ascending."""
    chosen = np.zeros(len(triangles), bool)
    chosen[rows] = True
    for _ in range(rings):
        # GONE, which is −1, has the last place.
        near = np.zeros(vertex_count + 1, bool)
        near[triangles[chosen]] = True
        near[GONE] = False
        chosen = np.asarray(near[triangles].any(axis=1))
    return np.flatnonzero(chosen)


def neighbourhood(edited: Edited, rows: Ids, is_inner: NDArray[np.bool_]) -> Neighbourhood:
    """Return triangles of a mesh as it is now, without those that are gone or repeat a vertex.

    Parameters
    ----------
    is_inner : (n,) whether all triangles of a vertex are among the rows.
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
    """Return (n,) which vertices have no triangle but these."""
    outside = np.ones(len(triangles), bool)
    outside[rows] = False
    found = np.ones(vertex_count + 1, bool)
    found[triangles[outside]] = False
    return found[:-1]
