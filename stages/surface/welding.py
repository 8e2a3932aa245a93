"""Welding of vertices at equal positions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh


def weld_vertices(mesh: Mesh, group_ids: NDArray[Any] | None = None) -> Mesh:
    """Weld vertices with exactly equal position and colour; vertices keep their order.

    Some formats duplicate vertices along texture seams and hard edges, and STL stores separate corners;
    welding restores the connectivity. A welded vertex gets the mean of the normals. Vertices that differ in
    `group_ids` (n,) are not welded.
    """
    keys = list(mesh.vertices.T)
    if mesh.colors is not None:
        keys.append(mesh.colors.astype(np.int64) @ (1 << 16, 1 << 8, 1))
    if group_ids is not None:
        keys.append(group_ids)
    index = find_first_equal_rows(keys)
    source = np.unique(index)
    if len(source) == len(index):
        return mesh
    rank = np.cumsum(index == np.arange(len(index))) - 1
    new_index = rank[index]
    normals = mesh.normals
    if normals is not None:
        sums = np.stack([np.bincount(new_index, normals[:, k], len(source)) for k in range(3)], axis=1)
        length = np.linalg.norm(sums, axis=1, keepdims=True)
        alone = np.bincount(new_index, minlength=len(source))[:, None] == 1
        normals = np.where(alone | (length == 0), normals[source], sums / np.where(length == 0, 1, length))
    return mesh.with_(
        vertices=mesh.vertices[source],
        triangles=new_index[mesh.triangles].astype(np.int32),
        colors=None if mesh.colors is None else mesh.colors[source],
        normals=normals,
    )


def find_first_equal_rows(columns: list[NDArray[Any]]) -> NDArray[np.int64]:
    """Return the index of the first row equal in all columns, for each row."""
    count = len(columns[0])
    order = np.lexsort(columns)
    starts = np.zeros(count, bool)
    starts[:1] = True
    for column in columns:
        ordered = column[order]
        starts[1:] |= ordered[1:] != ordered[:-1]
    first = np.empty(count, np.int64)
    # The sort is stable, so a group starts with its first row.
    first[order] = order[starts][np.cumsum(starts) - 1]
    return first
