"""Mesh split into chunks, as if it were large."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scanloom.stages.surface import chunked_ply
from scanloom.stages.surface.chunked_mesh import ChunkedMesh
from scanloom.stages.surface.chunked_ply import ChunkedPly, ChunkExtent, WrittenChunk, write_chunked_ply
from scanloom.stages.surface.mesh import Mesh


def split_into_chunks(path: Path, mesh: Mesh, chunk_ids: np.ndarray) -> ChunkedMesh:
    """Write a mesh as a chunked PLY file and open it.

    Parameters
    ----------
    chunk_ids : (m,) chunk of each triangle.
    """
    order = np.argsort(chunk_ids, kind="stable")
    triangles, chunk_ids = mesh.triangles[order], chunk_ids[order]
    # A vertex belongs to the first chunk that uses it.
    used, first, place = np.unique(triangles, return_index=True, return_inverse=True)
    rank = np.empty(len(used), np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(len(used))
    vertices = mesh.vertices[used[np.argsort(rank)]]
    numbers = rank[place.reshape(-1, 3)]
    sizes, written, at = [], [], (0, 0)
    for number in np.unique(chunk_ids):
        own = numbers[chunk_ids == number]
        end = max(at[0], int(own.max()) + 1), at[1] + len(own)
        points = vertices[own]
        low, high = points.min(axis=(0, 1)).tolist(), points.max(axis=(0, 1)).tolist()
        sizes.append(ChunkExtent((at[0], end[0]), (at[1], end[1]), tuple(low), tuple(high)))
        written.append(WrittenChunk(vertices[at[0] : end[0]], None, own))
        at = end
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(chunked_ply, "MAX_IN_MEMORY_TRIANGLES", 1)
        write_chunked_ply(path, sizes, written, has_colors=False, spacing=1.0)
    return ChunkedMesh(ChunkedPly(path))
