"""Material of a class, built from its baked images."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.surface.formats.gltf_materials import CLAMP_SAMPLER, GltfMaterialSource
from scanloom.stages.surface.formats.mtl import MtlMaterialSource
from scanloom.stages.surface.texture import Image, Material, Texture
from scanloom.stages.texturing.codes import TEXTURE_BAKE_LEFT_OUT
from scanloom.stages.texturing.material_classes import (
    BASE_COLOR,
    FACTORS,
    MaterialClass,
    TexturePath,
    get_value,
)
from scanloom.stages.texturing.material_factors import has_common_base_color, has_common_factors


def build_material(
    texture: Texture, material_class: MaterialClass, images: dict[TexturePath, Image]
) -> Material:
    """Build the material of a class from its baked images.

    Parameters
    ----------
    texture : texture of the original mesh.
    material_class : class whose first material is the template.
    images : baked image of each texture path.
    """
    number = material_class.material_indices[0]
    first = texture.materials[number] if number >= 0 else Material()
    base = images.get(BASE_COLOR)
    color = first.base_color if has_common_base_color(texture, material_class) or base is None else None
    clamp = ("clamp", "clamp")
    if isinstance(first.kept, MtlMaterialSource):
        return replace(first, image=base, base_color=color, wrap=clamp, kept=_remove_maps(first.kept))
    if not isinstance(first.kept, GltfMaterialSource):
        return replace(first, image=base, base_color=color, wrap=clamp, kept=None)
    tree = copy.deepcopy(first.kept.tree)
    for path in (BASE_COLOR, *material_class.maps):
        if path not in images:
            get_value(tree, path[:-1], {}).pop(path[-1], None)
    textures: dict[int, tuple[Image, Any]] = {}
    for index, (path, image) in enumerate(images.items()):
        holder = tree
        for key in path[:-1]:
            holder = holder.setdefault(key, {})
        info = holder.setdefault(path[-1], {})
        info["index"] = index
        textures[index] = (image, dict(CLAMP_SAMPLER))
        if path[-1].lower().endswith("normaltexture"):
            info.pop("scale", None)
        elif path in FACTORS and not has_common_factors(texture, material_class, path):
            for place, default in FACTORS[path]:
                holder = get_value(tree, place[:-1], {})
                holder[place[-1]] = [1.0, 1.0, 1.0] if isinstance(default, list) else 1.0
    if color is None:
        get_value(tree, ("pbrMetallicRoughness",), {}).pop("baseColorFactor", None)
    kept = GltfMaterialSource(tree, textures, color, base, clamp)
    return replace(first, image=base, base_color=color, wrap=clamp, kept=kept)


def _remove_maps(kept: MtlMaterialSource) -> MtlMaterialSource:
    """Remove the maps of an MTL material, with a warning."""
    lines, lost = [], []
    for line in kept.lines:
        key = line.split(None, 1)[0]
        if key == "map_Kd":
            continue
        if key.startswith(("map_", "bump", "norm", "disp", "decal", "refl")):
            lost.append(key)
            continue
        lines.append(line)
    if lost:
        emit(
            TEXTURE_BAKE_LEFT_OUT.warning(
                "bake drops these maps of the original's materials: {maps}.", maps=", ".join(lost)
            )
        )
    return MtlMaterialSource(tuple(lines), {}, kept.color, None)
