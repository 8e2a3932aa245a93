"""Detection of a glTF file's compression, to write another file the same way."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from scanloom.stages.exporting.export import GLTF_SUFFIXES, ExportParams
from scanloom.stages.files.input_files import read_input_bytes
from scanloom.stages.surface.formats.gltf_container import (
    MESHOPT_EXTENSIONS,
    Gltf,
    JsonObject,
    read_container,
)
from scanloom.stages.surface.formats.gltf_packing import MAX_STEPS, MESH_QUANTIZATION, make_quantization_grid
from scanloom.stages.surface.mesh import Mesh

_UNSIGNED_BYTE, _UNSIGNED_SHORT, _FLOAT = 5121, 5123, 5126
_MIN_BITS = 8
_TEXTURE_TRANSFORM = "KHR_texture_transform"
# Coordinates are rounded by at most an eighth of a texel, which is not visible.
_STEPS_PER_TEXEL = 4


def detect_packing(path: Path, mesh: Mesh) -> ExportParams:
    """Return export parameters that reproduce the compression of a glTF file.

    Positions are quantized no more coarsely than in that file, if 16 bits suffice.

    Parameters
    ----------
    path : mesh file. Other formats than glTF yield the defaults, without compression.
    mesh : mesh that was read from the file.
    """
    if path.suffix.lower() not in GLTF_SUFFIXES:
        return ExportParams()
    gltf = read_container(path)
    used = set(gltf.get_list("extensionsUsed"))
    positions = [
        gltf.get_item("accessors", primitive["attributes"]["POSITION"])
        for mesh in gltf.get_list("meshes")
        for primitive in mesh["primitives"]
        if "POSITION" in primitive["attributes"]
    ]
    is_quantized = MESH_QUANTIZATION in used and any(one["componentType"] != _FLOAT for one in positions)
    if not used.intersection(MESHOPT_EXTENSIONS) and not is_quantized:
        return ExportParams()
    steps = max((_count_steps(one) for one in positions), default=MAX_STEPS)
    size = float(np.ptp(mesh.vertices, axis=0).max(initial=0.0))
    return ExportParams(
        compress="meshopt" if used.intersection(MESHOPT_EXTENSIONS) else "quantize",
        position_bits=next(
            (
                bits
                for bits in range(_MIN_BITS, 16)
                if make_quantization_grid(mesh.vertices, bits).step * steps <= size
            ),
            16,
        ),
        texel_steps=_STEPS_PER_TEXEL if _TEXTURE_TRANSFORM in used else 0,
    )


def _count_steps(accessor: JsonObject) -> int:
    """Return the quantization steps along the longest side of a position accessor."""
    is_count = accessor["componentType"] in (_UNSIGNED_BYTE, _UNSIGNED_SHORT)
    if not is_count or accessor.get("normalized") or "max" not in accessor:
        return MAX_STEPS
    steps: int = max(map(int, accessor["max"]))
    return steps


def measure_stored_bytes(path: Path, mesh: Mesh) -> int:
    """Return the size in bytes of a mesh file including its buffers and images.

    Parameters
    ----------
    mesh : mesh that was read from the file.
    """
    suffix = path.suffix.lower()
    size = path.stat().st_size
    if suffix == ".gltf":
        return size + sum(file.stat().st_size for file in _find_companion_files(path) if file.is_file())
    if suffix == ".glb" or mesh.texture is None:
        return size
    return size + sum(len(image.file_bytes) for image in mesh.texture.images)


def _find_companion_files(path: Path) -> Iterator[Path]:
    """Yield each external file that a .gltf file references, once."""
    gltf = Gltf(path, json.loads(read_input_bytes(path)))
    entries: list[Any] = [*gltf.get_list("buffers"), *gltf.get_list("images")]
    for name in dict.fromkeys(entry["uri"] for entry in entries if "uri" in entry):
        if not name.startswith("data:"):
            yield path.parent / unquote(name)
