"""Surface colour at arbitrary surface points, from the texture or from vertex colours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.surface.formats.colors import linear_from_srgb, srgb_from_linear
from scanloom.stages.surface.formats.gltf_materials import multiplies_colors
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import Material, Pixels

_Floats = NDArray[np.floating]

# 8-bit grey level of surface parts without any colour.
_UNCOLORED = 128.0


def has_color(mesh: Mesh) -> bool:
    """Return True if the mesh has vertex colours or a coloured material in use."""
    return mesh.colors is not None or is_textured(mesh)


def attributes_of(mesh: Mesh) -> NDArray[np.uint8]:
    """Return the vertex colours (n, 3), or an (n, 0) array without colours.

    Kernels take this array as the vertex attributes.
    """
    return np.zeros((len(mesh.vertices), 0), np.uint8) if mesh.colors is None else mesh.colors


def is_textured(mesh: Mesh) -> bool:
    """Return True if any triangle takes its colour from a material."""
    if mesh.texture is None:
        return False
    tells = [material.image is not None or material.base_color is not None for material in _materials(mesh)]
    # The last entry is addressed by -1, the material id of triangles without a material.
    return bool(np.array([*tells, False])[mesh.texture.material_ids].any())


def is_transparent(mesh: Mesh) -> bool:
    """Return True if an image of the mesh has transparent pixels (alpha below 255)."""
    images = [pixels_of(material) for material in _materials(mesh)]
    return any(image is not None and image.shape[2] == 4 and image[..., 3].min() < 255 for image in images)


def color_at(mesh: Mesh, triangles: NDArray[np.integer], weights: _Floats) -> _Floats:
    """Compute the colour at points on the surface.

    The first available source counts: the material's image times its base colour, vertex colours, the base
    colour alone, grey. In glTF files the vertex colours also multiply the image. An image that cannot be
    decoded is ignored. Images are sampled bilinearly, vertex colours are interpolated linearly.

    Parameters
    ----------
    mesh : mesh with any combination of these sources.
    triangles : (k,) triangle index of each point.
    weights : (k, 3) barycentric weights of the triangle's corners, float32 or float64.

    Returns
    -------
    (k, 3) RGB in 8-bit levels, floating point, in the precision of the weights.
    """
    if mesh.colors is None:
        colors = np.full((len(triangles), 3), _UNCOLORED, weights.dtype)
    else:
        colors = _interpolated(mesh.colors, mesh.triangles.take(triangles, axis=0), weights)
    if mesh.texture is None or not mesh.texture.materials:
        return colors
    material_of = mesh.texture.material_ids.take(triangles)
    has_uvs = mesh.texture.has_uvs().take(triangles)
    for number, material in enumerate(_materials(mesh)):
        pixels = pixels_of(material)
        is_its = material_of == number
        if pixels is not None:
            (chosen,) = np.nonzero(is_its & has_uvs)
            corners = mesh.texture.uvs.take(triangles[chosen], axis=0)
            # float32 would resolve only a few hundredths of a texel in a large image.
            uvs = np.einsum("kc,kcx->kx", np.asarray(weights[chosen], np.float64), corners)
            shown = tinted(sampled(pixels, uvs, material.wrap), material)
            if mesh.colors is not None and multiplies_colors(material):
                light = linear_from_srgb(shown / 255) * linear_from_srgb(colors[chosen] / 255)
                shown = 255 * srgb_from_linear(light)
            colors[chosen] = shown
            is_its &= ~has_uvs
        if mesh.colors is None and material.base_color is not None:
            colors[is_its] = np.array(material.base_color[:3]) * 255
    return colors


def sampled(image: Pixels, uvs: NDArray[np.float64], wrap: tuple[str, str] = ("repeat", "repeat")) -> _Floats:
    """Sample an image (h, w, 3 or 4) bilinearly at texture coordinates (k, 2).

    (0, 0) is the lower left corner of the image.

    Returns
    -------
    (k, 3) float32 RGB in 8-bit levels.
    """
    height, width = image.shape[:2]
    columns, right_share = _around(uvs[:, 0], width, wrap[0])
    rows, lower_share = _around(1 - uvs[:, 1], height, wrap[1])
    lines = []
    for row in rows:
        first, second = (image[row, column, :3].astype(np.float32) for column in columns)
        lines.append(first + (second - first) * right_share)
    return np.asarray(lines[0] + (lines[1] - lines[0]) * lower_share)


def tinted(colors: _Floats, material: Material) -> _Floats:
    """Multiply colours (k, 3) by a material's base colour in linear light.

    Input and output are sRGB in 8-bit levels.
    """
    if material.base_color is None or min(material.base_color[:3]) >= 1:
        return colors
    tint = linear_from_srgb(np.array(material.base_color[:3]))
    return np.asarray(255 * srgb_from_linear(linear_from_srgb(colors / 255) * tint))


def pixels_of(material: Material) -> Pixels | None:
    """Return the pixels of a material's image.

    The result is None without an image, or if it cannot be decoded.
    """
    if material.image is None:
        return None
    try:
        return material.image.pixels
    except MeshError:
        return None


def _around(
    at: NDArray[np.float64], count: int, way: str
) -> tuple[tuple[NDArray[np.int64], NDArray[np.int64]], _Floats]:
    """Return both neighbouring texel indices of image coordinates, and the second's weight (k, 1).

    The coordinates (k,) are in units of the image size; `way` is the wrap mode.
    """
    period = 2 if way == "mirror" else 1
    # Wrap first, because coordinates can be huge and would overflow. Texel centres are at half integers.
    place = (at.clip(-1, 2) if way == "clamp" else at % period) * count - 0.5
    first = np.floor(place).astype(np.int64)
    texels = []
    for index in (first, first + 1):
        if way == "clamp":
            texels.append(index.clip(0, count - 1))
        else:
            index %= period * count
            texels.append(np.minimum(index, 2 * count - 1 - index) if way == "mirror" else index)
    return (texels[0], texels[1]), (place - np.floor(place)).astype(np.float32)[:, None]


def _materials(mesh: Mesh) -> tuple[Material, ...]:
    return () if mesh.texture is None else mesh.texture.materials


def _interpolated(values: NDArray[np.uint8], corners: NDArray[np.int32], weights: _Floats) -> _Floats:
    # One corner at a time is three times as fast as all three at once.
    colors: _Floats = values.take(corners[:, 0], axis=0) * weights[:, :1]
    for i in (1, 2):
        colors += values.take(corners[:, i], axis=0) * weights[:, i : i + 1]
    return colors
