"""glTF container: JSON description, buffers and accessors, with all sizes and indices checked.

Source: Khronos Group, "glTF 2.0 specification", 2021 (ISO/IEC 12113:2022). Look-ups in a malformed
description raise KeyError, IndexError, TypeError or ValueError; `read_gltf` converts them to one InputError.
"""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_UNREADABLE
from scanloom.stages.files.documents import parse_short_integer
from scanloom.stages.files.input_files import read_input_bytes
from scanloom.stages.surface.codes import MESH_COMPANION_MISSING, MESH_COMPRESSION_UNKNOWN, MESH_FILE_DAMAGED
from scanloom.stages.surface.formats.texture_files import resolve_companion

JsonObject = dict[str, Any]

# Unsupported codec: no maintained package decodes Draco without a compiler.
UNSUPPORTED_COMPRESSIONS = ("KHR_draco_mesh_compression",)
MESHOPT_EXTENSIONS = ("EXT_meshopt_compression", "KHR_meshopt_compression")

# Key in `asset.extras` of the rotation (4, 4) from the y-up world to scan axes.
SCAN_FROM_WORLD = "scan_from_world"

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_DAMAGED_REMEDY = "it is damaged or cut short; get a whole copy of it."


@dataclass(frozen=True, eq=False)
class Gltf:
    """A parsed glTF file; every buffer has at least its declared size.

    Attributes
    ----------
    path : file, for messages.
    tree : the JSON description.
    buffers : bytes of each buffer; empty for a fallback buffer of compressed views.
    decompressed_views : decompressed buffer views by index.
    """

    path: Path
    tree: JsonObject
    buffers: list[bytes] = field(default_factory=list)
    decompressed_views: dict[int, bytes] = field(default_factory=dict)

    def get_list(self, name: str) -> list[Any]:
        """Return a top-level list of the description, such as "nodes"; empty if absent."""
        items = self.tree.get(name, [])
        if not isinstance(items, list):
            raise TypeError(name)
        return items

    def get_item(self, name: str, index: Any) -> JsonObject:
        """Return one entry of a top-level list."""
        if not isinstance(index, int) or index < 0:
            raise ValueError(name)
        entry = self.get_list(name)[index]
        if not isinstance(entry, dict):
            raise TypeError(name)
        return entry

    def read_view(self, index: Any) -> memoryview:
        """Return the bytes of a buffer view, decompressed."""
        view = self.get_item("bufferViews", index)
        packed = get_meshopt_properties(view)
        if packed is not None:
            if index not in self.decompressed_views:
                self.decompressed_views[index] = self._unpack(packed)
            return memoryview(self.decompressed_views[index])
        return self._slice_buffer(view)

    def _unpack(self, packed: JsonObject) -> bytes:
        """Decompress a buffer view from its EXT_meshopt_compression properties."""
        data = bytes(self._slice_buffer(packed))
        count, size = (
            require_non_negative_int(packed["count"]),
            require_non_negative_int(packed["byteStride"]),
        )
        try:
            if packed["mode"] == "ATTRIBUTES":
                return _kernels.decode_rows(data, count, size, str(packed.get("filter", "NONE")))
            return _kernels.decode_indices(data, count, size, str(packed["mode"]))
        except (ValueError, OverflowError) as error:
            raise InputError(
                MESH_FILE_DAMAGED,
                "has a buffer view that cannot be decompressed ({error}); {damaged}",
                self.path,
                error=error,
                damaged=_DAMAGED_REMEDY,
            ) from error

    def _slice_buffer(self, view: JsonObject) -> memoryview:
        """Return the stored bytes of a buffer view or of a compression extension."""
        buffer = self.buffers[require_non_negative_int(view["buffer"])]
        start, length = (
            require_non_negative_int(view.get("byteOffset", 0)),
            require_non_negative_int(view["byteLength"]),
        )
        if start + length > len(buffer):
            raise InputError(
                MESH_FILE_DAMAGED,
                "has a buffer view up to byte {start:,} in a buffer of {buffer_count:,} bytes; {damaged}",
                self.path,
                start=start + length,
                buffer_count=len(buffer),
                damaged=_DAMAGED_REMEDY,
            )
        return memoryview(buffer)[start : start + length]

    def read_accessor(self, index: Any) -> NDArray[Any]:
        """Return an accessor as (count, columns) in its type; normalized integers as float64."""
        accessor = self.get_item("accessors", index)
        dtype, columns = np.dtype(_TYPES[accessor["componentType"]]), _COLUMNS[accessor["type"]]
        count = require_non_negative_int(accessor["count"])
        if "bufferView" in accessor:
            elements = self._read_elements(accessor["bufferView"], accessor, dtype, columns, count)
        else:
            # An accessor without a view means zeros. The count is limited, because a short file can request
            # any amount.
            byte_count = sum(map(len, self.buffers))
            if count > byte_count:
                raise InputError(
                    MESH_FILE_DAMAGED,
                    "has an accessor of {count:,} elements for {held:,} bytes of data; {damaged}",
                    self.path,
                    count=count,
                    held=byte_count,
                    damaged=_DAMAGED_REMEDY,
                )
            elements = np.zeros((count, columns), dtype)
        if "sparse" in accessor:
            elements = self._apply_sparse(elements, accessor["sparse"])
        if accessor.get("normalized") and dtype.kind in "iu":
            return np.asarray(np.maximum(elements / np.iinfo(dtype).max, -1.0))
        return elements

    def _read_elements(
        self, view: Any, accessor: JsonObject, dtype: np.dtype[Any], columns: int, count: int
    ) -> NDArray[Any]:
        data = self.read_view(view)
        size = dtype.itemsize * columns
        stride = require_non_negative_int(self.get_item("bufferViews", view).get("byteStride", size))
        start = require_non_negative_int(accessor.get("byteOffset", 0))
        if count and (stride < size or start + (count - 1) * stride + size > len(data)):
            raise InputError(
                MESH_FILE_DAMAGED,
                "has an accessor of {count:,} elements, more than its {data_count:,} bytes hold; {damaged}",
                self.path,
                count=count,
                data_count=len(data),
                damaged=_DAMAGED_REMEDY,
            )
        if count == 0:
            return np.zeros((0, columns), dtype)
        shape, strides = (count, columns), (stride, dtype.itemsize)
        return np.array(np.ndarray(shape, dtype, data, start, strides))

    def _apply_sparse(self, elements: NDArray[Any], sparse: JsonObject) -> NDArray[Any]:
        count, sparse_indices, sparse_values = (
            require_non_negative_int(sparse["count"]),
            sparse["indices"],
            sparse["values"],
        )
        dtype = np.dtype(_TYPES[sparse_indices["componentType"]])
        rows = self._read_elements(sparse_indices["bufferView"], sparse_indices, dtype, 1, count)[:, 0]
        columns = elements.shape[1]
        elements[rows] = self._read_elements(
            sparse_values["bufferView"], sparse_values, elements.dtype, columns, count
        )
        return elements


def get_meshopt_properties(view: JsonObject) -> JsonObject | None:
    """Return the meshopt compression properties of a buffer view; None if uncompressed."""
    extensions = view.get("extensions", {})
    return next((extensions[name] for name in MESHOPT_EXTENSIONS if name in extensions), None)


def require_non_negative_int(value: Any) -> int:
    """Return the value if it is a non-negative integer.

    Raises
    ------
    ValueError
        For any other value.
    """
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ValueError(value)
    return value


def read_container(path: Path) -> Gltf:
    """Read a .glb or .gltf file with its buffers.

    Raises
    ------
    InputError
        If the file is not glTF 2.0, is compressed with Draco, or a buffer is missing or too short.
    """
    try:
        data = read_input_bytes(path)
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "cannot be read: {strerror}.", path, strerror=error.strerror
        ) from error
    text, binary = _split_glb_chunks(path, data) if path.suffix.lower() == ".glb" else (data, b"")
    try:
        tree = json.loads(text, parse_int=parse_short_integer)
        version = str(tree["asset"]["version"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(
            MESH_FILE_DAMAGED, "is not a valid glTF file: its JSON description cannot be parsed.", path
        ) from error
    if not version.startswith("2."):
        raise InputError(
            MESH_FILE_DAMAGED,
            "has glTF version {version!r}, which is not supported",
            path,
            remedy="write it again as glTF 2.0.",
            version=version[:20],
        )
    gltf = Gltf(path, tree)
    # Must come before the buffers are read: a fallback buffer without data is no damage.
    _require_uncompressed(gltf)
    for number, buffer in enumerate(gltf.get_list("buffers")):
        if any(
            buffer.get("extensions", {}).get(name, {}).get("fallback") for name in MESHOPT_EXTENSIONS
        ) and ("uri" not in buffer):
            gltf.buffers.append(b"")
            continue
        content = _read_buffer(path, buffer, binary if number == 0 else b"")
        promised = require_non_negative_int(buffer["byteLength"])
        if len(content) < promised:
            raise InputError(
                MESH_FILE_DAMAGED,
                "declares a buffer of {promised:,} bytes, but only {content_count:,} exist; {damaged}",
                path,
                promised=promised,
                content_count=len(content),
                damaged=_DAMAGED_REMEDY,
            )
        gltf.buffers.append(content)
    return gltf


def _require_uncompressed(gltf: Gltf) -> None:
    for name in gltf.get_list("extensionsRequired"):
        if name in UNSUPPORTED_COMPRESSIONS:
            raise InputError(
                MESH_COMPRESSION_UNKNOWN,
                "is compressed with {name}, which is not supported",
                gltf.path,
                remedy="write it again without compression (in Blender, turn Compression off on export).",
                name=name,
            )


def _split_glb_chunks(path: Path, data: bytes) -> tuple[bytes, bytes]:
    """Return the JSON and the binary chunk of a GLB file."""
    if data[:4] != b"glTF":
        raise InputError(MESH_FILE_DAMAGED, "is not a valid glTF file: it does not start with `glTF`.", path)
    if data[4:8] != b"\2\0\0\0":
        raise InputError(
            MESH_FILE_DAMAGED,
            "is not a valid glTF file of version 2",
            path,
            remedy="write it again as glTF 2.0.",
        )
    chunks: dict[int, bytes] = {}
    at = 12
    while at + 8 <= len(data):
        length, kind = np.frombuffer(data, "<u4", 2, at).tolist()
        if at + 8 + length > len(data):
            raise InputError(
                MESH_FILE_DAMAGED, "is not a valid glTF file: {damaged}", path, damaged=_DAMAGED_REMEDY
            )
        chunks.setdefault(kind, data[at + 8 : at + 8 + length])
        at += 8 + length
    return chunks.get(_JSON, b""), chunks.get(_BIN, b"")


def _read_buffer(path: Path, buffer: JsonObject, binary: bytes) -> bytes:
    uri = buffer.get("uri")
    if uri is None:
        return binary
    if (embedded := decode_data_uri(uri)) is not None:
        return embedded
    name = unquote(uri)
    try:
        return read_input_bytes(resolve_companion(path.parent, name))
    except (OSError, ValueError) as error:
        raise InputError(
            MESH_COMPANION_MISSING, "refers to the file {name}, which is missing.", path, name=name[:200]
        ) from error


def decode_data_uri(uri: str) -> bytes | None:
    """Decode a data URI; None if the URI is a file name."""
    if not uri.startswith("data:"):
        return None
    kind, _, content = uri.partition(",")
    return base64.b64decode(content) if kind.endswith(";base64") else unquote(content).encode("latin-1")
