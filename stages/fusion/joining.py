"""Pieces of a surface, each of one brick, and the whole they make.

A piece has the vertices of its own blocks, and names those of its neighbours by the edges they lie on. Joined
in the order of the bricks they are the surface of a single piece, bit for bit. Pieces are files, so that no
more than one has to be in memory.
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

# Edges of a block, first and second vertices, have codes below this.
_CODES = 1 << 12
_SURFACE, _JOINT = "surface.npz", "joint.npz"


@dataclass(frozen=True, eq=False)
class Piece:
    """The surface of a brick.

    Attributes
    ----------
    vertices : (n, 3) float64 metres, in the field's axes.
    triangles : (m, 3) int32; numbers from n upward are those of vertices that neighbours have.
    colors : (n, 3) uint8, or None.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    colors: NDArray[np.uint8] | None


@dataclass(frozen=True, eq=False)
class Joint:
    """How a piece is joined to those beside it, and how large it is.

    Attributes
    ----------
    foreign : uint64; blocks (k,) in Z-order, and codes of edges (k,), of the vertices that neighbours have.
    shared : the same (j,) of the vertices on lower faces, which neighbours may name, and their numbers.
    size : of vertices and triangles.
    """

    foreign: tuple[Keys, Keys]
    shared: tuple[Keys, Keys, Keys]
    size: tuple[int, int]


def write_piece(folder: Path, piece: Piece, joints: Sequence[Keys]) -> None:
    """Write a piece as uncompressed .npz files: the surface, and beside it how it is joined."""
    arrays: dict[str, NDArray[Any]] = {"vertices": piece.vertices, "triangles": piece.triangles}
    if piece.colors is not None:
        arrays["colors"] = piece.colors
    np.savez(folder / _SURFACE, allow_pickle=False, **arrays)
    size = np.array([len(piece.vertices), len(piece.triangles)])
    np.savez(folder / _JOINT, size, *joints)


@contextmanager
def reading(folder: Path) -> Iterator[None]:
    """Tell in one sentence that the files of a piece are not as they were written.

    They were when they were found; what is kept of them is looked through and made anew by the next run.
    """
    try:
        yield
    except (OSError, EOFError, ValueError, LookupError, BadZipFile, InputError) as error:
        raise StageError(
            FUSE_BRICK_DAMAGED,
            "this brick of the fused surface was damaged while it was used",
            remedy="run again, which makes it anew.",
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
    """Pieces in files, joined as they are read.

    Parameters
    ----------
    cubes : the bricks, in their order.
    folders : of their pieces.

    Attributes
    ----------
    vertex_ends, triangle_ends : (k + 1,) how many there are before each brick, and in all.
    vertex_count, triangle_count : in all.

    Raises
    ------
    StageError
        If there are more triangles than can be numbered.
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
                "the surface has {triangle_count:,} triangles, more than can be numbered.",
                remedy="Give a larger voxel_size, or fuse a part of the scan (box).",
                triangle_count=self.triangle_count,
            )
        self._shared = [
            self._local(cube.number, *joint.shared[:2])
            for cube, joint in zip(cubes, self._joints, strict=True)
        ]

    def __iter__(self) -> Iterator[tuple[Piece, NDArray[np.int32]]]:
        """Yield the pieces, each with its triangles by numbers that count through all of them."""
        for first, folder, joint in zip(self.vertex_ends, self._folders, self._joints, strict=False):
            piece = _read_piece(folder)
            own = np.arange(first, first + len(piece.vertices))
            numbers = np.concatenate([own, self._numbers(*joint.foreign)])
            yield piece, numbers[piece.triangles].astype(np.int32)

    def mesh(self) -> Mesh:
        """Return all of it, in memory."""
        pieces, triangles = zip(*self, strict=True)
        colors = [piece.colors for piece in pieces if piece.colors is not None]
        return Mesh(
            np.concatenate([piece.vertices for piece in pieces]),
            np.concatenate(triangles),
            np.concatenate(colors) if colors else None,
        )

    def _local(self, brick: int, blocks: Keys, codes: Keys) -> Keys:
        """Return one key for block and edge, among those of one brick."""
        return np.asarray((blocks - np.uint64(brick << 3 * self._level)) * np.uint64(_CODES) + codes)

    def _numbers(self, blocks: Keys, codes: Keys) -> NDArray[np.int64]:
        """Return the numbers of vertices that other pieces have."""
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
        "pieces of the surface do not fit each other",
        remedy="fuse again, with run.force=fuse.",
    )
