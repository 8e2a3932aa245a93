"""Writing of fused meshes to PLY files, large ones in chunks.

The chunks depend only on the mesh, and not on whether it was fused in memory or in bricks.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.fusion.brick_stitching import StitchedMesh
from scanloom.stages.fusion.bricks import BlockCube, compute_level, encode_z_order
from scanloom.stages.fusion.fusion_plan import FusionPlan
from scanloom.stages.fusion.fusion_statistics import MeshStatistics
from scanloom.stages.fusion.scene_extent import to_point
from scanloom.stages.fusion.tsdf_volume import BLOCK_SIDE, BlockKeys
from scanloom.stages.surface.chunked_ply import (
    ChunkExtent,
    WrittenChunk,
    exceeds_chunk_limit,
    write_chunked_ply,
)
from scanloom.stages.surface.codes import FUSE_TOO_LARGE
from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.surface.mesh import Mesh

# Approximate side of a chunk, metres; the upper limit of the brick size.
CHUNK_SIZE_M = 4.0
# Tolerance in voxels: above the rounding error, and below the minimum distance of a vertex to the next voxel
# (kernels/src/fusion/surface_extraction.rs).
_VOXEL_TOLERANCE = 1e-4


def compute_chunk_level(voxel_size: float) -> int:
    """Return the cube level of chunks."""
    return compute_level(CHUNK_SIZE_M, voxel_size)


def write_fused_mesh(path: Path, mesh: Mesh, plan: FusionPlan) -> None:
    """Write a mesh whose blocks are in Z-order.

    Large meshes are written in chunks. A mesh may be cropped, which preserves the order.

    Raises
    ------
    StageError
        If the blocks are not in Z-order.
    """
    if not exceeds_chunk_limit(len(mesh.triangles)):
        write_ply(path, mesh)
        return
    level = compute_chunk_level(plan.voxel_size)
    voxels = np.floor((mesh.vertices - plan.origin) / plan.voxel_size + _VOXEL_TOLERANCE).astype(np.int64)
    # A vertex belongs to the voxel below it, a triangle to the lowest corner of its cube. No triangle is
    # within a face of the cube, so the assignment is unique.
    of_vertex = _find_chunk_indices(voxels, level)
    of_triangle = _find_chunk_indices(voxels[mesh.triangles].min(axis=1), level)
    if (np.diff(of_vertex) < 0).any() or (np.diff(of_triangle) < 0).any():
        raise StageError(
            FUSE_TOO_LARGE,
            "internal error: the blocks of the fused mesh are out of order.",
        )
    numbers = np.unique(np.concatenate([of_vertex, of_triangle]))
    vertices, triangles = (
        np.stack([np.searchsorted(of, numbers, side) for side in ("left", "right")], axis=1)
        for of in (of_vertex, of_triangle)
    )
    sizes = [
        _make_extent(BlockCube(level, int(number)), v, t, plan)
        for number, v, t in zip(numbers, vertices, triangles, strict=True)
    ]
    pieces = (
        WrittenChunk(
            mesh.vertices[slice(*size.vertices)],
            None if mesh.colors is None else mesh.colors[slice(*size.vertices)],
            mesh.triangles[slice(*size.triangles)],
        )
        for size in sizes
    )
    write_chunked_ply(path, sizes, pieces, has_colors=mesh.colors is not None, spacing=plan.voxel_size)


def write_stitched_mesh(
    path: Path, joined: StitchedMesh, plan: FusionPlan, *, has_colors: bool
) -> MeshStatistics:
    """Write a stitched mesh, with one brick in memory at a time.

    Returns
    -------
    The bounding box and the element counts of the mesh.
    """
    lowest, highest = np.full(3, np.inf), np.full(3, -np.inf)

    def iterate_chunks() -> Iterator[WrittenChunk]:
        for piece, triangles in joined:
            places = piece.vertices + plan.origin
            if len(places):
                np.minimum(lowest, places.min(axis=0), out=lowest)
                np.maximum(highest, places.max(axis=0), out=highest)
            yield WrittenChunk(places, piece.colors, triangles)

    sizes = list(_iterate_chunk_extents(joined, plan))
    write_chunked_ply(path, sizes, iterate_chunks(), has_colors=has_colors, spacing=plan.voxel_size)
    return MeshStatistics(lowest, highest, joined.vertex_count, joined.triangle_count)


def _iterate_chunk_extents(joined: StitchedMesh, plan: FusionPlan) -> Iterator[ChunkExtent]:
    """Yield the non-empty chunks, each combined from whole bricks."""
    level = compute_chunk_level(plan.voxel_size)
    numbers = np.array([brick.index >> 3 * (level - brick.level) for brick in joined.cubes])
    for number in np.unique(numbers):
        first, end = np.searchsorted(numbers, [number, number + 1])
        vertices, triangles = joined.vertex_offsets[[first, end]], joined.triangle_offsets[[first, end]]
        if vertices[1] > vertices[0] or triangles[1] > triangles[0]:
            yield _make_extent(BlockCube(level, int(number)), vertices, triangles, plan)


def _make_extent(
    cube: BlockCube, vertices: NDArray[np.int64], triangles: NDArray[np.int64], plan: FusionPlan
) -> ChunkExtent:
    block = BLOCK_SIDE * plan.voxel_size
    low, high = (to_point(np.array(corner) * block + plan.origin) for corner in (cube.low, cube.high))
    return ChunkExtent(
        (int(vertices[0]), int(vertices[1])), (int(triangles[0]), int(triangles[1])), low, high
    )


def _find_chunk_indices(voxels: NDArray[np.int64], level: int) -> BlockKeys:
    """Return the Z-order indices (n,) of the chunks that contain voxels (n, 3).

    A chunk is a cube of 2^level blocks per side.
    """
    return encode_z_order(voxels // BLOCK_SIDE >> level, level)
