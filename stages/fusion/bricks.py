"""Space in bricks: which frames touch which, and how many of them fit into memory at a time.

A brick is a cube of blocks whose side is a power of two, at a multiple of it. In the Z-order of blocks its
own follow each other without another's between, and so do those of eight bricks that make a cube: what is
computed apart is joined by appending. To know its surface a brick needs the blocks next to it as well (see
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

# Blocks lie within ± this of the field's origin: 21 bits for each axis.
_REACH = 1 << 20
_BITS = 21
# Keys of blocks that are waiting to be merged with those that are known.
_WAITING = 1 << 20


@dataclass(frozen=True)
class Cube:
    """Blocks of a cube.

    Attributes
    ----------
    level : there are 2^level blocks along its side.
    number : place in Z-order among the cubes of its level.
    """

    level: int
    number: int

    @property
    def low(self) -> Block:
        """Return its lowest block."""
        x, y, z = coordinates(np.array([self.number << 3 * self.level], np.uint64))[0]
        return int(x), int(y), int(z)

    @property
    def high(self) -> Block:
        """Return the block after its highest, along each axis."""
        x, y, z = (c + (1 << self.level) for c in self.low)
        return x, y, z

    def parts(self) -> Iterator[Cube]:
        """Yield the eight cubes it is made of, in their order."""
        yield from (Cube(self.level - 1, 8 * self.number + i) for i in range(8))


def level_of(brick_size: float, voxel_size: float) -> int:
    """Return how large bricks are, as a cube's level: as near to `brick_size`, metres, as there is one."""
    return min(max(round(math.log2(brick_size / (BLOCK * voxel_size))), 1), _BITS - 1)


def coordinates(keys: Keys) -> NDArray[np.int32]:
    """Return the coordinates (n, 3) of blocks, in blocks, from their places in Z-order."""
    places = np.stack([_gathered(keys >> np.uint64(axis)) for axis in range(3)], axis=1)
    return np.asarray(places - np.int32(_REACH), np.int32)


def _gathered(bits: Keys) -> NDArray[np.int32]:
    """Take every third bit."""
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
    """Put two zeros before each bit."""
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
    """Return the places in Z-order of cubes of a level, from their coordinates (n, 3) in cubes."""
    x, y, z = (_spread(axis + (_REACH >> level)) for axis in cubes.T)
    return np.asarray(x | y << np.uint64(1) | z << np.uint64(2))


def touched_bricks(keys: Keys, level: int) -> list[int]:
    """Return the bricks whose surface may depend on blocks: those they are in, and those next to them."""
    places = coordinates(keys).astype(np.int64)
    ends = (places - 1) >> level, (places + 1) >> level
    found = [
        numbers_of(np.stack([ends[i >> axis & 1][:, axis] for axis in range(3)], axis=1), level)
        for i in range(8)
    ]
    return [int(number) for number in np.unique(np.concatenate(found))]


class Seen:
    """Blocks that frames touch, gathered frame by frame."""

    def __init__(self) -> None:
        self._known: Keys = np.zeros(0, np.uint64)
        self._times: NDArray[np.int64] = np.zeros(0, np.int64)
        self._waiting: list[Keys] = []
        self._count = 0

    def add(self, keys: Keys) -> None:
        """Add the blocks of a frame."""
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
        """Return all of them once, in their order, and how many frames touch each."""
        self._merge()
        return self._known, self._times


def passes(keys: Keys, level: int, most_blocks: int) -> list[Cube]:
    """Cut what is to be fused into cubes whose blocks, with those next to them, are at most `most_blocks`.

    Parameters
    ----------
    keys : of all blocks, in their order.
    level : of a brick: no cube is smaller.

    Returns
    -------
    The cubes in their order; one of a brick alone may have more blocks than that.
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
    """Return those of some bricks that are in a cube, in their order."""
    shift = 3 * (cube.level - level)
    return [Cube(level, number) for number in sorted(bricks) if number >> shift == cube.number]
