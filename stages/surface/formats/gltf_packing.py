"""Compression of glTF buffers: quantization (KHR_mesh_quantization) and EXT_meshopt_compression.

In both, each row of a buffer view starts at a multiple of four bytes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels

# Values of `compress`: floats, quantized integers, or quantized integers with meshoptimizer's codec.
COMPRESSIONS = ("none", "quantize", "meshopt")
# Values of `shading`: "keep" follows the materials, and gives vertex colours a lit material. "bare" does the
# same, but uncompressed vertex colours get no material. "unlit" and "lit" override the materials.
SHADINGS = ("bare", "keep", "unlit", "lit")

PACKED, QUANTIZED = "EXT_meshopt_compression", "KHR_mesh_quantization"
VERTICES, INDICES = 34962, 34963  # bufferView.target

# Maximum bits of a position component, and default bits of a texture coordinate.
_BITS = 16
MAX_STEPS: int = 2**_BITS - 1
_UNIT = 127

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Lattice:
    """Uniform quantization grid for positions.

    Attributes
    ----------
    low : (3,) origin, metres.
    step : grid spacing in metres; 1 if all positions are equal.
    """

    low: Floats
    step: float

    def steps(self, vertices: Floats) -> NDArray[np.uint16]:
        """Quantize positions (n, 3) to grid steps (n, 4); the last column is padding."""
        found = np.rint((vertices - self.low) / self.step).clip(0, MAX_STEPS)
        return np.pad(found.astype(np.uint16), ((0, 0), (0, 1)))

    @property
    def farthest(self) -> float:
        """Maximum distance in metres by which quantization moves a vertex."""
        return float(0.5 * np.sqrt(3) * self.step)


def lattice_of(vertices: Floats, bits: int = _BITS) -> Lattice:
    """Return the quantization grid of a mesh.

    All parts share one grid, so shared boundaries stay closed.

    Parameters
    ----------
    vertices : (n, 3) positions, metres.
    bits : bits per component, 1 to 16.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = float((high - low).max())
    # With a power of two as step, viewers dequantize in floats without rounding, if the coordinates are
    # small.
    return Lattice(low, float(2.0 ** np.ceil(np.log2(size / (2**bits - 1)))) if size > 0 else 1.0)


def quantized_unit(normals: NDArray[np.float32]) -> NDArray[np.int8]:
    """Quantize unit vectors (n, 3) to 8-bit components (n, 4); the last column is padding."""
    return np.pad(np.rint(normals * _UNIT).astype(np.int8), ((0, 0), (0, 1)))


def quantized_uvs(uvs: Floats, steps: tuple[int, int] = (MAX_STEPS, MAX_STEPS)) -> NDArray[np.uint16] | None:
    """Quantize texture coordinates (n, 2); None if some are outside the image.

    Parameters
    ----------
    steps : steps per image side along u and v.
    """
    places = np.rint(uvs * steps)
    if max(steps) > MAX_STEPS or (places.size and (places.min() < 0 or (places > steps).any())):
        return None
    return np.asarray(places, np.uint16)


def strips(triangles: NDArray[np.int32], vertices: int) -> tuple[NDArray[np.int32], NDArray[Any]]:
    """Reorder triangles for compression, and vertices by first use.

    Parameters
    ----------
    triangles : (m, 3) vertex indices.
    vertices : number of vertices.

    Returns
    -------
    The reordered triangles (m, 3) with new vertex indices, and the old index of each new vertex.
    """
    ordered = _kernels.strip_order(np.ascontiguousarray(triangles, np.int32), vertices)
    named, first = np.unique(ordered, return_index=True)
    order = named[np.argsort(first)]
    place = np.zeros(vertices, np.int32)
    place[order] = np.arange(len(order), dtype=np.int32)
    return place[ordered], order


def packed(values: NDArray[Any], target: int) -> tuple[bytes, str]:
    """Compress a buffer with meshoptimizer; return the bytes and the extension's mode.

    Parameters
    ----------
    values : (n, k) attribute rows whose size is a multiple of four bytes, or (3 m,) triangle indices.
    target : VERTICES or INDICES.
    """
    values = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    if target == VERTICES:
        return _kernels.encode_rows(values.view(np.uint8)), "ATTRIBUTES"
    triangles = values.reshape(-1, 3).astype(np.int32)
    return _kernels.encode_triangles(triangles, int(triangles.max()) + 1), "TRIANGLES"
