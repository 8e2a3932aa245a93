"""Material classes: groups of materials whose images can share an atlas."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.formats.gltf_materials import WRAP_MODES, GltfMaterialSource, multiplies_colors
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.surface_color import decode_material_image
from scanloom.stages.surface.texture import Image, Material, Texture

# Path of a texture in the glTF material: the keys of nested objects.
TexturePath = tuple[str, ...]

BASE_COLOR: TexturePath = ("pbrMetallicRoughness", "baseColorTexture")
_METALLIC_ROUGHNESS: TexturePath = ("pbrMetallicRoughness", "metallicRoughnessTexture")
# Texture factors that are baked into the image if the materials of a class differ in them, with their
# defaults.
FACTORS: dict[TexturePath, tuple[tuple[TexturePath, Any], ...]] = {
    _METALLIC_ROUGHNESS: (
        (("pbrMetallicRoughness", "roughnessFactor"), 1.0),
        (("pbrMetallicRoughness", "metallicFactor"), 1.0),
    ),
    ("emissiveTexture",): ((("emissiveFactor",), [0.0, 0.0, 0.0]),),
    ("occlusionTexture",): ((("occlusionTexture", "strength"), 1.0),),
    ("normalTexture",): ((("normalTexture", "scale"), 1.0),),
}


@dataclass(frozen=True)
class MaterialClass:
    """Materials that only differ in their images and image factors.

    Attributes
    ----------
    material_indices : indices of the materials of the mesh; −1 for triangles without a material.
    is_baked : the class gets new images.
    maps : paths of its textures other than the base colour.
    """

    material_indices: tuple[int, ...]
    is_baked: bool
    maps: tuple[TexturePath, ...] = ()


def group_materials(mesh: Mesh) -> tuple[NDArray[np.int32], tuple[MaterialClass, ...]]:
    """Group the materials of a mesh into classes.

    Returns
    -------
    Class of each triangle (m,), and the classes.
    """
    texture = mesh.texture
    if texture is None:
        return np.zeros(len(mesh.triangles), np.int32), (MaterialClass((-1,), mesh.colors is not None),)
    used = np.unique(texture.material_ids).tolist()
    found: dict[str, list[int]] = {}
    for number in used:
        found.setdefault(_make_class_key(mesh, number), []).append(number)
    classes = []
    class_of = np.zeros(len(texture.materials) + 1, np.int32)
    for index, numbers in enumerate(found.values()):
        material = texture.materials[numbers[0]] if numbers[0] >= 0 else Material()
        maps = tuple(iterate_map_paths(material))
        is_baked = mesh.colors is not None or decode_material_image(material) is not None or bool(maps)
        classes.append(MaterialClass(tuple(numbers), is_baked, maps))
        class_of[np.array(numbers) + 1] = index
    return class_of[texture.material_ids + 1], tuple(classes)


def iterate_map_paths(material: Material) -> Iterator[TexturePath]:
    """Yield the paths of a material's textures, except the base colour."""
    if isinstance(material.kept, GltfMaterialSource):
        yield from (path for path in iterate_texture_paths(material.kept.tree) if path != BASE_COLOR)


def iterate_texture_paths(tree: Any, start: TexturePath = ()) -> Iterator[TexturePath]:
    """Yield the paths of all textures of a glTF material and its extensions."""
    for key, value in tree.items():
        if isinstance(value, dict):
            if key.endswith("Texture"):
                if "index" in value:
                    yield (*start, key)
            else:
                yield from iterate_texture_paths(value, (*start, key))


def get_value(tree: Any, path: TexturePath, default: Any = None) -> Any:
    """Return the value at a path of nested objects, or `default`."""
    for key in path:
        if not isinstance(tree, dict) or key not in tree:
            return default
        tree = tree[key]
    return tree


def get_image(material: Material, path: TexturePath) -> Image | None:
    """Return the image of a texture, or None if no image can be decoded."""
    if path == BASE_COLOR:
        return material.image if decode_material_image(material) is not None else None
    if not isinstance(material.kept, GltfMaterialSource):
        return None
    info = get_value(material.kept.tree, path)
    image = None if info is None else material.kept.textures.get(info["index"], (None, {}))[0]
    return image if image is not None and decode_material_image(Material(image=image)) is not None else None


def get_wrap(material: Material, path: TexturePath) -> tuple[str, str]:
    """Return the wrap modes of a texture along u and v."""
    if path == BASE_COLOR:
        return material.wrap
    sampler = material.kept.textures[get_value(material.kept.tree, path)["index"]][1]
    return WRAP_MODES.get(sampler.get("wrapS"), "repeat"), WRAP_MODES.get(sampler.get("wrapT"), "repeat")


def list_images(texture: Texture, material_class: MaterialClass, path: TexturePath) -> list[Image]:
    """List the images of a class for one texture path, without duplicates."""
    found = [
        get_image(texture.materials[number], path)
        for number in material_class.material_indices
        if number >= 0
    ]
    return list({id(image): image for image in found if image is not None}.values())


def list_all_images(mesh: Mesh, classes: Sequence[MaterialClass]) -> list[Image]:
    """List the images that baking replaces, without duplicates."""
    assert mesh.texture is not None
    found: dict[int, Image] = {}
    for one in classes:
        if one.is_baked:
            for path in (BASE_COLOR, *one.maps):
                found.update({id(image): image for image in list_images(mesh.texture, one, path)})
    return list(found.values())


def is_opaque(material: Material) -> bool:
    """Return True if a glTF material ignores alpha."""
    if not isinstance(material.kept, GltfMaterialSource):
        return False
    return bool(material.kept.tree.get("alphaMode", "OPAQUE") == "OPAQUE")


def _make_class_key(mesh: Mesh, number: int) -> str:
    """Return a key that is equal for all materials of a class."""
    texture = mesh.texture
    if number < 0 or texture is None:
        return "none" if mesh.colors is None else "colors"
    material = texture.materials[number]
    has_image = decode_material_image(material) is not None
    paths = [path for path in iterate_map_paths(material) if get_image(material, path) is not None]
    if not (has_image or paths or mesh.colors is not None):
        # Nothing to bake: the material keeps its constant colour in a separate class.
        return f"material {number}"
    parts: list[Any] = [has_image, multiplies_colors(material), sorted(paths)]
    if not has_image:
        parts.append(material.base_color)
    elif not isinstance(material.kept, GltfMaterialSource):
        parts.append(type(material.kept).__name__)
    if isinstance(material.kept, GltfMaterialSource):
        tree = copy.deepcopy(material.kept.tree)
        for name in ("name", "extras"):
            tree.pop(name, None)
        get_value(tree, ("pbrMetallicRoughness",), {}).pop("baseColorFactor", None)
        for path in paths:
            for factor, _ in FACTORS.get(path, ()):
                get_value(tree, factor[:-1], {}).pop(factor[-1], None)
        for path in list(iterate_texture_paths(tree)):
            get_value(tree, path).pop("index")
        parts.append(tree)
    return json.dumps(parts, sort_keys=True, default=str)
