"""What happened to the wedges while vertices collapsed.

A wedge is what the corners on one side of a seam have in common at a vertex: their texture coordinates,
colour and normal (Hoppe, "New quadric metric for simplifying meshes with appearance attributes", 1999).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.simplification.corner_attributes import CornerAttributes, Ids
from scanloom.stages.simplification.records.steps import roots


@dataclass(frozen=True, eq=False)
class Wedges:
    """Wedges, and the vertices that they are around.

    Both have numbers of their own: copies of a vertex count as one, and sheets that only touch as several.

    Attributes
    ----------
    attributes : what the corners carry, and where their vertices are.
    corner_vertex, corner_wedge : (3 t,) int32, of each corner of the mesh; −1 in triangles without area,
        which were left out.
    removed, survivor, when : (w,) int32, wedges that became part of others, and in which collapse.
    changed, changed_to, changed_source, changed_when : (c, …), wedges that took other attributes, which, the
        corner of the mesh that has the same (−1 for none), and in which collapse.
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
    def kept(self) -> NDArray[np.int64]:
        """Triangles of the mesh that were not left out."""
        return np.flatnonzero(self.corner_vertex[::3] >= 0)

    @cached_property
    def triangles(self) -> Ids:
        """(len(kept), 3) int32, the vertices of the triangles that were not left out."""
        return self.corner_vertex.reshape(-1, 3)[self.kept]

    @property
    def vertices(self) -> int:
        """How many vertices there are."""
        return int(self.corner_vertex.max(initial=-1)) + 1

    def first_corners(self) -> NDArray[np.int64]:
        """Return for each vertex the first corner of the mesh that it has."""
        return self._first(self.corner_vertex)

    def corners_after(
        self, collapses: int, triangles: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return what the corners of some triangles carry after so many collapses, and where that is from.

        Parameters
        ----------
        triangles : (q,) rows of the mesh's.

        Returns
        -------
        corners : (3 q, k) float64, as the columns of the attributes.
        source : (3 q,) int64, the corner of the mesh with the same attributes; −1 for none.
        """
        source = self._first(self.corner_wedge)
        values = self.attributes.columns[source]
        until = np.searchsorted(self.changed_when, collapses)
        # Of several changes of one wedge, the last one stays.
        values[self.changed[:until]] = self.changed_to[:until]
        source[self.changed[:until]] = self.changed_source[:until]
        until = np.searchsorted(self.when, collapses)
        root = roots(len(source), self.removed[:until], self.survivor[:until])
        corners = (3 * triangles[:, None] + np.arange(3)).reshape(-1)
        wedge = root[self.corner_wedge[corners]]
        return values[wedge], source[wedge]

    def _first(self, of_corner: Ids) -> NDArray[np.int64]:
        corners = np.flatnonzero(self.corner_vertex >= 0)
        first = np.zeros(int(of_corner.max(initial=-1)) + 1, np.int64)
        # Backwards, so that of all corners of a vertex or wedge the first one counts.
        first[of_corner[corners][::-1]] = corners[::-1]
        return first
