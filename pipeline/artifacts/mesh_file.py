"""Mesh of a stage as a PLY file.

A mesh above the in-memory limit has a chunk table in a second file.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from scanloom.pipeline.stage import Artifact
from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.surface.chunked_mesh import ChunkedMesh, wrap_large_mesh
from scanloom.stages.surface.chunked_ply import MAX_IN_MEMORY_TRIANGLES, ChunkedPly, make_table_path
from scanloom.stages.surface.codes import FUSE_TOO_LARGE
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.mesh import Mesh


@dataclass(frozen=True)
class MeshFile(Artifact):
    """Mesh in a PLY file.

    Attributes
    ----------
    FILE : file name.
    """

    FILE: ClassVar[str]

    @property
    def path(self) -> Path:
        """Return the path of the file."""
        return self.folder / self.FILE

    @property
    def is_large(self) -> bool:
        """True if the mesh exceeds the in-memory limit and must be processed in chunks."""
        return make_table_path(self.path).exists()

    @property
    def triangle_count(self) -> int:
        """Return the number of triangles of a large mesh."""
        return ChunkedPly(self.path).triangle_count

    def load(self) -> Mesh:
        """Load a mesh that fits in memory."""
        return read_ply(self.path)

    def load_in_memory(self, stage: str) -> Mesh:
        """Load the mesh for a stage that cannot process chunks.

        Raises
        ------
        StageError
            If the mesh exceeds the in-memory limit.
        """
        if self.is_large:
            raise StageError(
                FUSE_TOO_LARGE,
                (
                    "{stage} cannot process chunks, and {file} has {triangle_count:,} triangles, more than "
                    "the in-memory limit of {most_at_once:,}."
                ),
                remedy="Increase fuse.voxel_size, or fuse a part of the scan (fuse.box).",
                stage=stage,
                file=self.FILE,
                triangle_count=self.triangle_count,
                most_at_once=MAX_IN_MEMORY_TRIANGLES,
            )
        return self.load()

    def load_surface(self) -> Mesh | ChunkedMesh:
        """Load the mesh, as chunks if it exceeds the in-memory limit."""
        return ChunkedMesh(ChunkedPly(self.path)) if self.is_large else self.load()

    def load_in_chunks(self) -> Mesh | ChunkedMesh:
        """Load the mesh, as chunks if that saves memory."""
        return ChunkedMesh(ChunkedPly(self.path)) if self.is_large else wrap_large_mesh(self.load())

    def load_subsampled(self) -> Mesh:
        """Load the mesh, evenly subsampling its triangles if it exceeds the in-memory limit."""
        if not self.is_large:
            return self.load()
        pieces = ChunkedPly(self.path)
        step = -(-pieces.triangle_count // MAX_IN_MEMORY_TRIANGLES)
        vertices, triangles, count = [], [], 0
        for number in range(len(pieces)):
            mesh = pieces.read_chunk(number).mesh
            used, local = np.unique(mesh.triangles[::step], return_inverse=True)
            vertices.append(mesh.vertices[used])
            triangles.append((local.reshape(-1, 3) + count).astype(np.int32))
            count += len(used)
        return Mesh(np.concatenate(vertices), np.concatenate(triangles))
