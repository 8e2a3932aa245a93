"""Material classes: groups of materials whose images can share an atlas."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.color import pixels_of
from scanloom.stages.surface.formats.gltf_materials import GltfStatements, multiplies_colors
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import Image, Material, Texture

# Path of a texture in the glTF material: the keys of nested objects.
Path = tuple[str, ...]

BASE_COLOR: Path = ("pbrMetallicRoughness", "baseColorTexture")
_METALLIC_ROUGHNESS: Path = ("pbrMetallicRoughness", "metallicRoughnessTexture")
# Texture factors that are baked into the image if the materials of a class differ in them, with their
# defaults.
FACTORS: dict[Path, tuple[tuple[Path, Any], ...]] = {
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
    numbers : indices of the materials of the mesh; −1 for triangles without a material.
    is_baked : the class gets new images.
    maps : paths of its textures other than the base colour.
    """

    numbers: tuple[int, ...]
    is_baked: bool
    maps: tuple[Path, ...] = ()


def material_classes(mesh: Mesh) -> tuple[NDArray[np.int32], tuple[MaterialClass, ...]]:
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
        found.setdefault(_key(mesh, number), []).append(number)
    classes = []
    class_of = np.zeros(len(texture.materials) + 1, np.int32)
    for index, numbers in enumerate(found.values()):
        material = texture.materials[numbers[0]] if numbers[0] >= 0 else Material()
        maps = tuple(map_paths(material))
        is_baked = mesh.colors is not None or pixels_of(material) is not None or bool(maps)
        classes.append(MaterialClass(tuple(numbers), is_baked, maps))
        class_of[np.array(numbers) + 1] = index
    return class_of[texture.material_ids + 1], tuple(classes)


def map_paths(material: Material) -> Iterator[Path]:
    """Yield the paths of a material's textures, except the base colour."""
    if isinstance(material.kept, GltfStatements):
        yield from (path for path in texture_paths(material.kept.tree) if path != BASE_COLOR)


def texture_paths(tree: Any, start: Path = ()) -> Iterator[Path]:
    """Yield the paths of all textures of a glTF material and its extensions."""
    for key, value in tree.items():
        if isinstance(value, dict):
            if key.endswith("Texture"):
                if "index" in value:
                    yield (*start, key)
            else:
                yield from texture_paths(value, (*start, key))


def value_at(tree: Any, path: Path, default: Any = None) -> Any:
    """Return the value at a path of nested objects, or `default`."""
    for key in path:
        if not isinstance(tree, dict) or key not in tree:
            return default
        tree = tree[key]
    return tree


def image_at(material: Material, path: Path) -> Image | None:
    """Return the image of a texture, or None if no image can be decoded."""
    if path == BASE_COLOR:
        return material.image if pixels_of(material) is not None else None
    if not isinstance(material.kept, GltfStatements):
        return None
    info = value_at(material.kept.tree, path)
    image = None if info is None else material.kept.textures.get(info["index"], (None, {}))[0]
    return image if image is not None and pixels_of(Material(image=image)) is not None else None


def list_images(texture: Texture, material_class: MaterialClass, path: Path) -> list[Image]:
    """List the images of a class for one texture path, without duplicates."""
    found = [image_at(texture.materials[number], path) for number in material_class.numbers if number >= 0]
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
    if not isinstance(material.kept, GltfStatements):
        return False
    return bool(material.kept.tree.get("alphaMode", "OPAQUE") == "OPAQUE")


def _key(mesh: Mesh, number: int) -> str:
    """Return a key that is equal for all materials of a class."""
    texture = mesh.texture
    if number < 0 or texture is None:
        return "none" if mesh.colors is None else "colors"
    material = texture.materials[number]
    has_image = pixels_of(material) is not None
    paths = [path for path in map_paths(material) if image_at(material, path) is not None]
    if not (has_image or paths or mesh.colors is not None):
        # Nothing to bake: the material keeps its constant colour in a separate class.
        return f"material {number}"
    parts: list[Any] = [has_image, multiplies_colors(material), sorted(paths)]
    if not has_image:
        parts.append(material.base_color)
    elif not isinstance(material.kept, GltfStatements):
        parts.append(type(material.kept).__name__)
    if isinstance(material.kept, GltfStatements):
        tree = copy.deepcopy(material.kept.tree)
        for name in ("name", "extras"):
            tree.pop(name, None)
        value_at(tree, ("pbrMetallicRoughness",), {}).pop("baseColorFactor", None)
        for path in paths:
            for factor, _ in FACTORS.get(path, ()):
                value_at(tree, factor[:-1], {}).pop(factor[-1], None)
        for path in list(texture_paths(tree)):
            value_at(tree, path).pop("index")
        parts.append(tree)
    return json.dumps(parts, sort_keys=True, default=str)
