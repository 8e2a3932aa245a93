"""Vertices that lie at the same place, made one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.mesh import Mesh


def merge_vertices(mesh: Mesh) -> tuple[Mesh, NDArray[np.int64]]:
    """Make one vertex of those with exactly the same position and colour; vertices keep their order.

    Formats that store a corner's texture coordinate or normal with the vertex, and STL, which stores
    corners alone, tear a surface apart that is one. A merged vertex takes the mean of the normals.

    Returns
    -------
    mesh : with as many triangles, in the same order.
    vertex_source : (n,) the first of the vertices each one was made of.
    """
    count = len(mesh.vertices)
    x, y, z = mesh.vertices.T
    keys = [z, y, x]
    if mesh.colors is not None:
        keys.insert(0, mesh.colors.astype(np.int64) @ (1 << 16, 1 << 8, 1))
    order = np.lexsort(keys)
    starts = np.zeros(count, bool)
    starts[:1] = True
    for key in keys:
        ordered = key[order]
        starts[1:] |= ordered[1:] != ordered[:-1]
    if starts.all():
        return mesh, np.arange(count)
    # The sort is stable, so a group starts with its first vertex.
    first_of_group = order[starts]
    rank = np.empty(len(first_of_group), np.int64)
    rank[np.argsort(first_of_group)] = np.arange(len(rank))
    merged_index = np.empty(count, np.int64)
    merged_index[order] = rank[np.cumsum(starts) - 1]
    source = np.sort(first_of_group)
    normals = mesh.normals
    if normals is not None:
        sums = np.stack([np.bincount(merged_index, normals[:, k], len(source)) for k in range(3)], axis=1)
        length = np.linalg.norm(sums, axis=1, keepdims=True)
        alone = np.bincount(merged_index, minlength=len(source))[:, None] == 1
        normals = np.where(alone | (length == 0), normals[source], sums / np.where(length == 0, 1, length))
    merged = mesh.with_(
        vertices=mesh.vertices[source],
        triangles=merged_index[mesh.triangles].astype(np.int32),
        colors=None if mesh.colors is None else mesh.colors[source],
        normals=normals,
    )
    return merged, source
