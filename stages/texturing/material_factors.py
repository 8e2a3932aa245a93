"""Factors of materials: comparison within a class, and multiplication into texels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.formats.colors import linear_from_srgb, srgb_from_linear
from scanloom.stages.surface.texture import Texture
from scanloom.stages.texturing.material_classes import (
    BASE_COLOR,
    FACTORS,
    MaterialClass,
    Path,
    list_images,
    value_at,
)

Pixels = NDArray[np.uint8]

_SRGB_LEVELS = np.arange(256) / 255


def shares_base_color(texture: Texture, material_class: MaterialClass) -> bool:
    """Return True if all materials of a class have images and the same base colour.

    A shared base colour stays a factor of the material instead of being baked.
    """
    colors = {texture.materials[number].base_color for number in material_class.numbers if number >= 0}
    return len(colors) == 1 and bool(list_images(texture, material_class, BASE_COLOR))


def shares_factors(texture: Texture, material_class: MaterialClass, path: Path) -> bool:
    """Return True if all materials of a class have the same factors for a map."""
    found = {
        repr(
            [
                value_at(texture.materials[number].kept.tree, place, default)
                for place, default in FACTORS[path]
            ]
        )
        for number in material_class.numbers
    }
    return len(found) == 1


def apply_factors(
    texture: Texture, material_class: MaterialClass, image: Pixels, number: int, path: Path
) -> Pixels:
    """Multiply a map by its factors unless the materials of the class share them."""
    if path not in FACTORS or shares_factors(texture, material_class, path):
        return image
    tree = texture.materials[number].kept.tree
    values = [value_at(tree, place, default) for place, default in FACTORS[path]]
    shown = image.astype(np.float32)
    if path == ("emissiveTexture",):
        return apply_tint(image, (*map(float, srgb_from_linear(np.array(values[0]))), 1.0))
    if path == ("occlusionTexture",):
        shown = 255 + float(values[0]) * (shown - 255)
    else:
        shown[..., 1] *= float(values[0])
        shown[..., 2] *= float(values[1])
    return np.rint(shown).clip(0, 255).astype(np.uint8)


def apply_tint(texels: Pixels, color: tuple[float, ...]) -> Pixels:
    """Multiply sRGB colours (h, w, 3 or 4) by a factor in linear light."""
    import cv2

    factor = linear_from_srgb(np.array(color[:3]))
    light = linear_from_srgb(_SRGB_LEVELS)[:, None] * factor
    table = np.rint(255 * srgb_from_linear(light)).clip(0, 255).astype(np.uint8)
    if texels.shape[2] == 4:
        alpha = np.rint(np.arange(256) * color[3]).clip(0, 255).astype(np.uint8)
        table = np.column_stack([table, alpha])
    return np.asarray(cv2.LUT(texels, np.ascontiguousarray(table[None])), np.uint8)
