"""Changes of wedges during the collapses of vertices.

A wedge is the set of corners around a vertex that share texture coordinates, colour and normal. The term is
from Hoppe, "New quadric metric for simplifying meshes with appearance attributes", 1999.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.simplification.corner_attributes import CornerAttributes, Ids
from scanloom.stages.simplification.records.collapse_steps import find_roots


@dataclass(frozen=True, eq=False)
class Wedges:
    """Wedges of a mesh, and their changes during the collapses.

    Vertices and wedges have separate indices: duplicate vertices count as one, and vertices of touching
    sheets are distinct.

    Attributes
    ----------
    attributes : corner attributes and vertex positions of the mesh.
    corner_vertex, corner_wedge : (3 t,) int32, vertex and wedge of each corner; −1 in degenerate triangles,
        which were removed.
    removed, survivor, when : (w,) int32, wedges merged into others, and the collapse that merged them.
    changed, changed_to, changed_source, changed_when : (c, …), wedges with new attributes, the attributes,
        the corner of the mesh with equal attributes (−1 for none), and the collapse that changed them.
    """

    attributes: CornerAttributes
    corner_vertex: Ids
    corner_wedge: Ids
    removed: Ids
    survivor: Ids
    when: Ids
    changed: Ids
    changed_to: NDArray[np.float64]
    changed_source: Ids
    changed_when: Ids

    @cached_property
    def kept_triangles(self) -> NDArray[np.int64]:
        """Triangles of the mesh that were not removed as degenerate."""
        return np.flatnonzero(self.corner_vertex[::3] >= 0)

    @cached_property
    def triangles(self) -> Ids:
        """Vertices (len(kept), 3) of the triangles in `kept_triangles`, int32."""
        return self.corner_vertex.reshape(-1, 3)[self.kept_triangles]

    @property
    def vertex_count(self) -> int:
        """Number of vertices."""
        return int(self.corner_vertex.max(initial=-1)) + 1

    def find_first_corners(self) -> NDArray[np.int64]:
        """Return the first corner of the mesh at each vertex."""
        return self._find_first(self.corner_vertex)

    def compute_corners_after(
        self, collapses: int, triangles: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return the corner attributes of some triangles after a number of collapses.

        Parameters
        ----------
        collapses : number of collapses.
        triangles : (q,) triangles of the mesh.

        Returns
        -------
        corners : (3 q, k) float64, in the columns of `CornerAttributes.columns`.
        source : (3 q,) int64, corner of the mesh with equal attributes; −1 for none.
        """
        source = self._find_first(self.corner_wedge)
        values = self.attributes.columns[source]
        until = np.searchsorted(self.changed_when, collapses)
        # NumPy keeps the last of several values assigned to one wedge.
        values[self.changed[:until]] = self.changed_to[:until]
        source[self.changed[:until]] = self.changed_source[:until]
        until = np.searchsorted(self.when, collapses)
        root = find_roots(len(source), self.removed[:until], self.survivor[:until])
        corners = (3 * triangles[:, None] + np.arange(3)).reshape(-1)
        wedge = root[self.corner_wedge[corners]]
        return values[wedge], source[wedge]

    def _find_first(self, of_corner: Ids) -> NDArray[np.int64]:
        corners = np.flatnonzero(self.corner_vertex >= 0)
        first = np.zeros(int(of_corner.max(initial=-1)) + 1, np.int64)
        # In reverse order, because NumPy keeps the last of several values assigned to one index.
        first[of_corner[corners][::-1]] = corners[::-1]
        return first
