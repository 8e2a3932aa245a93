"""Writing of fused meshes to PLY files, large ones in chunks.

The chunks depend only on the mesh, and not on whether it was fused in memory or in bricks.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.fusion.bricks import Cube, level_of, numbers_of
from scanloom.stages.fusion.facts import MeshFigures
from scanloom.stages.fusion.joining import Joined
from scanloom.stages.fusion.plan import Plan
from scanloom.stages.fusion.scene import point_of
from scanloom.stages.fusion.voxels import BLOCK, Keys
from scanloom.stages.surface.codes import FUSE_TOO_LARGE
from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.pieces import Extent, Written, is_many, write_pieces

# Approximate side of a chunk, metres; the upper limit of the brick size.
PIECE_SIZE = 4.0
# Tolerance in voxels: above the rounding error, and below the minimum distance of a vertex to the next voxel
# (kernels/src/fusion/surface.rs).
_NEAR = 1e-4


def piece_level(voxel_size: float) -> int:
    """Return the cube level of chunks."""
    return level_of(PIECE_SIZE, voxel_size)


def write_fused(path: Path, mesh: Mesh, plan: Plan) -> None:
    """Write a mesh whose blocks are in Z-order.

    Large meshes are written in chunks. A mesh may be cropped, which preserves the order.

    Raises
    ------
    StageError
        If the blocks are not in Z-order.
    """
    if not is_many(len(mesh.triangles)):
        write_ply(path, mesh)
        return
    level = piece_level(plan.voxel_size)
    voxels = np.floor((mesh.vertices - plan.origin) / plan.voxel_size + _NEAR).astype(np.int64)
    # A vertex belongs to the voxel below it, a triangle to the lowest corner of its cube. No triangle is
    # within a face of the cube, so the assignment is unique.
    of_vertex = _pieces_of(voxels, level)
    of_triangle = _pieces_of(voxels[mesh.triangles].min(axis=1), level)
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
        _extent(Cube(level, int(number)), v, t, plan)
        for number, v, t in zip(numbers, vertices, triangles, strict=True)
    ]
    pieces = (
        Written(
            mesh.vertices[slice(*size.vertices)],
            None if mesh.colors is None else mesh.colors[slice(*size.vertices)],
            mesh.triangles[slice(*size.triangles)],
        )
        for size in sizes
    )
    write_pieces(path, sizes, pieces, has_colors=mesh.colors is not None, spacing=plan.voxel_size)


def write_joined(path: Path, joined: Joined, plan: Plan, *, has_colors: bool) -> MeshFigures:
    """Write a stitched mesh, with one brick in memory at a time.

    Returns
    -------
    The bounding box and the element counts of the mesh.
    """
    lowest, highest = np.full(3, np.inf), np.full(3, -np.inf)

    def pieces() -> Iterator[Written]:
        for piece, triangles in joined:
            places = piece.vertices + plan.origin
            if len(places):
                np.minimum(lowest, places.min(axis=0), out=lowest)
                np.maximum(highest, places.max(axis=0), out=highest)
            yield Written(places, piece.colors, triangles)

    sizes = list(_sizes(joined, plan))
    write_pieces(path, sizes, pieces(), has_colors=has_colors, spacing=plan.voxel_size)
    return MeshFigures(lowest, highest, joined.vertex_count, joined.triangle_count)


def _sizes(joined: Joined, plan: Plan) -> Iterator[Extent]:
    """Yield the non-empty chunks, each combined from whole bricks."""
    level = piece_level(plan.voxel_size)
    numbers = np.array([brick.number >> 3 * (level - brick.level) for brick in joined.cubes])
    for number in np.unique(numbers):
        first, end = np.searchsorted(numbers, [number, number + 1])
        vertices, triangles = joined.vertex_ends[[first, end]], joined.triangle_ends[[first, end]]
        if vertices[1] > vertices[0] or triangles[1] > triangles[0]:
            yield _extent(Cube(level, int(number)), vertices, triangles, plan)


def _extent(cube: Cube, vertices: NDArray[np.int64], triangles: NDArray[np.int64], plan: Plan) -> Extent:
    block = BLOCK * plan.voxel_size
    low, high = (point_of(np.array(corner) * block + plan.origin) for corner in (cube.low, cube.high))
    return Extent((int(vertices[0]), int(vertices[1])), (int(triangles[0]), int(triangles[1])), low, high)


def _pieces_of(voxels: NDArray[np.int64], level: int) -> Keys:
    """Return the Z-order indices (n,) of the cubes containing voxels (n, 3)."""
    return numbers_of(voxels // BLOCK >> level, level)
