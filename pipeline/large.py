"""Meshes too large to be read at once: what of them other stages get to see."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stages.errors import StageError
from stages.surface.formats.ply import read_ply
from stages.surface.mesh import Mesh
from stages.surface.pieces import MOST_AT_ONCE, Pieces, table_of
from stages.surface.piecewise import Piecewise


def is_large(path: Path) -> bool:
    """Whether a mesh that a stage left in pieces has to be worked on piece by piece."""
    return table_of(path).exists()


def whole(path: Path, stage: str) -> Mesh:
    """Return a mesh for a stage that needs all of it.

    Raises
    ------
    StageError
        If it is too large for that.
    """
    if is_large(path):
        raise StageError(
            f"{stage} reads all of {path.name} at once, which has {Pieces(path).triangle_count:,} triangles; "
            f"it takes up to {MOST_AT_ONCE:,}. Give a larger fuse.voxel_size, or fuse a part (fuse.box)."
        )
    return read_ply(path)


def surface_of(path: Path) -> Mesh | Piecewise:
    """Return a mesh for a stage that takes it in pieces, too."""
    return Piecewise(path) if is_large(path) else read_ply(path)


def some_of(path: Path) -> Mesh:
    """Return a mesh, or of one that is too large as many of its triangles, evenly, as are not."""
    if not is_large(path):
        return read_ply(path)
    pieces = Pieces(path)
    step = -(-pieces.triangle_count // MOST_AT_ONCE)
    vertices, triangles, count = [], [], 0
    for number in range(len(pieces)):
        mesh = pieces.part(number).mesh
        used, place = np.unique(mesh.triangles[::step], return_inverse=True)
        vertices.append(mesh.vertices[used])
        triangles.append((place.reshape(-1, 3) + count).astype(np.int32))
        count += len(used)
    return Mesh(np.concatenate(vertices), np.concatenate(triangles))
