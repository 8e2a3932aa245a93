"""The mesh that edits lead to, with all that its vertices, corners and triangles have."""

from __future__ import annotations

import numpy as np

from stages.cleaning.repairs.edited import Edited
from stages.surface.edges import Ids
from stages.surface.mesh import Mesh
from stages.surface.vertex_normals import vertex_normals


def repaired_mesh(edited: Edited) -> tuple[Mesh, Ids, Ids]:
    """Return the mesh without what is gone, and the vertex and the triangle that each of its was."""
    given = edited.mesh
    (rows,) = np.nonzero(edited.is_there(np.arange(len(edited.corner))))
    if not edited.rounds:
        return given, np.arange(len(given.vertices)), rows
    corner = edited.corner[rows]
    uvs = None if given.texture is None else given.texture.uvs.reshape(-1, 2)[corner]
    normals = None if given.corner_normals is None else given.corner_normals.reshape(-1, 3)[corner]
    triangles = given.triangles.reshape(-1)[corner]
    mesh = _moved(edited, given.with_triangles(triangles, rows, uvs=uvs, corner_normals=normals))
    # Vertices that nothing used before stay; a collapse leaves others.
    used, still = np.zeros((2, len(given.vertices)), bool)
    used[given.triangles] = True
    still[triangles] = True
    (kept,) = np.nonzero(still | ~used)
    number = np.cumsum(still | ~used) - 1
    mesh = mesh.with_(
        vertices=mesh.vertices[kept],
        colors=None if mesh.colors is None else mesh.colors[kept],
        normals=None if mesh.normals is None else mesh.normals[kept],
        triangles=number[triangles].astype(np.int32),
    )
    return mesh, kept, rows


def _moved(edited: Edited, mesh: Mesh) -> Mesh:
    """Return the mesh with the vertices where they were moved to, and normals that fit there."""
    (moved,) = np.nonzero(edited.is_moved()[edited.first])
    if len(moved) == 0:
        return mesh
    vertices = mesh.vertices.copy()
    vertices[moved] = edited.places[edited.first[moved]]
    mesh = mesh.with_(vertices=vertices)
    if mesh.normals is None and mesh.corner_normals is None:
        return mesh
    fitting = vertex_normals(mesh)
    if mesh.normals is not None:
        normals = mesh.normals.copy()
        normals[moved] = fitting[moved]
        mesh = mesh.with_(normals=normals)
    if mesh.corner_normals is not None:
        corner_normals = mesh.corner_normals.copy()
        there = np.isin(mesh.triangles, moved)
        corner_normals[there] = fitting[mesh.triangles[there]]
        mesh = mesh.with_(corner_normals=corner_normals)
    return mesh
