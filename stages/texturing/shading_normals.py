"""Shading normals of a mesh, with the normal maps of its materials."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import compute_triangle_normals
from scanloom.stages.surface.surface_color import sample_bilinear
from scanloom.stages.surface.texture import Image, Material
from scanloom.stages.surface.topology import compute_areas
from scanloom.stages.surface.vertex_normals import (
    compute_vertex_normals,
    interpolate_normals,
    normalize_vectors,
)
from scanloom.stages.surface.welding import find_first_equal_rows
from scanloom.stages.texturing.corner_groups import find_side_ends, group_corners
from scanloom.stages.texturing.material_classes import TexturePath, get_image, get_value, get_wrap
from scanloom.stages.texturing.tangent_frames import (
    compute_tangent_frames,
    decode_normals,
    get_corner_normals,
    interpolate_corners,
)

_Floats = NDArray[np.float32]

NORMAL_MAP: TexturePath = ("normalTexture",)
# Cosine of the angle (30°) between triangles above which their common side is smooth.
_MIN_SMOOTH_COSINE = 0.866


def has_normal_map(mesh: Mesh) -> bool:
    """Return True if a triangle has a material with a normal map."""
    return any(True for _ in _list_normal_maps(mesh))


def _list_normal_maps(mesh: Mesh) -> Iterator[tuple[int, Material, Image]]:
    """Yield index, material and image of the normal maps in use."""
    if mesh.texture is None:
        return
    for index in np.unique(mesh.texture.material_ids).tolist():
        material = mesh.texture.materials[index] if index >= 0 else Material()
        if (image := get_image(material, NORMAL_MAP)) is not None:
            yield index, material, image


class NormalMaps:
    """Normal maps of the materials of a mesh with texture coordinates."""

    def __init__(self, mesh: Mesh) -> None:
        assert mesh.texture is not None
        self._texture = mesh.texture
        self._has_uvs = mesh.texture.has_uvs()
        self._frames = compute_tangent_frames(mesh, mesh.texture.uvs)
        self._maps = [
            (index, image.pixels, get_wrap(material, NORMAL_MAP), _get_scale(material))
            for index, material, image in _list_normal_maps(mesh)
        ]

    def apply(self, normals: _Floats, triangles: NDArray[np.integer], weights: NDArray[np.floating]) -> None:
        """Replace the normals (k, 3) of points whose material has a normal map, in place."""
        material_ids = self._texture.material_ids.take(triangles)
        has_uvs = self._has_uvs.take(triangles)
        for index, pixels, wrap, scale in self._maps:
            (chosen,) = np.nonzero((material_ids == index) & has_uvs)
            of_triangles, shares = triangles[chosen], weights[chosen].astype(np.float64)
            uvs = np.einsum("kc,kcx->kx", shares, self._texture.uvs.take(of_triangles, axis=0))
            levels = sample_bilinear(pixels, uvs, wrap)
            normals[chosen] = decode_normals(levels, self._frames.interpolate(of_triangles, shares), scale)


def _get_scale(material: Material) -> float:
    return float(get_value(material.kept.tree, (*NORMAL_MAP, "scale"), 1.0))


class ShadingNormals:
    """Shading normals at points of a detailed mesh.

    The normals of the mesh count, else smooth normals with creases. Normal maps are applied.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh
        is_given = mesh.normals is not None or mesh.corner_normals is not None
        self._corner_normals = get_corner_normals(mesh).astype(np.float32) if is_given else None
        self._vertex_normals = compute_vertex_normals(mesh).astype(np.float32)
        self._triangle_normals = compute_triangle_normals(mesh).astype(np.float32)
        self._maps = NormalMaps(mesh) if has_normal_map(mesh) else None

    def __call__(self, triangles: NDArray[np.integer], weights: NDArray[np.floating]) -> _Floats:
        """Return unit normals (k, 3) at points, from triangles (k,) and barycentric weights (k, 3)."""
        shares = weights.astype(np.float32)
        if self._corner_normals is not None:
            normals = interpolate_corners(self._corner_normals, triangles, shares)
            lengths = np.sqrt(np.einsum("kx,kx->k", normals, normals))
            normals /= np.maximum(lengths, np.finfo(np.float32).tiny)[:, None]
        else:
            corners = self._mesh.triangles.take(triangles, axis=0)
            flat = self._triangle_normals.take(triangles, axis=0)
            normals = interpolate_normals(self._vertex_normals, corners, shares, flat)
        if self._maps is not None:
            self._maps.apply(normals, triangles, shares)
        return normals


def add_shading_normals(mesh: Mesh, uvs: NDArray[np.float64]) -> Mesh:
    """Return the mesh with normals for shading, computed if the mesh has none.

    Computed normals are smooth, except at creases along borders of charts. Vertices are split there anyway,
    so creases add no vertices, and inside of charts a normal map stays continuous. Each normal has a length,
    because glTF writes all normals or none.

    Parameters
    ----------
    uvs : (m, 3, 2) texture coordinates.
    """
    if mesh.normals is not None or mesh.corner_normals is not None:
        return mesh
    flat = compute_triangle_normals(mesh)
    columns = [mesh.triangles.reshape(-1), *uvs.reshape(-1, 2).astype(np.float32).T]
    wedges = find_first_equal_rows(columns)

    def is_smooth(one: NDArray[np.int64], other: NDArray[np.int64]) -> NDArray[np.bool_]:
        cosines = np.einsum("kx,kx->k", flat[one // 3], flat[other // 3])
        is_inside = wedges[one] == wedges[find_side_ends(other)]
        is_inside &= wedges[other] == wedges[find_side_ends(one)]
        return np.asarray((cosines > _MIN_SMOOTH_COSINE) | is_inside)

    groups = group_corners(mesh.triangles, is_smooth)
    weighted = np.repeat(flat * compute_areas(mesh.vertices, mesh.triangles)[:, None], 3, axis=0)
    sums = np.zeros((int(groups.max(initial=-1)) + 1, 3))
    for axis in range(3):
        sums[:, axis] = np.bincount(groups, weighted[:, axis])
    sums[(sums == 0).all(axis=1)] = (0, 0, 1)
    return mesh.with_(corner_normals=normalize_vectors(sums)[groups].reshape(-1, 3, 3))
