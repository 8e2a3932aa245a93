"""Factors of materials: comparison within a class, and multiplication into texels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.formats.color_conversion import convert_linear_to_srgb, convert_srgb_to_linear
from scanloom.stages.surface.texture import Texture
from scanloom.stages.texturing.material_classes import (
    BASE_COLOR,
    FACTORS,
    MaterialClass,
    TexturePath,
    get_value,
    list_images,
)

Pixels = NDArray[np.uint8]

_SRGB_LEVELS = np.arange(256) / 255


def has_common_base_color(texture: Texture, material_class: MaterialClass) -> bool:
    """Return True if all materials of a class have images and the same base colour.

    A shared base colour stays a factor of the material instead of being baked.
    """
    colors = {
        texture.materials[number].base_color for number in material_class.material_indices if number >= 0
    }
    return len(colors) == 1 and bool(list_images(texture, material_class, BASE_COLOR))


def has_common_factors(texture: Texture, material_class: MaterialClass, path: TexturePath) -> bool:
    """Return True if all materials of a class have the same factors for a map."""
    found = {
        repr(
            [
                get_value(texture.materials[number].kept.tree, place, default)
                for place, default in FACTORS[path]
            ]
        )
        for number in material_class.material_indices
    }
    return len(found) == 1


def apply_factors(
    texture: Texture, material_class: MaterialClass, image: Pixels, number: int, path: TexturePath
) -> Pixels:
    """Multiply a map by its factors unless the materials of the class share them."""
    if path not in FACTORS or has_common_factors(texture, material_class, path):
        return image
    tree = texture.materials[number].kept.tree
    values = [get_value(tree, place, default) for place, default in FACTORS[path]]
    shown = image.astype(np.float32)
    if path == ("emissiveTexture",):
        return apply_tint(image, (*map(float, convert_linear_to_srgb(np.array(values[0]))), 1.0))
    if path == ("occlusionTexture",):
        shown = 255 + float(values[0]) * (shown - 255)
    else:
        shown[..., 1] *= float(values[0])
        shown[..., 2] *= float(values[1])
    return np.rint(shown).clip(0, 255).astype(np.uint8)


def apply_tint(texels: Pixels, color: tuple[float, ...]) -> Pixels:
    """Multiply sRGB colours (h, w, 3 or 4) by a factor in linear light."""
    import cv2

    factor = convert_srgb_to_linear(np.array(color[:3]))
    light = convert_srgb_to_linear(_SRGB_LEVELS)[:, None] * factor
    table = np.rint(255 * convert_linear_to_srgb(light)).clip(0, 255).astype(np.uint8)
    if texels.shape[2] == 4:
        alpha = np.rint(np.arange(256) * color[3]).clip(0, 255).astype(np.uint8)
        table = np.column_stack([table, alpha])
    return np.asarray(cv2.LUT(texels, np.ascontiguousarray(table[None])), np.uint8)
