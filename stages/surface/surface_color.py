"""Surface colour at arbitrary surface points, from the texture or from vertex colours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.surface.formats.color_conversion import convert_linear_to_srgb, convert_srgb_to_linear
from scanloom.stages.surface.formats.gltf_materials import multiplies_colors
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import Material, Pixels

_Floats = NDArray[np.floating]

# 8-bit grey level of surface parts without any colour.
_DEFAULT_GREY = 128.0


def has_color(mesh: Mesh) -> bool:
    """Return True if the mesh has vertex colours or a coloured material in use."""
    return mesh.colors is not None or is_textured(mesh)


def get_vertex_attributes(mesh: Mesh) -> NDArray[np.uint8]:
    """Return the vertex colours (n, 3), or an (n, 0) array without colours.

    Kernels take this array as the vertex attributes.
    """
    return np.zeros((len(mesh.vertices), 0), np.uint8) if mesh.colors is None else mesh.colors


def is_textured(mesh: Mesh) -> bool:
    """Return True if any triangle takes its colour from a material."""
    if mesh.texture is None:
        return False
    has_material_color = [
        material.image is not None or material.base_color is not None for material in _get_materials(mesh)
    ]
    # The last entry is addressed by -1, the material id of triangles without a material.
    return bool(np.array([*has_material_color, False])[mesh.texture.material_ids].any())


def is_transparent(mesh: Mesh) -> bool:
    """Return True if an image of the mesh has transparent pixels (alpha below 255)."""
    images = [decode_material_image(material) for material in _get_materials(mesh)]
    return any(image is not None and image.shape[2] == 4 and image[..., 3].min() < 255 for image in images)


def compute_surface_colors(mesh: Mesh, triangles: NDArray[np.integer], weights: _Floats) -> _Floats:
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
        colors = np.full((len(triangles), 3), _DEFAULT_GREY, weights.dtype)
    else:
        colors = _interpolate_colors(mesh.colors, mesh.triangles.take(triangles, axis=0), weights)
    if mesh.texture is None or not mesh.texture.materials:
        return colors
    material_of = mesh.texture.material_ids.take(triangles)
    has_uvs = mesh.texture.has_uvs().take(triangles)
    for material_index, material in enumerate(_get_materials(mesh)):
        pixels = decode_material_image(material)
        has_material = material_of == material_index
        if pixels is not None:
            (chosen,) = np.nonzero(has_material & has_uvs)
            corners = mesh.texture.uvs.take(triangles[chosen], axis=0)
            # float32 would resolve only a few hundredths of a texel in a large image.
            uvs = np.einsum("kc,kcx->kx", np.asarray(weights[chosen], np.float64), corners)
            sampled_colors = multiply_base_color(sample_bilinear(pixels, uvs, material.wrap), material)
            if mesh.colors is not None and multiplies_colors(material):
                light = convert_srgb_to_linear(sampled_colors / 255) * convert_srgb_to_linear(
                    colors[chosen] / 255
                )
                sampled_colors = 255 * convert_linear_to_srgb(light)
            colors[chosen] = sampled_colors
            has_material &= ~has_uvs
        if mesh.colors is None and material.base_color is not None:
            colors[has_material] = np.array(material.base_color[:3]) * 255
    return colors


def sample_bilinear(
    image: Pixels, uvs: NDArray[np.float64], wrap: tuple[str, str] = ("repeat", "repeat")
) -> _Floats:
    """Sample an image (h, w, 3 or 4) bilinearly at texture coordinates (k, 2).

    (0, 0) is the lower left corner of the image.

    Returns
    -------
    (k, 3) float32 RGB in 8-bit levels.
    """
    height, width = image.shape[:2]
    columns, column_weight = _locate_texels(uvs[:, 0], width, wrap[0])
    rows, row_weight = _locate_texels(1 - uvs[:, 1], height, wrap[1])
    row_colors = []
    # `take` is up to twice as fast as indexing by rows and columns.
    texels = image.reshape(-1, image.shape[2])
    for row in rows:
        first, second = (
            texels.take(row * width + column, axis=0)[:, :3].astype(np.float32) for column in columns
        )
        row_colors.append(first + (second - first) * column_weight)
    return np.asarray(row_colors[0] + (row_colors[1] - row_colors[0]) * row_weight)


def multiply_base_color(colors: _Floats, material: Material) -> _Floats:
    """Multiply colours (k, 3) by a material's base colour in linear light.

    Input and output are sRGB in 8-bit levels.
    """
    if material.base_color is None or min(material.base_color[:3]) >= 1:
        return colors
    tint = convert_srgb_to_linear(np.array(material.base_color[:3]))
    return np.asarray(255 * convert_linear_to_srgb(convert_srgb_to_linear(colors / 255) * tint))


def decode_material_image(material: Material) -> Pixels | None:
    """Return the pixels of a material's image.

    The result is None without an image, or if it cannot be decoded.
    """
    if material.image is None:
        return None
    try:
        return material.image.pixels
    except MeshError:
        return None


def _locate_texels(
    coordinates: NDArray[np.float64], size: int, wrap: str
) -> tuple[tuple[NDArray[np.int64], NDArray[np.int64]], _Floats]:
    """Return both neighbouring texel indices of image coordinates, and the second's weight (k, 1).

    The coordinates (k,) are in units of the image size; `wrap` is the wrap mode.
    """
    period = 2 if wrap == "mirror" else 1
    # Wrap first, because coordinates can be huge and would overflow. Texel centres are at half integers.
    place = (coordinates.clip(-1, 2) if wrap == "clamp" else coordinates % period) * size - 0.5
    first = np.floor(place).astype(np.int64)
    texels = []
    for index in (first, first + 1):
        if wrap == "clamp":
            texels.append(index.clip(0, size - 1))
        else:
            index %= period * size
            texels.append(np.minimum(index, 2 * size - 1 - index) if wrap == "mirror" else index)
    return (texels[0], texels[1]), (place - np.floor(place)).astype(np.float32)[:, None]


def _get_materials(mesh: Mesh) -> tuple[Material, ...]:
    return () if mesh.texture is None else mesh.texture.materials


def _interpolate_colors(values: NDArray[np.uint8], corners: NDArray[np.int32], weights: _Floats) -> _Floats:
    # One corner at a time is three times as fast as all three at once.
    colors: _Floats = values.take(corners[:, 0], axis=0) * weights[:, :1]
    for i in (1, 2):
        colors += values.take(corners[:, i], axis=0) * weights[:, i : i + 1]
    return colors
