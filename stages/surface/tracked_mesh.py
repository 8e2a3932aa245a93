"""A mesh under editing that records the source of its vertices and triangles."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.mesh import Mesh, Triangles


@dataclass(frozen=True, eq=False)
class TrackedMesh:
    """A mesh with the source of each vertex and triangle.

    Every edit returns a new object.

    Attributes
    ----------
    mesh : the edited mesh.
    vertex_source : (n,) original vertex of each vertex.
    triangle_source : (m,) original triangle that each triangle equals or lies on; -1 for new triangles.
    """

    mesh: Mesh
    vertex_source: Ids
    triangle_source: Ids

    @classmethod
    def start(cls, mesh: Mesh) -> TrackedMesh:
        """Start editing a mesh, with identity sources."""
        return cls(mesh, np.arange(len(mesh.vertices)), np.arange(len(mesh.triangles)))

    def keep(self, chosen: NDArray[np.bool_]) -> TrackedMesh:
        """Keep only the chosen triangles, a mask (m,)."""
        if chosen.all():
            return self
        mesh = self.mesh.with_triangles(self.mesh.triangles[chosen], chosen)
        return replace(self, mesh=mesh, triangle_source=self.triangle_source[chosen])

    def replace_triangles(
        self,
        triangles: Triangles,
        origin: Ids,
        uvs: NDArray[np.float64] | None,
        corner_normals: NDArray[np.float64] | None,
    ) -> TrackedMesh:
        """Replace the triangles; triangle i comes from `origin[i]` and keeps its material."""
        mesh = self.mesh.with_triangles(triangles, origin, uvs=uvs, corner_normals=corner_normals)
        return replace(self, mesh=mesh, triangle_source=self.triangle_source[origin])

    def flip(self, chosen: NDArray[np.bool_]) -> TrackedMesh:
        """Reverse the orientation of the chosen triangles, a mask (m,)."""
        order = np.where(chosen[:, None], [0, 2, 1], [0, 1, 2])
        triangles = np.take_along_axis(self.mesh.triangles, order, axis=1)
        mesh = self.mesh
        uvs = None if mesh.texture is None else mesh.texture.uvs
        corner_normals = mesh.corner_normals
        if uvs is not None:
            uvs = np.take_along_axis(uvs, order[..., None], axis=1)
        if corner_normals is not None:
            corner_normals = np.take_along_axis(corner_normals, order[..., None], axis=1)
        return self.replace_triangles(triangles, np.arange(len(triangles)), uvs, corner_normals)

    def merge_vertices(self, representative: Ids) -> TrackedMesh:
        """Replace each vertex by its representative (n,) in all triangles."""
        triangles = representative[self.mesh.triangles].astype(np.int32)
        return replace(self, mesh=self.mesh.with_(triangles=triangles))

    def split_fans(self, fan: Ids) -> TrackedMesh:
        """Duplicate vertices so that each fan of corners has a separate vertex.

        The first fan of a vertex keeps the original one.

        Parameters
        ----------
        fan : (3 m,) fan label of each corner, numbered by first occurrence.
        """
        corners = self.mesh.triangles.reshape(-1)
        vertex_of_fan = np.zeros(fan.max(initial=-1) + 1, np.int64)
        vertex_of_fan[fan] = corners
        first_fan = np.zeros(len(self.mesh.vertices), np.int64)
        first_fan[vertex_of_fan[::-1]] = np.arange(len(vertex_of_fan))[::-1]
        extra = first_fan[vertex_of_fan] != np.arange(len(vertex_of_fan))
        if not extra.any():
            return self
        source = np.concatenate((np.arange(len(self.mesh.vertices)), vertex_of_fan[extra]))
        new_vertex = vertex_of_fan.copy()
        new_vertex[extra] = len(self.mesh.vertices) + np.arange(np.count_nonzero(extra))
        triangles = new_vertex[fan].reshape(-1, 3).astype(np.int32)
        return self._replace_vertices(source, triangles)

    def append_triangles(self, triangles: Triangles) -> TrackedMesh:
        """Append new triangles without source and texture."""
        source = np.concatenate((np.arange(len(self.mesh.triangles)), np.full(len(triangles), -1)))
        mesh = self.mesh.with_triangles(np.concatenate((self.mesh.triangles, triangles)), source)
        new = np.full(len(triangles), -1, np.int64)
        return replace(self, mesh=mesh, triangle_source=np.concatenate((self.triangle_source, new)))

    def drop_unused_vertices(self) -> TrackedMesh:
        """Drop unreferenced vertices."""
        used = np.zeros(len(self.mesh.vertices), bool)
        used[self.mesh.triangles] = True
        if used.all():
            return self
        index = np.cumsum(used) - 1
        return self._replace_vertices(np.flatnonzero(used), index[self.mesh.triangles].astype(np.int32))

    def _replace_vertices(self, source: Ids, triangles: Triangles) -> TrackedMesh:
        mesh = self.mesh
        mesh = mesh.with_(
            vertices=mesh.vertices[source],
            colors=None if mesh.colors is None else mesh.colors[source],
            normals=None if mesh.normals is None else mesh.normals[source],
            triangles=triangles,
        )
        return replace(self, mesh=mesh, vertex_source=self.vertex_source[source])
