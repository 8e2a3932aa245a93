"""Binary buffer of a glTF file under construction, with its buffer views and accessors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.formats.gltf_container import JsonObject
from scanloom.stages.surface.formats.gltf_packing import (
    MESHOPT_COMPRESSION,
    VERTEX_TARGET,
    QuantizationGrid,
    compress_buffer,
)


class GltfBuffer:
    """Growing binary buffer that records buffer views and accessors in the glTF tree.

    Views compressed by meshoptimizer refer to a second, fallback buffer that has a size but no data
    (EXT_meshopt_compression).

    Attributes
    ----------
    lattice : quantization of positions; None for single-precision positions.
    texel_steps : quantization steps of texture coordinates per texel; 0 for the full 16-bit range.
    uses_meshopt : True to compress views with meshoptimizer.
    """

    def __init__(
        self, tree: JsonObject, lattice: QuantizationGrid | None, texel_steps: int = 0, *, use_meshopt: bool
    ) -> None:
        self._tree = tree
        self.lattice = lattice
        self.texel_steps = texel_steps
        self.uses_meshopt = use_meshopt
        self.blocks: list[bytes] = []
        self.size = 0
        self.uncompressed_size = 0

    def add_view(self, data: bytes, **details: Any) -> int:
        """Append bytes, aligned to 4; return the index of the new buffer view."""
        views: list[JsonObject] = self._tree.setdefault("bufferViews", [])
        views.append({"buffer": 0, "byteOffset": self._append(data), "byteLength": len(data), **details})
        return len(views) - 1

    def add_accessor(
        self, values: NDArray[Any], element_type: str, component_type: int, target: int, **details: Any
    ) -> int:
        """Append an array (rows padded to the alignment); return the accessor index.

        Parameters
        ----------
        values : (n, columns) array.
        element_type : accessor type, such as "VEC3".
        component_type : component type, such as 5126 for float.
        target : buffer view target: vertex attributes or indices.
        details : further properties of the accessor.
        """
        accessors: list[JsonObject] = self._tree.setdefault("accessors", [])
        accessors.append({
            "bufferView": self._add_rows_view(
                np.ascontiguousarray(values, values.dtype.newbyteorder("<")), target
            ),
            "componentType": component_type,
            "count": len(values),
            "type": element_type,
            **details,
        })  # fmt: skip
        return len(accessors) - 1

    def _add_rows_view(self, values: NDArray[Any], target: int) -> int:
        row = values[0].nbytes
        strides = {"byteStride": row} if target == VERTEX_TARGET and self.lattice is not None else {}
        if not self.uses_meshopt:
            return self.add_view(values.tobytes(), target=target, **strides)
        data, mode = compress_buffer(values, target)
        views: list[JsonObject] = self._tree.setdefault("bufferViews", [])
        views.append({
            "buffer": 1,
            "byteOffset": self.uncompressed_size,
            "byteLength": values.nbytes,
            "target": target,
            **strides,
            "extensions": {
                MESHOPT_COMPRESSION: {
                    "buffer": 0,
                    "byteOffset": self._append(data),
                    "byteLength": len(data),
                    "byteStride": row,
                    "count": len(values),
                    "mode": mode,
                }
            },
        })  # fmt: skip
        self.uncompressed_size += values.nbytes + -values.nbytes % 4
        return len(views) - 1

    def _append(self, data: bytes) -> int:
        at, padding = self.size, -len(data) % 4
        self.blocks += [data, bytes(padding)]
        self.size += len(data) + padding
        return at

    def describe(self, **details: Any) -> list[JsonObject]:
        """Return the entries of the file's "buffers" list."""
        buffers: list[JsonObject] = [{"byteLength": self.size, **details}]
        if self.uses_meshopt:
            buffers.append(
                {
                    "byteLength": self.uncompressed_size,
                    "extensions": {MESHOPT_COMPRESSION: {"fallback": True}},
                }
            )
        return buffers
