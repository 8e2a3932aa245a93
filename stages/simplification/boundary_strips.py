"""Strips along chunk faces, stored on disk until all chunks are read.

A floor may lie along chunk faces entirely, so strips can be as large as chunks. Strips are simplified in
cells: cubes of the chunk size, offset by half a chunk, so that cell faces do not coincide with chunk faces.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.simplification.mesh_subsets import MeshSubset, join_subsets, split_by_groups
from scanloom.stages.surface.chunked_ply import ChunkExtent
from scanloom.stages.surface.mesh import Mesh

_NO_CELL = np.iinfo(np.uint16).max


class BoundaryStrips:
    """Strips, grouped by cells.

    Parameters
    ----------
    folder : folder for temporary files; the caller removes it.
    extents : bounding boxes of all chunks.
    vertex_count : total number of vertices; memory usage is three bytes per vertex.
    """

    def __init__(self, folder: Path, extents: Sequence[ChunkExtent], vertex_count: int) -> None:
        self._folder = folder
        sizes = [np.subtract(one.high, one.low).max() for one in extents]
        self._size = float(max(sizes, default=1.0))
        # Cell index by grid position, in order of first occurrence, and the files of each cell.
        self._cells: dict[tuple[int, ...], int] = {}
        self._files: list[list[Path]] = []
        # First cell of each vertex, and whether other cells use it too.
        self._cell = np.full(vertex_count, _NO_CELL, np.uint16)
        self._in_several = np.zeros(vertex_count, np.bool_)

    def add(self, strip: MeshSubset) -> None:
        """Add the strip of a chunk."""
        mesh = strip.mesh
        if not len(mesh.triangles):
            return
        middles = mesh.vertices[mesh.triangles].mean(axis=1)
        places = np.floor(middles / self._size - 0.5).astype(np.int64)
        cells, of_cell = np.unique(places, axis=0, return_inverse=True)
        groups = [np.flatnonzero(of_cell.ravel() == number) for number in range(len(cells))]
        for place, cut in zip(cells.tolist(), split_by_groups(strip, groups), strict=True):
            cell = self._cells.setdefault(tuple(place), len(self._cells))
            if cell == len(self._files):
                self._files.append([])
            known = self._cell[cut.global_indices]
            self._in_several[cut.global_indices[(known != _NO_CELL) & (known != cell)]] = True
            self._cell[cut.global_indices[known == _NO_CELL]] = cell
            path = self._folder / f"{cell}-{len(self._files[cell])}.npz"
            self._files[cell].append(path)
            _write_subset(path, cut)

    def iterate_cells(self) -> Iterator[MeshSubset]:
        """Yield the strips of each cell as one subset."""
        for files in self._files:
            cut = join_subsets([_read_subset(file) for file in files])
            yield MeshSubset(
                cut.mesh, cut.global_indices, cut.is_shared | self._in_several[cut.global_indices]
            )


def _write_subset(path: Path, cut: MeshSubset) -> None:
    arrays: dict[str, Any] = {
        "vertices": cut.mesh.vertices,
        "triangles": cut.mesh.triangles,
        "numbers": cut.global_indices,
        "is_of_both": cut.is_shared,
    }
    if cut.mesh.colors is not None:
        arrays["colors"] = cut.mesh.colors
    np.savez(path, **arrays)


def _read_subset(path: Path) -> MeshSubset:
    with np.load(path) as held:
        mesh = Mesh(held["vertices"], held["triangles"], held.get("colors"))
        return MeshSubset(mesh, held["numbers"], held["is_of_both"])
