"""A mesh whose corners have attributes of their own as kernels take it, and their results as meshes again.

Beside `kernel_input`, where colours belong to vertices and everything else stays behind.
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
class LightCorners:
    """What is left of a mesh, with the attributes of its corners.

    Attributes
    ----------
    places : (p, 3) float64, metres, from the origin of the attributes.
    triangles : (q, 3) int32.
    corners : (3 q, k) float64, as the columns of the attributes.
    corner_source : (3 q,) int32, the corner of the input with the same attributes to the bit; −1 for none.
    vertex_source, triangle_source : (p,) and (q,) int32.
    """

    places: Floats
    triangles: Ids
    corners: Floats
    corner_source: Ids
    vertex_source: Ids
    triangle_source: Ids


@dataclass(frozen=True, eq=False)
class CornerAttributes:
    """Where vertices are, and what corners carry.

    Attributes
    ----------
    origin : (3,) float64, metres; places count from there.
    positions : (n, 3) float64, metres, of the vertices, equal for those that are one.
    columns : (3 m, k) float64, metres: texture coordinates (2, zeros if there are none), colours (3) and
        normals (3) of each corner, if they are there.
    uv_scale, color_scale, normal_scale : metres for the image's side, a level, and a length of 1.
    has_uvs, has_colors, has_normals : which of them are there.
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
        """Return texture coordinates, colours and normals of rows like those of `columns`, in their units."""
        uvs = corners[:, :2] / self.uv_scale if self.has_uvs else None
        others = corners[:, 2:]
        colors = others[:, :3] / self.color_scale if self.has_colors else None
        normals = others[:, -3:] / self.normal_scale if self.has_normals else None
        return uvs, colors, normals

    def as_mesh(self, mesh: Mesh, left: LightCorners) -> tuple[Mesh, Ids]:
        """Return what `mesh` has become, and the vertex of it that each vertex was.

        What has not changed has its value to the bit. A vertex whose corners differ in colour is doubled.
        """
        uvs, colors, normals = self.split(left.corners)
        kept = left.corner_source >= 0
        source = left.corner_source[kept]
        if uvs is not None and mesh.texture is not None:
            uvs[kept] = mesh.texture.uvs.reshape(-1, 2)[source]
            uvs = uvs.reshape(-1, 3, 2)
        own, triangles = _shared(left)
        vertex_source, places, levels = left.vertex_source[own], left.places[own], None
        before = self.positions[vertex_source]
        moved = (places != before - self.origin).any(axis=1, keepdims=True)
        vertices = np.where(moved, places + self.origin, before)
        if colors is not None and mesh.colors is not None:
            levels = np.rint(colors).clip(0, 255).astype(np.uint8)
            levels[kept] = mesh.colors[mesh.triangles.reshape(-1)[source]]
            own, triangles, levels = _one_color_each(triangles, levels)
            vertices, vertex_source = vertices[own], vertex_source[own]
        base = mesh.with_(vertices=vertices, colors=levels, normals=None)
        light = base.with_triangles(triangles, left.triangle_source, uvs=uvs)
        return (light if normals is None else _with_normals(light, normals)), vertex_source


def is_in_pieces(mesh: Mesh) -> bool:
    """Return whether corners and triangles carry anything: image, materials, parts, normals of corners."""
    texture = mesh.texture
    has_texture = texture is not None and ((texture.material_ids >= 0).any() or texture.has_uvs().any())
    has_parts = mesh.part_ids is not None and len(np.unique(mesh.part_ids)) > 1
    return bool(has_texture or has_parts or mesh.corner_normals is not None)


def _shared(left: LightCorners) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Return which vertices there are, and the triangles between them.

    Where sheets touch without being joined, each has a vertex of its own; they share it if the input's did.
    """
    _, first, inverse = np.unique(left.vertex_source, return_index=True, return_inverse=True)
    same = first[inverse.reshape(-1)]
    is_there = (left.places == left.places[same]).all(axis=1)
    own, number = np.unique(np.where(is_there, same, np.arange(len(same))), return_inverse=True)
    return own, number.reshape(-1).astype(np.int32)[left.triangles]


def _one_color_each(
    triangles: NDArray[np.int32], levels: NDArray[np.uint8]
) -> tuple[NDArray[Any], NDArray[np.int32], NDArray[np.uint8]]:
    """Double the vertices whose corners differ in colour: return which each was, triangles and colours."""
    red, green, blue = levels.astype(np.int64).T
    corners = triangles.reshape(-1).astype(np.int64)
    packed = corners << 24 | red << 16 | green << 8 | blue
    key, first, inverse = np.unique(packed, return_index=True, return_inverse=True)
    return key >> 24, inverse.reshape(-1, 3).astype(np.int32), levels[first]


def _with_normals(mesh: Mesh, normals: Floats) -> Mesh:
    """Give corners their normals, and vertices where all corners of one agree."""
    with np.errstate(over="ignore"):  # One that somebody made endless is none.
        length = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    corners = mesh.triangles.reshape(-1)
    of_vertex = np.zeros((len(mesh.vertices), 3))
    of_vertex[corners] = unit
    if np.allclose(of_vertex[corners], unit, atol=1e-9):
        return mesh.with_(normals=of_vertex, corner_normals=None)
    return mesh.with_(normals=None, corner_normals=unit.reshape(-1, 3, 3))
