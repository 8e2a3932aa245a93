"""Partition of a mesh into chunks: cubes of space, aligned to the origin."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.chunked_ply import (
    ChunkExtent,
    PointTuple,
    WrittenChunk,
    exceeds_chunk_limit,
    write_chunked_ply,
)
from scanloom.stages.surface.mesh import Mesh

# Side of a chunk, metres, as fusion writes them.
CHUNK_SIZE_M = 4.0
# Triangles whose edges are measured at a time.
_BATCH_TRIANGLES = 1_000_000


def write_in_chunks(path: Path, mesh: Mesh, values: Mapping[str, NDArray[np.float32]]) -> None:
    """Write a mesh as PLY, ordered by chunks, with a chunk table if it is large.

    The PLY file does not depend on the in-memory limit. A vertex belongs to the cube that contains it, and a
    triangle to the first cube of its corners. Within a chunk, the order of the mesh is kept.

    Parameters
    ----------
    path : output file.
    mesh : mesh in metres; texture, normals and parts are not written.
    values : additional vertex properties by name, (n,) each; `read_ply` ignores them.

    Raises
    ------
    MeshError
        If coordinates are not finite.
    StageError
        If a file cannot be written.
    """
    if not len(mesh.vertices):
        write_chunked_ply(path, [], [], has_colors=mesh.colors is not None, spacing=0.0, values=tuple(values))
        return
    cubes = np.floor(mesh.vertices / CHUNK_SIZE_M)
    first_cube = cubes.min(axis=0)
    cubes -= first_cube
    shape = tuple(int(last) + 1 for last in cubes.max(axis=0))
    vertex_cubes = np.ravel_multi_index(tuple(cubes.T.astype(np.int64)), shape)
    del cubes
    triangle_cubes = vertex_cubes[mesh.triangles].min(axis=1)
    vertex_order, triangle_order = (np.argsort(of, kind="stable") for of in (vertex_cubes, triangle_cubes))
    rank = np.empty(len(vertex_order), np.int32)
    rank[vertex_order] = np.arange(len(vertex_order), dtype=np.int32)
    # The cube of a triangle has at least one vertex.
    used, vertex_ends = _find_ends(vertex_cubes[vertex_order])
    triangle_ends = np.searchsorted(triangle_cubes[triangle_order], used, "right")

    def to_point(cube: NDArray[Any]) -> PointTuple:
        x, y, z = ((cube + first_cube) * CHUNK_SIZE_M).tolist()
        return x, y, z

    extents = [
        ChunkExtent(vertices, triangles, to_point(cube), to_point(cube + 1))
        for vertices, triangles, cube in zip(
            _iterate_ranges(vertex_ends),
            _iterate_ranges(triangle_ends),
            np.stack(np.unravel_index(used, shape), axis=1),
            strict=True,
        )
    ]

    def iterate_chunks() -> Iterator[WrittenChunk]:
        for extent in extents:
            own = vertex_order[slice(*extent.vertices)]
            yield WrittenChunk(
                mesh.vertices[own],
                None if mesh.colors is None else mesh.colors[own],
                rank[mesh.triangles[triangle_order[slice(*extent.triangles)]]],
                np.stack([column[own] for column in values.values()], axis=1) if values else None,
            )

    is_large = exceeds_chunk_limit(len(mesh.triangles))
    write_chunked_ply(
        path,
        extents,
        iterate_chunks(),
        has_colors=mesh.colors is not None,
        spacing=_measure_longest_edge(mesh) / 2 if is_large else 0.0,
        values=tuple(values),
    )


def _find_ends(ordered: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the distinct values of a sorted array, and the index after the last one of each."""
    is_last = np.append(ordered[1:] != ordered[:-1], True)
    (last,) = np.nonzero(is_last)
    return ordered[last], last + 1


def _iterate_ranges(ends: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    first = 0
    for end in ends.tolist():
        yield first, end
        first = end


def _measure_longest_edge(mesh: Mesh) -> float:
    """Return the length of the longest edge, metres."""
    longest = 0.0
    for first in range(0, len(mesh.triangles), _BATCH_TRIANGLES):
        corners = mesh.vertices[mesh.triangles[first : first + _BATCH_TRIANGLES]]
        edges = corners - np.roll(corners, -1, axis=1)
        longest = max(longest, float((edges**2).sum(axis=2).max(initial=0.0)))
    return float(np.sqrt(longest))
