"""Bricks: cubes of blocks that are fused independently.

A brick is an axis-aligned cube of 2^level blocks per side, aligned to multiples of its side. In Z-order
(Morton order) the blocks of a brick are contiguous, and so are eight sibling bricks. Meshes of bricks are
therefore stitched by concatenation. The surface of a brick also depends on the adjacent blocks (see
kernels/src/fusion/surface_extraction.rs).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.fusion.tsdf_volume import BLOCK_SIDE, BlockKeys

Block = tuple[int, int, int]

# Block coordinates range within ± this from the origin of the volume: 21 bits per axis of a 64-bit key.
_MAX_COORDINATE = 1 << 20
_BITS_PER_AXIS = 21
# Block keys buffered before a merge, which sorts: 8 MB of uint64 keys.
_MAX_PENDING_KEYS = 1 << 20


@dataclass(frozen=True)
class BlockCube:
    """Axis-aligned cube of blocks, addressed by its Z-order index.

    Attributes
    ----------
    level : log2 of the number of blocks along a side.
    index : Z-order index among the cubes of this level.
    """

    level: int
    index: int

    @property
    def low(self) -> Block:
        """Return the lowest block coordinates of the cube."""
        x, y, z = decode_z_order(np.array([self.index << 3 * self.level], np.uint64))[0]
        return int(x), int(y), int(z)

    @property
    def high(self) -> Block:
        """Return the exclusive upper block coordinates of the cube."""
        x, y, z = (c + (1 << self.level) for c in self.low)
        return x, y, z

    def iterate_children(self) -> Iterator[BlockCube]:
        """Yield the eight child cubes in Z-order."""
        yield from (BlockCube(self.level - 1, 8 * self.index + i) for i in range(8))


def compute_level(brick_size: float, voxel_size: float) -> int:
    """Return the cube level whose side is closest to `brick_size`.

    Parameters
    ----------
    brick_size, voxel_size : metres; sides are compared on a log scale.
    """
    return min(max(round(math.log2(brick_size / (BLOCK_SIDE * voxel_size))), 1), _BITS_PER_AXIS - 1)


def decode_z_order(keys: BlockKeys) -> NDArray[np.int32]:
    """Decode Z-order keys of blocks to block coordinates (n, 3)."""
    places = np.stack([_compact_bits(keys >> np.uint64(axis)) for axis in range(3)], axis=1)
    return np.asarray(places - np.int32(_MAX_COORDINATE), np.int32)


def _compact_bits(bits: BlockKeys) -> NDArray[np.int32]:
    """Compact every third bit (inverse of `_spread_bits`)."""
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


def _spread_bits(values: NDArray[np.int64]) -> BlockKeys:
    """Insert two zero bits before each bit."""
    bits = values.astype(np.uint64)
    for shift, mask in (
        (32, 0x001F00000000FFFF),
        (16, 0x001F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        bits = (bits | bits << np.uint64(shift)) & np.uint64(mask)
    return bits


def encode_z_order(cubes: NDArray[np.int64], level: int) -> BlockKeys:
    """Encode cube coordinates (n, 3) of a level to Z-order indices (n,)."""
    x, y, z = (_spread_bits(axis + (_MAX_COORDINATE >> level)) for axis in cubes.T)
    return np.asarray(x | y << np.uint64(1) | z << np.uint64(2))


def find_affected_bricks(keys: BlockKeys, level: int) -> list[int]:
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
    places = decode_z_order(keys).astype(np.int64)
    ends = (places - 1) >> level, (places + 1) >> level
    found = [
        encode_z_order(np.stack([ends[i >> axis & 1][:, axis] for axis in range(3)], axis=1), level)
        for i in range(8)
    ]
    return [int(number) for number in np.unique(np.concatenate(found))]


class TouchedBlockCounter:
    """Counter of frames per touched block."""

    def __init__(self) -> None:
        self._keys: BlockKeys = np.zeros(0, np.uint64)
        self._counts: NDArray[np.int64] = np.zeros(0, np.int64)
        self._pending: list[BlockKeys] = []
        self._pending_count = 0

    def add(self, keys: BlockKeys) -> None:
        """Count the blocks touched by one frame."""
        self._pending.append(keys)
        self._pending_count += len(keys)
        if self._pending_count > _MAX_PENDING_KEYS:
            self._merge()

    def _merge(self) -> None:
        keys = np.concatenate([self._keys, *self._pending])
        times = np.ones(len(keys), np.int64)
        times[: len(self._counts)] = self._counts
        self._keys, place = np.unique(keys, return_inverse=True)
        self._counts = np.bincount(place, times, len(self._keys)).astype(np.int64)
        self._pending, self._pending_count = [], 0

    def get_counts(self) -> tuple[BlockKeys, NDArray[np.int64]]:
        """Return the sorted block keys and the frame count of each block."""
        self._merge()
        return self._keys, self._counts


def split_into_passes(keys: BlockKeys, level: int, max_blocks: int) -> list[BlockCube]:
    """Split the touched space into cubes that fit in memory.

    Parameters
    ----------
    keys : sorted Z-order keys of all touched blocks.
    level : level of a brick, the smallest cube.
    max_blocks : maximum number of touched blocks per cube, including the blocks adjacent to the cube.

    Returns
    -------
    The cubes in Z-order. A cube that is a single brick may exceed `max_blocks`.
    """
    places = decode_z_order(keys)

    def split_cube(cube: BlockCube, near: NDArray[np.int32]) -> Iterator[BlockCube]:
        low, high = np.array(cube.low), np.array(cube.high)
        near = near[((near >= low - 1) & (near <= high)).all(axis=1)]
        if not ((near >= low) & (near < high)).all(axis=1).any():
            return
        if len(near) <= max_blocks or cube.level <= level:
            yield cube
            return
        for part in cube.iterate_children():
            yield from split_cube(part, near)

    return list(split_cube(BlockCube(_BITS_PER_AXIS, 0), places))


def select_bricks(cube: BlockCube, bricks: Iterable[int], level: int) -> list[BlockCube]:
    """Return the bricks inside a cube, in Z-order. `bricks` are Z-order indices at `level`."""
    shift = 3 * (cube.level - level)
    return [BlockCube(level, number) for number in sorted(bricks) if number >> shift == cube.index]
