"""Stitching of brick meshes into one mesh.

A brick mesh owns the vertices of its blocks. It references vertices of neighbouring bricks by the voxel edge
that contains them. Concatenated in Z-order, the brick meshes equal the in-memory mesh bit for bit. Brick
meshes are files, so that only one has to be in memory at a time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError, StageError
from scanloom.stages.fusion.bricks import BlockCube
from scanloom.stages.fusion.codes import FUSE_BRICK_DAMAGED
from scanloom.stages.fusion.tsdf_volume import BlockKeys
from scanloom.stages.surface.codes import FUSE_TOO_LARGE
from scanloom.stages.surface.mesh import Mesh

# Power of two above all edge codes: a block has 8³ × 3 edges with up to two vertices each, so 3072 codes.
_EDGE_CODE_LIMIT = 1 << 12
_MESH_FILE, _SHARED_VERTICES_FILE = "surface.npz", "joint.npz"


@dataclass(frozen=True, eq=False)
class BrickMesh:
    """Mesh of one brick.

    Attributes
    ----------
    vertices : (n, 3) float64 metres, volume coordinates.
    triangles : (m, 3) int32; indices from n upward reference vertices of neighbouring bricks.
    colors : (n, 3) uint8, or None.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    colors: NDArray[np.uint8] | None


@dataclass(frozen=True, eq=False)
class SharedVertices:
    """Vertices shared with neighbouring bricks, and size of the brick mesh.

    Attributes
    ----------
    referenced : referenced vertices of neighbours: Z-order keys of their blocks (k,) and their edge codes
        (k,),
        uint64.
    own : own vertices on the lower faces, which neighbours may reference: block keys (j,), edge codes (j,)
        and vertex indices (j,).
    element_counts : number of vertices and of triangles.
    """

    referenced: tuple[BlockKeys, BlockKeys]
    own: tuple[BlockKeys, BlockKeys, BlockKeys]
    element_counts: tuple[int, int]


def write_brick_mesh(folder: Path, mesh: BrickMesh, shared_arrays: Sequence[BlockKeys]) -> None:
    """Write a brick mesh as uncompressed .npz files.

    One file has the mesh, the other one the shared vertices and the size.
    """
    arrays: dict[str, NDArray[Any]] = {"vertices": mesh.vertices, "triangles": mesh.triangles}
    if mesh.colors is not None:
        arrays["colors"] = mesh.colors
    np.savez(folder / _MESH_FILE, allow_pickle=False, **arrays)
    size = np.array([len(mesh.vertices), len(mesh.triangles)])
    np.savez(folder / _SHARED_VERTICES_FILE, size, *shared_arrays)


@contextmanager
def convert_read_errors(folder: Path) -> Iterator[None]:
    """Convert errors of reading a brick's files to a StageError.

    The store validates bricks when it finds them, so an error here means damage during the run. The next run
    validates again and fuses the damaged brick again.
    """
    try:
        yield
    except (OSError, EOFError, ValueError, LookupError, BadZipFile, InputError) as error:
        raise StageError(
            FUSE_BRICK_DAMAGED,
            "the brick was damaged during the run",
            remedy="run again, which fuses the brick anew.",
            where=folder,
        ) from error


def _read_brick_mesh(folder: Path) -> BrickMesh:
    with convert_read_errors(folder), np.load(folder / _MESH_FILE) as kept:
        return BrickMesh(kept["vertices"], kept["triangles"], kept.get("colors"))


def _read_shared_vertices(folder: Path) -> SharedVertices:
    with convert_read_errors(folder), np.load(folder / _SHARED_VERTICES_FILE) as kept:
        size, *joints = (kept[f"arr_{i}"] for i in range(6))
    return SharedVertices(
        (joints[0], joints[1]), (joints[2], joints[3], joints[4]), (int(size[0]), int(size[1]))
    )


class StitchedMesh:
    """Mesh stitched from brick files as they are read.

    Parameters
    ----------
    cubes : bricks in Z-order.
    folders : folder of each brick's files.

    Attributes
    ----------
    vertex_offsets, triangle_offsets : (k + 1,) cumulative counts: index of the first element of each brick,
        and the
        total.
    vertex_count, triangle_count : totals.

    Raises
    ------
    StageError
        If an element count exceeds the int32 range.
    """

    def __init__(self, cubes: Sequence[BlockCube], folders: Sequence[Path]) -> None:
        self.cubes = list(cubes)
        self._folders = list(folders)
        self._level = cubes[0].level if cubes else 0
        self._brick_positions = {cube.index: i for i, cube in enumerate(cubes)}
        self._shared_vertices = [_read_shared_vertices(folder) for folder in folders]
        sizes = np.array([(0, 0), *(joint.element_counts for joint in self._shared_vertices)], np.int64)
        self.vertex_offsets, self.triangle_offsets = np.cumsum(sizes, axis=0).T
        self.vertex_count, self.triangle_count = int(self.vertex_offsets[-1]), int(self.triangle_offsets[-1])
        if max(self.vertex_count, self.triangle_count) > np.iinfo(np.int32).max:
            raise StageError(
                FUSE_TOO_LARGE,
                "the mesh has {triangle_count:,} triangles, more than 32-bit indices can address.",
                remedy="Increase voxel_size, or fuse a part of the scan (box).",
                triangle_count=self.triangle_count,
            )
        self._own_keys = [
            self._make_local_keys(cube.index, *joint.own[:2])
            for cube, joint in zip(cubes, self._shared_vertices, strict=True)
        ]

    def __iter__(self) -> Iterator[tuple[BrickMesh, NDArray[np.int32]]]:
        """Yield each brick mesh with its triangles in global vertex indices."""
        for first, folder, joint in zip(
            self.vertex_offsets, self._folders, self._shared_vertices, strict=False
        ):
            piece = _read_brick_mesh(folder)
            own = np.arange(first, first + len(piece.vertices))
            numbers = np.concatenate([own, self._find_vertex_indices(*joint.referenced)])
            yield piece, numbers[piece.triangles].astype(np.int32)

    def assemble_mesh(self) -> Mesh:
        """Return the stitched mesh in memory."""
        pieces, triangles = zip(*self, strict=True)
        colors = [piece.colors for piece in pieces if piece.colors is not None]
        return Mesh(
            np.concatenate([piece.vertices for piece in pieces]),
            np.concatenate(triangles),
            np.concatenate(colors) if colors else None,
        )

    def _make_local_keys(self, brick: int, blocks: BlockKeys, codes: BlockKeys) -> BlockKeys:
        """Combine block key and edge code to one key.

        The key is unique and ordered within one brick.
        """
        return np.asarray(
            (blocks - np.uint64(brick << 3 * self._level)) * np.uint64(_EDGE_CODE_LIMIT) + codes
        )

    def _find_vertex_indices(self, blocks: BlockKeys, codes: BlockKeys) -> NDArray[np.int64]:
        """Look up the indices (k,) of vertices owned by other bricks."""
        numbers = np.empty(len(blocks), np.int64)
        bricks = blocks >> np.uint64(3 * self._level)
        for brick in np.unique(bricks):
            here = bricks == brick
            place = self._brick_positions.get(int(brick))
            if place is None:
                raise _make_mismatch_error()
            known, its_numbers = self._own_keys[place], self._shared_vertices[place].own[2].astype(np.int64)
            wanted = self._make_local_keys(int(brick), blocks[here], codes[here])
            at = np.searchsorted(known, wanted)
            if (at == len(known)).any() or (known[at] != wanted).any():
                raise _make_mismatch_error()
            numbers[here] = self.vertex_offsets[place] + its_numbers[at]
        return numbers


def _make_mismatch_error() -> StageError:
    return StageError(
        FUSE_BRICK_DAMAGED,
        "the meshes of adjacent bricks do not match",
        remedy="run again with --force fuse.",
    )
