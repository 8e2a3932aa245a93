"""Triangles with the triangle of the given mesh on which each of them lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.mesh import Mesh, Triangles, Vertices
from scanloom.stages.surface.welding import find_first_equal_rows


@dataclass(frozen=True, eq=False)
class Shell:
    """Triangles whose origin is known.

    Attributes
    ----------
    vertices : (n, 3) metres.
    triangles : (m, 3) int32, counter-clockwise seen from outside.
    source : (m,) triangle of the given mesh on which each triangle lies; -1 for added surface.
    """

    vertices: Vertices
    triangles: Triangles
    source: Ids

    @property
    def mesh(self) -> Mesh:
        """The surface without the sources."""
        return Mesh(self.vertices, self.triangles)

    def select(self, chosen: NDArray[np.bool_]) -> Shell:
        """Return the chosen triangles, a mask (m,), and their vertices."""
        used, index = np.unique(self.triangles[chosen], return_inverse=True)
        return Shell(self.vertices[used], index.reshape(-1, 3).astype(np.int32), self.source[chosen])

    def weld(self) -> Shell:
        """Merge vertices at equal positions, and drop unused vertices."""
        first = find_first_equal_rows(list(self.vertices.T))
        used, index = np.unique(first[self.triangles], return_inverse=True)
        return Shell(self.vertices[used], index.reshape(-1, 3).astype(np.int32), self.source)


def join_shells(*shells: Shell) -> Shell:
    """Concatenate shells without joining their vertices."""
    starts = np.cumsum([0, *(len(shell.vertices) for shell in shells)])
    triangles = [shell.triangles + start for shell, start in zip(shells, starts, strict=False)]
    return Shell(
        np.concatenate([shell.vertices for shell in shells]),
        np.concatenate(triangles).astype(np.int32),
        np.concatenate([shell.source for shell in shells]),
    )


def compute_volumes(vertices: Vertices, triangles: Triangles | Ids) -> NDArray[np.float64]:
    """Compute the signed volume (m,) between each triangle and the origin, in m³."""
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    return np.asarray(np.einsum("ij,ij->i", a, np.cross(b, c)) / 6)
