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
from scanloom.stages.fusion.bricks import Cube
from scanloom.stages.fusion.codes import FUSE_BRICK_DAMAGED
from scanloom.stages.fusion.voxels import Keys
from scanloom.stages.surface.codes import FUSE_TOO_LARGE
from scanloom.stages.surface.mesh import Mesh

# Power of two above all edge codes: a block has 8³ × 3 edges with up to two vertices each, so 3072 codes.
_CODES = 1 << 12
_SURFACE, _JOINT = "surface.npz", "joint.npz"


@dataclass(frozen=True, eq=False)
class Piece:
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
class Joint:
    """Vertices shared with neighbouring bricks, and size of the brick mesh.

    Attributes
    ----------
    foreign : referenced vertices of neighbours: Z-order keys of their blocks (k,) and their edge codes (k,),
        uint64.
    shared : own vertices on the lower faces, which neighbours may reference: block keys (j,), edge codes (j,)
        and vertex indices (j,).
    size : number of vertices and of triangles.
    """

    foreign: tuple[Keys, Keys]
    shared: tuple[Keys, Keys, Keys]
    size: tuple[int, int]


def write_piece(folder: Path, piece: Piece, joints: Sequence[Keys]) -> None:
    """Write a brick mesh as uncompressed .npz files.

    One file has the mesh, the other one the shared vertices and the size.
    """
    arrays: dict[str, NDArray[Any]] = {"vertices": piece.vertices, "triangles": piece.triangles}
    if piece.colors is not None:
        arrays["colors"] = piece.colors
    np.savez(folder / _SURFACE, allow_pickle=False, **arrays)
    size = np.array([len(piece.vertices), len(piece.triangles)])
    np.savez(folder / _JOINT, size, *joints)


@contextmanager
def reading(folder: Path) -> Iterator[None]:
    """Convert errors of reading a brick's files to a StageError.

    The store validates bricks when it finds them, so an error here means damage during the run. The next run
    validates again and fuses the damaged brick anew.
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


def _read_piece(folder: Path) -> Piece:
    with reading(folder), np.load(folder / _SURFACE) as kept:
        return Piece(kept["vertices"], kept["triangles"], kept.get("colors"))


def _read_joint(folder: Path) -> Joint:
    with reading(folder), np.load(folder / _JOINT) as kept:
        size, *joints = (kept[f"arr_{i}"] for i in range(6))
    return Joint((joints[0], joints[1]), (joints[2], joints[3], joints[4]), (int(size[0]), int(size[1])))


class Joined:
    """Mesh stitched from brick files as they are read.

    Parameters
    ----------
    cubes : bricks in Z-order.
    folders : folder of each brick's files.

    Attributes
    ----------
    vertex_ends, triangle_ends : (k + 1,) cumulative counts: index of the first element of each brick, and the
        total.
    vertex_count, triangle_count : totals.

    Raises
    ------
    StageError
        If an element count exceeds the int32 range.
    """

    def __init__(self, cubes: Sequence[Cube], folders: Sequence[Path]) -> None:
        self.cubes = list(cubes)
        self._folders = list(folders)
        self._level = cubes[0].level if cubes else 0
        self._place = {cube.number: i for i, cube in enumerate(cubes)}
        self._joints = [_read_joint(folder) for folder in folders]
        sizes = np.array([(0, 0), *(joint.size for joint in self._joints)], np.int64)
        self.vertex_ends, self.triangle_ends = np.cumsum(sizes, axis=0).T
        self.vertex_count, self.triangle_count = int(self.vertex_ends[-1]), int(self.triangle_ends[-1])
        if max(self.vertex_count, self.triangle_count) > np.iinfo(np.int32).max:
            raise StageError(
                FUSE_TOO_LARGE,
                "the mesh has {triangle_count:,} triangles, more than 32-bit indices can address.",
                remedy="Increase voxel_size, or fuse a part of the scan (box).",
                triangle_count=self.triangle_count,
            )
        self._shared = [
            self._local(cube.number, *joint.shared[:2])
            for cube, joint in zip(cubes, self._joints, strict=True)
        ]

    def __iter__(self) -> Iterator[tuple[Piece, NDArray[np.int32]]]:
        """Yield each brick mesh with its triangles in global vertex indices."""
        for first, folder, joint in zip(self.vertex_ends, self._folders, self._joints, strict=False):
            piece = _read_piece(folder)
            own = np.arange(first, first + len(piece.vertices))
            numbers = np.concatenate([own, self._numbers(*joint.foreign)])
            yield piece, numbers[piece.triangles].astype(np.int32)

    def mesh(self) -> Mesh:
        """Return the stitched mesh in memory."""
        pieces, triangles = zip(*self, strict=True)
        colors = [piece.colors for piece in pieces if piece.colors is not None]
        return Mesh(
            np.concatenate([piece.vertices for piece in pieces]),
            np.concatenate(triangles),
            np.concatenate(colors) if colors else None,
        )

    def _local(self, brick: int, blocks: Keys, codes: Keys) -> Keys:
        """Combine block key and edge code to one key.

        The key is unique and ordered within one brick.
        """
        return np.asarray((blocks - np.uint64(brick << 3 * self._level)) * np.uint64(_CODES) + codes)

    def _numbers(self, blocks: Keys, codes: Keys) -> NDArray[np.int64]:
        """Look up the indices (k,) of vertices owned by other bricks."""
        numbers = np.empty(len(blocks), np.int64)
        bricks = blocks >> np.uint64(3 * self._level)
        for brick in np.unique(bricks):
            here = bricks == brick
            place = self._place.get(int(brick))
            if place is None:
                raise _do_not_fit()
            known, its_numbers = self._shared[place], self._joints[place].shared[2].astype(np.int64)
            wanted = self._local(int(brick), blocks[here], codes[here])
            at = np.searchsorted(known, wanted)
            if (at == len(known)).any() or (known[at] != wanted).any():
                raise _do_not_fit()
            numbers[here] = self.vertex_ends[place] + its_numbers[at]
        return numbers


def _do_not_fit() -> StageError:
    return StageError(
        FUSE_BRICK_DAMAGED,
        "the meshes of adjacent bricks do not match",
        remedy="run again with --force fuse.",
    )
