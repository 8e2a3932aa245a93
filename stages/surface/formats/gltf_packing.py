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

MESHOPT_COMPRESSION, MESH_QUANTIZATION = "EXT_meshopt_compression", "KHR_mesh_quantization"
VERTEX_TARGET, INDEX_TARGET = 34962, 34963  # bufferView.target

# Maximum bits of a position component, and default bits of a texture coordinate.
_MAX_BITS = 16
MAX_STEPS: int = 2**_MAX_BITS - 1
_NORMAL_SCALE = 127

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class QuantizationGrid:
    """Uniform quantization grid for positions.

    Attributes
    ----------
    origin : (3,) origin, metres.
    step : grid spacing in metres; 1 if all positions are equal.
    """

    origin: Floats
    step: float

    def quantize(self, vertices: Floats) -> NDArray[np.uint16]:
        """Quantize positions (n, 3) to grid steps (n, 4); the last column is padding."""
        found = np.rint((vertices - self.origin) / self.step).clip(0, MAX_STEPS)
        return np.pad(found.astype(np.uint16), ((0, 0), (0, 1)))

    @property
    def max_error(self) -> float:
        """Maximum distance in metres by which quantization moves a vertex."""
        return float(0.5 * np.sqrt(3) * self.step)


def make_quantization_grid(vertices: Floats, bits: int = _MAX_BITS) -> QuantizationGrid:
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
    return QuantizationGrid(low, float(2.0 ** np.ceil(np.log2(size / (2**bits - 1)))) if size > 0 else 1.0)


def quantize_normals(normals: NDArray[np.float32]) -> NDArray[np.int8]:
    """Quantize unit vectors (n, 3) to 8-bit components (n, 4); the last column is padding."""
    return np.pad(np.rint(normals * _NORMAL_SCALE).astype(np.int8), ((0, 0), (0, 1)))


def quantize_uvs(uvs: Floats, steps: tuple[int, int] = (MAX_STEPS, MAX_STEPS)) -> NDArray[np.uint16] | None:
    """Quantize texture coordinates (n, 2); None if some are outside the image.

    Parameters
    ----------
    steps : steps per image side along u and v.
    """
    places = np.rint(uvs * steps)
    if max(steps) > MAX_STEPS or (places.size and (places.min() < 0 or (places > steps).any())):
        return None
    return np.asarray(places, np.uint16)


def reorder_for_compression(
    triangles: NDArray[np.int32], vertex_count: int
) -> tuple[NDArray[np.int32], NDArray[Any]]:
    """Reorder triangles for compression, and vertices by first use.

    Parameters
    ----------
    triangles : (m, 3) vertex indices.
    vertex_count : number of vertices.

    Returns
    -------
    The reordered triangles (m, 3) with new vertex indices, and the old index of each new vertex.
    """
    ordered = _kernels.optimize_strip_order(np.ascontiguousarray(triangles, np.int32), vertex_count)
    named, first = np.unique(ordered, return_index=True)
    order = named[np.argsort(first)]
    place = np.zeros(vertex_count, np.int32)
    place[order] = np.arange(len(order), dtype=np.int32)
    return place[ordered], order


def compress_buffer(values: NDArray[Any], target: int) -> tuple[bytes, str]:
    """Compress a buffer with meshoptimizer; return the bytes and the extension's mode.

    Parameters
    ----------
    values : (n, k) attribute rows whose size is a multiple of four bytes, or (3 m,) triangle indices.
    target : VERTICES or INDICES.
    """
    values = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    if target == VERTEX_TARGET:
        return _kernels.encode_rows(values.view(np.uint8)), "ATTRIBUTES"
    triangles = values.reshape(-1, 3).astype(np.int32)
    return _kernels.encode_triangles(triangles, int(triangles.max()) + 1), "TRIANGLES"
