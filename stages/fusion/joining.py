"""Pieces of a surface, each of one brick, and the whole they make.

A piece has the vertices of its own blocks, and names those of its neighbours by the edges they lie on. Joined
in the order of the bricks they are the surface of a single piece, bit for bit. Pieces are files, so that no
more than one has to be in memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.errors import StageError
from stages.fusion.bricks import Cube
from stages.fusion.voxels import Keys
from stages.surface.mesh import Mesh

# Edges of a block, first and second vertices, have codes below this.
_CODES = 1 << 12
_JOINTS = ("foreign_blocks", "foreign_codes", "shared_blocks", "shared_codes", "shared_numbers")


@dataclass(frozen=True, eq=False)
class Piece:
    """The surface of a brick.

    Attributes
    ----------
    vertices : (n, 3) float64 metres, in the field's axes.
    triangles : (m, 3) int32; numbers from n upward are those of vertices that neighbours have.
    colors : (n, 3) uint8, or None.
    joints : uint64; blocks (k,) in Z-order and codes of edges (k,) of the vertices that neighbours have; the
        same (j,) of the vertices on lower faces, which neighbours may name, and their numbers.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    colors: NDArray[np.uint8] | None
    joints: Sequence[Keys]


def write_piece(path: Path, piece: Piece) -> None:
    """Write a piece as an uncompressed .npz file."""
    arrays: dict[str, NDArray[Any]] = dict(zip(_JOINTS, piece.joints, strict=True))
    if piece.colors is not None:
        arrays["colors"] = piece.colors
    np.savez(path, allow_pickle=False, vertices=piece.vertices, triangles=piece.triangles, **arrays)


def read_piece(path: Path) -> Piece:
    """Read what `write_piece` wrote."""
    with np.load(path) as kept:
        return Piece(
            kept["vertices"],
            kept["triangles"],
            kept.get("colors"),
            [kept[name] for name in _JOINTS],
        )


@dataclass(frozen=True)
class Brick:
    """A brick, and the file of its piece."""

    cube: Cube
    path: Path


class Joined:
    """Pieces in files, joined as they are read.

    Parameters
    ----------
    bricks : in their order.

    Raises
    ------
    StageError
        If there are more triangles than can be numbered.
    """

    def __init__(self, bricks: Sequence[Brick]) -> None:
        self._bricks = list(bricks)
        self._level = bricks[0].cube.level if bricks else 0
        self._place = {brick.cube.number: i for i, brick in enumerate(bricks)}
        self._shared: list[tuple[Keys, NDArray[np.int64]]] = []
        vertices, triangles = [0], [0]
        for brick, piece in zip(self._bricks, self.pieces(), strict=True):
            vertices.append(len(piece.vertices))
            triangles.append(len(piece.triangles))
            blocks, codes, numbers = piece.joints[2:]
            self._shared.append((self._local(brick.cube.number, blocks, codes), numbers.astype(np.int64)))
        self._vertices, self._triangles = np.cumsum(vertices), np.cumsum(triangles)
        self.vertex_count, self.triangle_count = int(self._vertices[-1]), int(self._triangles[-1])
        if max(self.vertex_count, self.triangle_count) > np.iinfo(np.int32).max:
            raise StageError(
                f"the surface has {self.triangle_count:,} triangles, more than can be numbered. Give a "
                "larger voxel_size, or fuse a part of the scan (box)."
            )

    def sizes(self) -> Iterator[tuple[Cube, tuple[int, int], tuple[int, int]]]:
        """Yield each brick with first and end of its vertices and of its triangles."""
        for i, brick in enumerate(self._bricks):
            vertices, triangles = (
                (int(ends[i]), int(ends[i + 1])) for ends in (self._vertices, self._triangles)
            )
            yield brick.cube, vertices, triangles

    def pieces(self) -> Iterator[Piece]:
        """Yield the pieces one after the other, as they are."""
        return (read_piece(brick.path) for brick in self._bricks)

    def triangles(self) -> Iterator[NDArray[np.int32]]:
        """Yield the triangles of each piece by numbers that count through all of them."""
        for first, piece in zip(self._vertices, self.pieces(), strict=False):
            own = np.arange(first, first + len(piece.vertices))
            numbers = np.concatenate([own, self._numbers(*piece.joints[:2])])
            yield numbers[piece.triangles].astype(np.int32)

    def mesh(self) -> Mesh:
        """Return all of it, in memory."""
        pieces = list(self.pieces())
        colors = [piece.colors for piece in pieces if piece.colors is not None]
        return Mesh(
            np.concatenate([piece.vertices for piece in pieces]),
            np.concatenate(list(self.triangles())),
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
            known, its_numbers = self._shared[place]
            wanted = self._local(int(brick), blocks[here], codes[here])
            at = np.searchsorted(known, wanted)
            if (at == len(known)).any() or (known[at] != wanted).any():
                raise _do_not_fit()
            numbers[here] = self._vertices[place] + its_numbers[at]
        return numbers


def _do_not_fit() -> StageError:
    return StageError("pieces of the surface do not fit each other; fuse again, with --force fuse.")
