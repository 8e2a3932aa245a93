"""Binary buffer of a glTF file under construction, with its buffer views and accessors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.formats.gltf_container import Tree
from scanloom.stages.surface.formats.gltf_packing import PACKED, VERTICES, Lattice, packed


class Buffer:
    """Growing binary buffer that records buffer views and accessors in the glTF tree.

    Views compressed by meshoptimizer refer to a second, fallback buffer that has a size but no data
    (EXT_meshopt_compression).

    Attributes
    ----------
    lattice : quantization of positions; None for single-precision positions.
    texel_steps : quantization steps of texture coordinates per texel; 0 for the full 16-bit range.
    pack : True to compress views with meshoptimizer.
    """

    def __init__(self, tree: Tree, lattice: Lattice | None, texel_steps: int = 0, *, pack: bool) -> None:
        self._tree = tree
        self.lattice = lattice
        self.texel_steps = texel_steps
        self.pack = pack
        self.pieces: list[bytes] = []
        self.size = 0
        self.plain_size = 0

    def view(self, data: bytes, **details: Any) -> int:
        """Append bytes, aligned to 4; return the index of the new buffer view."""
        views: list[Tree] = self._tree.setdefault("bufferViews", [])
        views.append({"buffer": 0, "byteOffset": self._append(data), "byteLength": len(data), **details})
        return len(views) - 1

    def accessor(self, values: NDArray[Any], kind: str, code: int, target: int, **details: Any) -> int:
        """Append an array (rows padded to the alignment); return the accessor index.

        Parameters
        ----------
        values : (n, columns) array.
        kind : accessor type, such as "VEC3".
        code : component type, such as 5126 for float.
        target : buffer view target: vertex attributes or indices.
        details : further properties of the accessor.
        """
        accessors: list[Tree] = self._tree.setdefault("accessors", [])
        accessors.append({
            "bufferView": self._rows(np.ascontiguousarray(values, values.dtype.newbyteorder("<")), target),
            "componentType": code,
            "count": len(values),
            "type": kind,
            **details,
        })  # fmt: skip
        return len(accessors) - 1

    def _rows(self, values: NDArray[Any], target: int) -> int:
        row = values[0].nbytes
        strides = {"byteStride": row} if target == VERTICES and self.lattice is not None else {}
        if not self.pack:
            return self.view(values.tobytes(), target=target, **strides)
        data, mode = packed(values, target)
        views: list[Tree] = self._tree.setdefault("bufferViews", [])
        views.append({
            "buffer": 1,
            "byteOffset": self.plain_size,
            "byteLength": values.nbytes,
            "target": target,
            **strides,
            "extensions": {
                PACKED: {
                    "buffer": 0,
                    "byteOffset": self._append(data),
                    "byteLength": len(data),
                    "byteStride": row,
                    "count": len(values),
                    "mode": mode,
                }
            },
        })  # fmt: skip
        self.plain_size += values.nbytes + -values.nbytes % 4
        return len(views) - 1

    def _append(self, data: bytes) -> int:
        at, padding = self.size, -len(data) % 4
        self.pieces += [data, bytes(padding)]
        self.size += len(data) + padding
        return at

    def described(self, **details: Any) -> list[Tree]:
        """Return the entries of the file's "buffers" list."""
        buffers: list[Tree] = [{"byteLength": self.size, **details}]
        if self.pack:
            buffers.append({"byteLength": self.plain_size, "extensions": {PACKED: {"fallback": True}}})
        return buffers
