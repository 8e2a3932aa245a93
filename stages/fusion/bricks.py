"""Bricks: cubes of blocks that are fused independently.

A brick is an axis-aligned cube of 2^level blocks per side, aligned to multiples of its side. In Z-order
(Morton order) the blocks of a brick are contiguous, and so are eight sibling bricks. Meshes of bricks are
therefore stitched by concatenation. The surface of a brick also depends on the adjacent blocks (see
kernels/src/fusion/surface.rs).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.fusion.voxels import BLOCK, Keys

Block = tuple[int, int, int]

# Block coordinates range within ± this from the origin of the volume: 21 bits per axis of a 64-bit key.
_REACH = 1 << 20
_BITS = 21
# Block keys buffered before a merge, which sorts: 8 MB of uint64 keys.
_WAITING = 1 << 20


@dataclass(frozen=True)
class Cube:
    """Axis-aligned cube of blocks, addressed by its Z-order index.

    Attributes
    ----------
    level : log2 of the number of blocks along a side.
    number : Z-order index among the cubes of this level.
    """

    level: int
    number: int

    @property
    def low(self) -> Block:
        """Return the lowest block coordinates of the cube."""
        x, y, z = coordinates(np.array([self.number << 3 * self.level], np.uint64))[0]
        return int(x), int(y), int(z)

    @property
    def high(self) -> Block:
        """Return the exclusive upper block coordinates of the cube."""
        x, y, z = (c + (1 << self.level) for c in self.low)
        return x, y, z

    def parts(self) -> Iterator[Cube]:
        """Yield the eight child cubes in Z-order."""
        yield from (Cube(self.level - 1, 8 * self.number + i) for i in range(8))


def level_of(brick_size: float, voxel_size: float) -> int:
    """Return the cube level whose side is closest to `brick_size`.

    Parameters
    ----------
    brick_size, voxel_size : metres; sides are compared on a log scale.
    """
    return min(max(round(math.log2(brick_size / (BLOCK * voxel_size))), 1), _BITS - 1)


def coordinates(keys: Keys) -> NDArray[np.int32]:
    """Decode Z-order keys of blocks to block coordinates (n, 3)."""
    places = np.stack([_gathered(keys >> np.uint64(axis)) for axis in range(3)], axis=1)
    return np.asarray(places - np.int32(_REACH), np.int32)


def _gathered(bits: Keys) -> NDArray[np.int32]:
    """Compact every third bit (inverse of `_spread`)."""
    bits = bits & np.uint64(0x1249249249249249)
    for shift, mask in (
        (2, 0x10C30C30C30C30C3),
        (4, 0x100F00F00F00F00F),
        (8, 0x001F0000FF0000FF),
        (16, 0x001F00000000FFFF),
        (32, 0x1FFFFF),
    ):
        bits = (bits | bits >> np.uint64(shift)) & np.uint64(mask)
    return bits.astype(np.int32)


def _spread(places: NDArray[np.int64]) -> Keys:
    """Insert two zero bits before each bit."""
    bits = places.astype(np.uint64)
    for shift, mask in (
        (32, 0x001F00000000FFFF),
        (16, 0x001F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        bits = (bits | bits << np.uint64(shift)) & np.uint64(mask)
    return bits


def numbers_of(cubes: NDArray[np.int64], level: int) -> Keys:
    """Encode cube coordinates (n, 3) of a level to Z-order indices (n,)."""
    x, y, z = (_spread(axis + (_REACH >> level)) for axis in cubes.T)
    return np.asarray(x | y << np.uint64(1) | z << np.uint64(2))


def touched_bricks(keys: Keys, level: int) -> list[int]:
    """Find the bricks whose surface depends on the given blocks.

    These are the bricks that contain a block or a neighbour of a block.

    Parameters
    ----------
    keys : Z-order keys of blocks.
    level : level of the bricks.

    Returns
    -------
    Sorted Z-order indices of the bricks.
    """
    places = coordinates(keys).astype(np.int64)
    ends = (places - 1) >> level, (places + 1) >> level
    found = [
        numbers_of(np.stack([ends[i >> axis & 1][:, axis] for axis in range(3)], axis=1), level)
        for i in range(8)
    ]
    return [int(number) for number in np.unique(np.concatenate(found))]


class Seen:
    """Counter of frames per touched block."""

    def __init__(self) -> None:
        self._known: Keys = np.zeros(0, np.uint64)
        self._times: NDArray[np.int64] = np.zeros(0, np.int64)
        self._waiting: list[Keys] = []
        self._count = 0

    def add(self, keys: Keys) -> None:
        """Count the blocks touched by one frame."""
        self._waiting.append(keys)
        self._count += len(keys)
        if self._count > _WAITING:
            self._merge()

    def _merge(self) -> None:
        keys = np.concatenate([self._known, *self._waiting])
        times = np.ones(len(keys), np.int64)
        times[: len(self._times)] = self._times
        self._known, place = np.unique(keys, return_inverse=True)
        self._times = np.bincount(place, times, len(self._known)).astype(np.int64)
        self._waiting, self._count = [], 0

    def all(self) -> tuple[Keys, NDArray[np.int64]]:
        """Return the sorted block keys and the frame count of each block."""
        self._merge()
        return self._known, self._times


def passes(keys: Keys, level: int, most_blocks: int) -> list[Cube]:
    """Split the touched space into cubes that fit in memory.

    Parameters
    ----------
    keys : sorted Z-order keys of all touched blocks.
    level : level of a brick, the smallest cube.
    most_blocks : maximum number of touched blocks per cube, including the blocks adjacent to the cube.

    Returns
    -------
    The cubes in Z-order. A cube that is a single brick may exceed `most_blocks`.
    """
    places = coordinates(keys)

    def cut(cube: Cube, near: NDArray[np.int32]) -> Iterator[Cube]:
        low, high = np.array(cube.low), np.array(cube.high)
        near = near[((near >= low - 1) & (near <= high)).all(axis=1)]
        if not ((near >= low) & (near < high)).all(axis=1).any():
            return
        if len(near) <= most_blocks or cube.level <= level:
            yield cube
            return
        for part in cube.parts():
            yield from cut(part, near)

    return list(cut(Cube(_BITS, 0), places))


def bricks_of(cube: Cube, bricks: Iterable[int], level: int) -> list[Cube]:
    """Return the bricks inside a cube, in Z-order. `bricks` are Z-order indices at `level`."""
    shift = 3 * (cube.level - level)
    return [Cube(level, number) for number in sorted(bricks) if number >> shift == cube.number]
