"""Buffers of glTF files in fewer bytes: whole numbers in place of floats, and meshoptimizer's codec.

KHR_mesh_quantization; EXT_meshopt_compression. A row of a buffer begins at a multiple of four bytes in both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels

# How a file is made small: not at all, in whole numbers, or in whole numbers that are packed.
COMPRESSIONS = ("none", "quantize", "meshopt")
# How a surface takes light: as its materials say, where colours of vertices have none, or one that is lit;
# not at all; as one without gloss.
SHADINGS = ("bare", "keep", "unlit", "lit")

PACKED, QUANTIZED = "EXT_meshopt_compression", "KHR_mesh_quantization"
VERTICES, INDICES = 34962, 34963  # what a buffer view is for

# Bits of a number: of positions at most, of texture coordinates where nothing else is asked for.
_BITS = 16
MAX_STEPS: int = 2**_BITS - 1
_UNIT = 127

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Lattice:
    """Places in steps, of which a few bits hold as many as there are along the longest side.

    Attributes
    ----------
    low : (3,) where it begins, metres.
    step : metres; 1 where all is in one place.
    """

    low: Floats
    step: float

    def steps(self, vertices: Floats) -> NDArray[np.uint16]:
        """Return places (n, 4), of which the last is filling."""
        found = np.rint((vertices - self.low) / self.step).clip(0, MAX_STEPS)
        return np.pad(found.astype(np.uint16), ((0, 0), (0, 1)))

    @property
    def farthest(self) -> float:
        """How far a vertex is moved at most, metres."""
        return float(0.5 * np.sqrt(3) * self.step)


def lattice_of(vertices: Floats, bits: int = _BITS) -> Lattice:
    """Return the lattice of a mesh, one for all its parts, so that they stay joined.

    Parameters
    ----------
    bits : of a number, 1 to 16.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = float((high - low).max())
    # A power of two: then places are exact sums in the numbers of viewers, too, where these are small enough.
    return Lattice(low, float(2.0 ** np.ceil(np.log2(size / (2**bits - 1)))) if size > 0 else 1.0)


def quantized_unit(normals: NDArray[np.float32]) -> NDArray[np.int8]:
    """Return unit vectors (n, 4) in 8 bits a number, of which the last is filling."""
    return np.pad(np.rint(normals * _UNIT).astype(np.int8), ((0, 0), (0, 1)))


def quantized_uvs(uvs: Floats, steps: tuple[int, int] = (MAX_STEPS, MAX_STEPS)) -> NDArray[np.uint16] | None:
    """Return texture coordinates (n, 2) in steps of the image's sides; None if they go beyond the image.

    Parameters
    ----------
    steps : along u and v.
    """
    places = np.rint(uvs * steps)
    if max(steps) > MAX_STEPS or (places.size and (places.min() < 0 or (places > steps).any())):
        return None
    return np.asarray(places, np.uint16)


def strips(triangles: NDArray[np.int32], vertices: int) -> tuple[NDArray[np.int32], NDArray[Any]]:
    """Return triangles in an order that packs well, and which vertices these name, in the order of naming."""
    ordered = _kernels.strip_order(np.ascontiguousarray(triangles, np.int32), vertices)
    named, first = np.unique(ordered, return_index=True)
    order = named[np.argsort(first)]
    place = np.zeros(vertices, np.int32)
    place[order] = np.arange(len(order), dtype=np.int32)
    return place[ordered], order


def packed(values: NDArray[Any], target: int) -> tuple[bytes, str]:
    """Return the rows of a buffer packed, and the way in which they are.

    Parameters
    ----------
    values : (n, k) of a vertex each, k of them a multiple of four bytes; or (n, ) indices, three a triangle.
    target : VERTICES or INDICES.
    """
    values = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    if target == VERTICES:
        return _kernels.encode_rows(values.view(np.uint8)), "ATTRIBUTES"
    triangles = values.reshape(-1, 3).astype(np.int32)
    return _kernels.encode_triangles(triangles, int(triangles.max()) + 1), "TRIANGLES"
