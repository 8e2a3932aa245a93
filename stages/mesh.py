"""The mesh that passes between stages."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.errors import MeshError

Vertices = NDArray[np.float64]
Triangles = NDArray[np.int32]
Colors = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Texture:
    """Texture coordinates and images of a mesh.

    Attributes
    ----------
    uvs : (m, 3, 2) float64, per corner; (0, 0) is the lower left corner of the image.
    material_ids : (m,) int32, which image each triangle takes its colours from; -1 for none.
    images : tuple of (h, w, 3) or (h, w, 4) uint8 arrays, RGB(A), top row first.
    """

    uvs: NDArray[np.float64]
    material_ids: NDArray[np.int32]
    images: tuple[NDArray[np.uint8], ...] = ()


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with optional colours, normals and texture. Immutable in spirit: functions return a new one.

    Attributes
    ----------
    vertices : (n, 3) float64, metres.
    triangles : (m, 3) int32, counter-clockwise seen from outside.
    colors : (n, 3) uint8 RGB, or None.
    normals : (n, 3) float64 unit vertex normals, or None.
    texture : see Texture, or None.
    """

    vertices: Vertices
    triangles: Triangles
    colors: Colors | None = None
    normals: NDArray[np.float64] | None = None
    texture: Texture | None = None
    # What a reader met on the way and a person should know: a missing image, polygons that were split.
    notes: tuple[str, ...] = field(default=())

    def with_(self, **changes: Any) -> Mesh:
        """Return the same mesh with some fields replaced."""
        return replace(self, **changes)


def validated(mesh: Mesh, where: str = "mesh") -> Mesh:
    """Check a mesh from outside, once, where it enters; arrays get the contract's types.

    Parameters
    ----------
    where : the file or argument the mesh came from; it starts every message.

    Raises
    ------
    MeshError
        For a wrong shape, a value that is not finite, an index out of range; it names the first offender.
    """
    vertices = _array(mesh.vertices, np.float64, (3,), "vertices", where)
    triangles = _indices(mesh.triangles, len(vertices), where)
    _require_finite(vertices, "vertex", where)
    colors = mesh.colors
    if colors is not None:
        colors = _array(colors, np.uint8, (3,), "colors", where)
        _require_count(colors, len(vertices), "colors", where)
    normals = mesh.normals
    if normals is not None:
        normals = _array(normals, np.float64, (3,), "normals", where)
        _require_count(normals, len(vertices), "normals", where)
    texture = None if mesh.texture is None else _texture(mesh.texture, len(triangles), where)
    return mesh.with_(vertices=vertices, triangles=triangles, colors=colors, normals=normals, texture=texture)


def _texture(texture: Texture, triangle_count: int, where: str) -> Texture:
    uvs = _array(texture.uvs, np.float64, (3, 2), "texture coordinates", where)
    material_ids = np.asarray(texture.material_ids)
    if len(uvs) != triangle_count or material_ids.shape != (triangle_count,):
        raise MeshError(
            f"there are {len(uvs)} × 3 texture coordinates and {material_ids.size} material indices "
            f"for {triangle_count} triangles.",
            where,
        )
    if ((material_ids < -1) | (material_ids >= len(texture.images))).any():
        raise MeshError(f"a material index is beyond the {len(texture.images)} texture images.", where)
    return Texture(uvs, material_ids.astype(np.int32), texture.images)


def _array(data: Any, dtype: Any, columns: tuple[int, ...], name: str, where: str) -> Any:
    array = np.asarray(data)
    if array.ndim != 1 + len(columns) or array.shape[1:] != columns:
        wanted = "n × " + " × ".join(map(str, columns))
        raise MeshError(f"{name} have shape {array.shape}; {wanted} is expected.", where)
    if dtype is np.uint8 and array.dtype != np.uint8:
        raise MeshError(f"{name} are {array.dtype}; 8-bit values (uint8) are expected.", where)
    if array.dtype.kind not in "iuf":
        raise MeshError(f"{name} are {array.dtype}; numbers are expected.", where)
    return np.ascontiguousarray(array, dtype=dtype)


def _indices(data: Any, vertex_count: int, where: str) -> Triangles:
    array = np.asarray(data)
    if array.size == 0:
        return np.zeros((0, 3), np.int32)
    if array.ndim != 2 or array.shape[1] != 3:
        raise MeshError(f"triangles have shape {array.shape}; m × 3 is expected.", where)
    if array.dtype.kind not in "iu":
        raise MeshError(f"triangles are {array.dtype}; whole numbers are expected.", where)
    if array.min() < 0 or array.max() >= vertex_count:
        bad = np.flatnonzero(((array < 0) | (array >= vertex_count)).any(axis=1))
        row = array[bad[0]].tolist()
        raise MeshError(
            f"triangle {bad[0]} uses vertices {row}, but there are only {vertex_count} "
            f"({len(bad)} such triangles); the file is damaged or cut short.",
            where,
        )
    return np.ascontiguousarray(array, dtype=np.int32)


def _require_finite(vertices: Vertices, name: str, where: str) -> None:
    if not np.isfinite(vertices).all():
        bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
        raise MeshError(
            f"{name} {bad[0]} is {vertices[bad[0]].tolist()}, not finite ({len(bad)} such); "
            "remove or repair these before processing.",
            where,
        )


def _require_count(array: NDArray[Any], count: int, name: str, where: str) -> None:
    if len(array) != count:
        raise MeshError(f"there are {len(array)} {name} for {count} vertices.", where)
