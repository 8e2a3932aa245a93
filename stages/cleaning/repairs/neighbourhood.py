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

from scanloom.stages.cleaning.repairs.editable_mesh import GONE, EditableMesh
from scanloom.stages.cleaning.repairs.ragged_array import expand_slices
from scanloom.stages.surface.edges import Edges, Ids, build_edges
from scanloom.stages.surface.mesh import Vertices
from scanloom.stages.surface.topology import has_repeated_vertex


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """Submesh around defects.

    Attributes
    ----------
    triangle_indices : (k,) indices of the triangles in the mesh, ascending.
    vertex_indices : (j,) indices of the vertices in the mesh, first vertex at each position, ascending.
    input_corners : (k, 3) input corner of each corner.
    triangles : (k, 3) local vertex indices.
    positions : (j, 3) positions in metres.
    is_inner : (j,) True if all triangles of a vertex are in the submesh.
    """

    triangle_indices: Ids
    vertex_indices: Ids
    input_corners: Ids
    triangles: Ids
    positions: Vertices
    is_inner: NDArray[np.bool_]

    @cached_property
    def edges(self) -> Edges:
        """Edges of the submesh, in which no triangle uses a vertex twice."""
        return build_edges(self.triangles.astype(np.int32), len(self.vertex_indices))

    @cached_property
    def _corners_by_vertex(self) -> tuple[Ids, Ids, Ids]:
        flat = self.triangles.reshape(-1)
        count = np.bincount(flat, minlength=len(self.vertex_indices))
        return np.argsort(flat, kind="stable"), np.cumsum(count) - count, count

    def find_corners(self, vertices: Ids) -> tuple[Ids, Ids]:
        """Find the corners at the given vertices.

        Returns
        -------
        owner : position of the corner's vertex in `vertex_indices`.
        corner : local corner index, equal to the index of the halfedge that starts there.
        """
        order, start, count = self._corners_by_vertex
        owner, where = expand_slices(start[vertices], count[vertices])
        return owner, order[where]

    def mark_edge_ends(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return a mask (j,) of the ends of the selected edges."""
        found = np.zeros(len(self.vertex_indices), bool)
        found[self.edges.ends[chosen]] = True
        return found


def grow_rings(triangles: Ids, vertex_count: int, rows: Ids, rings: int) -> Ids:
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


def extract_neighbourhood(edited: EditableMesh, rows: Ids, is_inner: NDArray[np.bool_]) -> Neighbourhood:
    """Extract triangles of the edited mesh, without deleted and collapsed ones.

    Parameters
    ----------
    edited : mesh under repair.
    rows : triangles to extract.
    is_inner : (n,) True if all triangles of a vertex are in `triangle_indices`.
    """
    rows = rows[edited.is_present(rows)]
    triangles = edited.triangles[rows]
    proper = ~has_repeated_vertex(triangles)
    rows, triangles = rows[proper], triangles[proper]
    vertices, index = np.unique(triangles, return_inverse=True)
    return Neighbourhood(
        triangle_indices=rows,
        vertex_indices=vertices,
        input_corners=edited.input_corners[rows],
        triangles=index.reshape(-1, 3),
        positions=edited.positions[vertices],
        is_inner=is_inner[vertices],
    )


def find_inner_vertices(triangles: Ids, vertex_count: int, rows: Ids) -> NDArray[np.bool_]:
    """Return a mask (n,) of vertices with all triangles in `triangle_indices`."""
    outside = np.ones(len(triangles), bool)
    outside[rows] = False
    found = np.ones(vertex_count + 1, bool)
    found[triangles[outside]] = False
    return found[:-1]
