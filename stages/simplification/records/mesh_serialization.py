"""Serialisation of meshes to named arrays and JSON values, and back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.simplification.records.archive import Arrays
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import WRAP_MODES, Image, Material, Texture


def serialize_mesh(mesh: Mesh) -> tuple[Arrays, dict[str, Any]]:
    """Convert a mesh to named arrays and JSON metadata.

    Diagnostics are not stored, nor are format-specific extensions of materials.
    """
    arrays: dict[str, NDArray[Any] | None] = {
        "vertices": mesh.vertices,
        "triangles": mesh.triangles,
        "colors": mesh.colors,
        "normals": mesh.normals,
        "corner_normals": mesh.corner_normals,
        "part_ids": mesh.part_ids,
    }
    metadata: dict[str, Any] = {"part_names": mesh.part_names}
    if mesh.up is not None:
        metadata["up"] = mesh.up
    if mesh.intensity_max is not None:
        metadata["intensity_max"] = mesh.intensity_max
    texture = mesh.texture
    if texture is not None:
        number = {id(image): i for i, image in enumerate(texture.images)}
        arrays |= {"uvs": texture.uvs, "material_ids": texture.material_ids}
        arrays |= {
            f"image_{i}": np.frombuffer(im.file_bytes, np.uint8) for i, im in enumerate(texture.images)
        }
        metadata["images"] = [image.name for image in texture.images]
        metadata["materials"] = [
            [m.name, None if m.image is None else number[id(m.image)], m.base_color, m.wrap]
            for m in texture.materials
        ]
    return {name: array for name, array in arrays.items() if array is not None}, metadata


def deserialize_mesh(arrays: Arrays, metadata: dict[str, Any]) -> Mesh:
    """Build the mesh that `serialize_mesh` converted.

    The caller must run `validated` on the result.

    Raises
    ------
    ValueError, KeyError, IndexError, TypeError, OverflowError
        For arrays or metadata that `serialize_mesh` cannot produce.
    """
    texture = None
    if "uvs" in arrays:
        images = [
            Image(str(name), _extract_bytes(arrays[f"image_{i}"]))
            for i, name in enumerate(metadata.get("images", ()))
        ]
        materials = tuple(_build_material(images, *of_one) for of_one in metadata.get("materials", ()))
        texture = Texture(arrays["uvs"], arrays["material_ids"], materials)
    return Mesh(
        arrays["vertices"],
        arrays["triangles"],
        arrays.get("colors"),
        arrays.get("normals"),
        texture,
        arrays.get("corner_normals"),
        arrays.get("part_ids"),
        tuple(map(str, metadata.get("part_names", ()))),
        up=_parse_direction(metadata["up"]) if "up" in metadata else None,
        intensity_max=float(metadata["intensity_max"]) if "intensity_max" in metadata else None,
    )


def _parse_direction(given: Any) -> tuple[float, float, float]:
    x, y, z = map(float, given)
    return x, y, z


def _extract_bytes(array: NDArray[Any]) -> bytes:
    if array.dtype != np.uint8:
        raise ValueError(f"an image has type {array.dtype} instead of uint8")
    return array.tobytes()


def _build_material(images: list[Image], name: Any, image: int | None, color: Any, wrap: Any) -> Material:
    if not set(wrap) <= set(WRAP_MODES):
        raise ValueError(f"unknown texture wrap mode {wrap}")
    if color is not None:
        red, green, blue, alpha = map(float, color)
        color = red, green, blue, alpha
    along_u, along_v = wrap
    return Material(str(name), None if image is None else images[image], color, (along_u, along_v))
