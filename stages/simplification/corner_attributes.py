"""Conversion between meshes with corner attributes and kernel arrays.

`make_kernel_input` is the counterpart for meshes whose only attribute is vertex colours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh

Floats = NDArray[np.float64]
Ids = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class SimplifiedCorners:
    """Kernel result: a simplified mesh with corner attributes.

    Attributes
    ----------
    positions : (p, 3) float64, vertex positions in metres, relative to `CornerAttributes.origin`.
    triangles : (q, 3) int32.
    corners : (3 q, k) float64, corner attributes, in the columns of `CornerAttributes.columns`.
    corner_source : (3 q,) int32, input corner with bit-identical attributes; −1 for none.
    vertex_source, triangle_source : (p,) and (q,) int32, indices into the input.
    """

    positions: Floats
    triangles: Ids
    corners: Floats
    corner_source: Ids
    vertex_source: Ids
    triangle_source: Ids


@dataclass(frozen=True, eq=False)
class CornerAttributes:
    """Vertex positions and scaled corner attributes of a mesh.

    Attributes
    ----------
    origin : (3,) float64, metres; subtracted from positions that kernels see.
    positions : (n, 3) float64, metres; equal for vertices that were joined.
    columns : (3 m, k) float64, metres, per corner: texture coordinates (2 columns, zeros without any), and if
        present colours (3) and normals (3).
    uv_scale, color_scale, normal_scale : metres per image side, per level, and per unit of normal length.
    has_uvs, has_colors, has_normals : attributes that the mesh has.
    """

    origin: Floats
    positions: Floats
    columns: Floats
    uv_scale: float
    color_scale: float
    normal_scale: float
    has_uvs: bool
    has_colors: bool
    has_normals: bool

    def split(self, corners: Floats) -> tuple[Floats | None, Floats | None, Floats | None]:
        """Split scaled attributes into texture coordinates, colours and normals, unscaled."""
        uvs = corners[:, :2] / self.uv_scale if self.has_uvs else None
        others = corners[:, 2:]
        colors = others[:, :3] / self.color_scale if self.has_colors else None
        normals = others[:, -3:] / self.normal_scale if self.has_normals else None
        return uvs, colors, normals

    def to_mesh(self, mesh: Mesh, simplified: SimplifiedCorners) -> tuple[Mesh, Ids]:
        """Build the simplified mesh, and map its vertices to the input.

        Unchanged values are bit-identical to the input. A vertex whose corners differ in colour is
        duplicated.

        Parameters
        ----------
        mesh : the input.
        simplified : kernel result.
        """
        uvs, colors, normals = self.split(simplified.corners)
        kept = simplified.corner_source >= 0
        source = simplified.corner_source[kept]
        if uvs is not None and mesh.texture is not None:
            uvs[kept] = mesh.texture.uvs.reshape(-1, 2)[source]
            uvs = uvs.reshape(-1, 3, 2)
        own, triangles = _merge_coincident(simplified)
        vertex_source, places, levels = simplified.vertex_source[own], simplified.positions[own], None
        before = self.positions[vertex_source]
        moved = (places != before - self.origin).any(axis=1, keepdims=True)
        vertices = np.where(moved, places + self.origin, before)
        if colors is not None and mesh.colors is not None:
            levels = np.rint(colors).clip(0, 255).astype(np.uint8)
            levels[kept] = mesh.colors[mesh.triangles.reshape(-1)[source]]
            own, triangles, levels = _split_by_color(triangles, levels)
            vertices, vertex_source = vertices[own], vertex_source[own]
        base = mesh.with_(vertices=vertices, colors=levels, normals=None)
        result = base.with_triangles(triangles, simplified.triangle_source, uvs=uvs)
        return (result if normals is None else _set_normals(result, normals)), vertex_source


def has_corner_attributes(mesh: Mesh) -> bool:
    """Return True if a mesh has materials, texture, parts or corner normals."""
    texture = mesh.texture
    has_texture = texture is not None and ((texture.material_ids >= 0).any() or texture.has_uvs().any())
    has_parts = mesh.part_ids is not None and len(np.unique(mesh.part_ids)) > 1
    return bool(has_texture or has_parts or mesh.corner_normals is not None)


def _merge_coincident(simplified: SimplifiedCorners) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Merge coincident vertices that came from one input vertex.

    The kernel gives each touching sheet a separate vertex.

    Returns
    -------
    own : representative of each merged vertex.
    triangles : (q, 3) int32, indices of merged vertices.
    """
    _, first, inverse = np.unique(simplified.vertex_source, return_index=True, return_inverse=True)
    same = first[inverse.reshape(-1)]
    is_there = (simplified.positions == simplified.positions[same]).all(axis=1)
    own, number = np.unique(np.where(is_there, same, np.arange(len(same))), return_inverse=True)
    return own, number.reshape(-1).astype(np.int32)[simplified.triangles]


def _split_by_color(
    triangles: NDArray[np.int32], levels: NDArray[np.uint8]
) -> tuple[NDArray[Any], NDArray[np.int32], NDArray[np.uint8]]:
    """Duplicate the vertices whose corners differ in colour.

    Returns
    -------
    source : previous vertex of each vertex.
    triangles : (q, 3) int32.
    colors : uint8, colour of each vertex.
    """
    red, green, blue = levels.astype(np.int64).T
    corners = triangles.reshape(-1).astype(np.int64)
    packed = corners << 24 | red << 16 | green << 8 | blue
    key, first, inverse = np.unique(packed, return_index=True, return_inverse=True)
    return key >> 24, inverse.reshape(-1, 3).astype(np.int32), levels[first]


def _set_normals(mesh: Mesh, normals: Floats) -> Mesh:
    """Set corner normals, or vertex normals if all corners agree."""
    with np.errstate(over="ignore"):  # A normal with infinite length becomes zero.
        length = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    corners = mesh.triangles.reshape(-1)
    of_vertex = np.zeros((len(mesh.vertices), 3))
    of_vertex[corners] = unit
    if np.allclose(of_vertex[corners], unit, atol=1e-9):
        return mesh.with_(normals=of_vertex, corner_normals=None)
    return mesh.with_(normals=None, corner_normals=unit.reshape(-1, 3, 3))
