"""Tiles read back from their files as a viewer sees them."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_TYPES = {5123: np.dtype("<u2"), 5125: np.dtype("<u4"), 5126: np.dtype("<f4")}
_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


@dataclass
class Tile:
    """Tile of a tileset.

    Attributes
    ----------
    tree : entry of the tile in tileset.json.
    gltf : glTF description of its content.
    vertices : (n, 3) float32, in the tileset's frame, dequantised in single precision.
    colors : (n, 4) uint16, linear, or None.
    triangles : (m, 3) int64.
    uvs : (n, 2) uint16, texture coordinates from the upper left corner of the image, or None.
    image : encoded image file, or None.
    """

    tree: dict[str, Any]
    gltf: dict[str, Any]
    vertices: NDArray[np.float32]
    colors: NDArray[np.uint16] | None
    triangles: NDArray[np.int64]
    uvs: NDArray[np.uint16] | None = None
    image: bytes | None = None
    children: list[Tile] = field(default_factory=list)

    def all(self) -> Iterator[Tile]:
        """Iterate over this tile and all tiles below it."""
        yield self
        for child in self.children:
            yield from child.all()

    def leaves(self) -> Iterator[Tile]:
        """Iterate over the tiles without children, including this one."""
        return (tile for tile in self.all() if not tile.children)


def read_tiles(outdir: Path) -> Tile:
    """Read a tileset with all of its tiles."""
    tree = json.loads((outdir / "tileset.json").read_bytes())
    return _read_tile(outdir, tree["root"])


def _read_tile(outdir: Path, tree: dict[str, Any]) -> Tile:
    gltf, binary = read_glb_chunks((outdir / tree["content"]["uri"]).read_bytes())
    (mesh,) = gltf["meshes"]
    (primitive,) = mesh["primitives"]
    (node,) = gltf["nodes"]
    found = _read_accessor(gltf, binary, primitive["attributes"]["POSITION"]).astype(np.float32)
    scale, move = (
        np.array(node.get(name, [default] * 3), np.float32)
        for name, default in (("scale", 1), ("translation", 0))
    )
    x, y, z = (found * scale + move).T
    color, places = (primitive["attributes"].get(name) for name in ("COLOR_0", "TEXCOORD_0"))
    return Tile(
        tree,
        gltf,
        # Viewers convert y-up glTF to z-up.
        np.stack([x, -z, y], axis=1) + np.float32(0),
        None if color is None else _read_accessor(gltf, binary, color),
        _read_accessor(gltf, binary, primitive["indices"]).reshape(-1, 3).astype(np.int64),
        None if places is None else _read_accessor(gltf, binary, places),
        _read_image(gltf, binary),
        [_read_tile(outdir, child) for child in tree.get("children", [])],
    )


def _read_image(gltf: dict[str, Any], binary: bytes) -> bytes | None:
    """Get the encoded image of the only material."""
    (material,) = gltf["materials"]
    number = material["pbrMetallicRoughness"].get("baseColorTexture", {}).get("index")
    if number is None:
        return None
    texture = gltf["textures"][number]
    webp = texture.get("extensions", {}).get("EXT_texture_webp")
    image = gltf["images"][(texture if webp is None else webp)["source"]]
    view = gltf["bufferViews"][image["bufferView"]]
    assert "target" not in view
    assert "byteStride" not in view
    assert image["mimeType"] in ("image/jpeg", "image/webp", "image/png")
    assert (image["mimeType"] == "image/webp") is (webp is not None)
    return binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]


def read_glb_chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Split a valid GLB file into description and buffer."""
    magic, version, size, text_size, text_kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, size, text_kind) == (b"glTF", 2, len(data), b"JSON")
    assert text_size % 4 == 0
    size, kind = struct.unpack_from("<I4s", data, 20 + text_size)
    assert kind == b"BIN\0"
    assert 28 + text_size + size == len(data)
    gltf = json.loads(data[20 : 20 + text_size])
    assert gltf["buffers"] == [{"byteLength": size}]
    return gltf, data[28 + text_size :]


def _read_accessor(gltf: dict[str, Any], binary: bytes, number: int) -> NDArray[Any]:
    accessor = gltf["accessors"][number]
    view = gltf["bufferViews"][accessor["bufferView"]]
    kind, columns = _TYPES[accessor["componentType"]], _COLUMNS[accessor["type"]]
    stride = view.get("byteStride", kind.itemsize * columns)
    assert view["byteOffset"] % 4 == 0
    assert view["byteLength"] == stride * accessor["count"]
    assert stride % 4 == 0 or columns == 1
    values = np.array(
        np.ndarray((accessor["count"], columns), kind, binary, view["byteOffset"], (stride, kind.itemsize))
    )
    for name, bound in (("min", values.min(axis=0)), ("max", values.max(axis=0))):
        assert accessor.get(name, bound.tolist()) == bound.tolist()
    return values
