"""Conversion between glTF materials and `Material`.

The base colour, its image and the wrap modes are interpreted. All other properties and their images are kept
unchanged for writing. Colours are linear in glTF and sRGB in `Material`.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Severity
from scanloom.stages.diagnostics.errors import InputError, MeshError
from scanloom.stages.files.image_bytes import encode_png
from scanloom.stages.files.image_headers import detect_image_type
from scanloom.stages.files.ktx2 import KTX2_MIME, require_ktx2_encoder
from scanloom.stages.surface.codes import MESH_LEFT_OUT, MESH_TEXTURE_DAMAGED
from scanloom.stages.surface.formats.color_conversion import convert_linear_to_srgb, convert_srgb_to_linear
from scanloom.stages.surface.formats.gltf_container import (
    Gltf,
    JsonObject,
    decode_data_uri,
    require_non_negative_int,
)
from scanloom.stages.surface.formats.texture_files import read_texture
from scanloom.stages.surface.texture import Image, Material

WRAP_MODES = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
# Sampler of an atlas, whose texture coordinates stay inside the image.
CLAMP_SAMPLER: JsonObject = {"wrapS": 33071, "wrapT": 33071}
_TEXTURE_TRANSFORM = "KHR_texture_transform"
_BASE_COLOR_TEXTURE = "baseColorTexture"
# Core glTF allows PNG and JPEG; other media types need an extension.
_CORE_MEDIA_TYPES = ("image/png", "image/jpeg")
_TEXTURE_EXTENSIONS = {"image/webp": "EXT_texture_webp", KTX2_MIME: "KHR_texture_basisu"}
UNLIT = "KHR_materials_unlit"
# Keys of the textures that hold sRGB colours; those of other textures are linear values.
_COLOR_TEXTURES = ("emissiveTexture", "diffuseTexture", "specularGlossinessTexture")
_COLOR_TEXTURE_SUFFIX = "ColorTexture"
# Material properties of glTF 2.0; others are non-standard and are dropped.
_KNOWN_PROPERTIES = (
    *("name", "pbrMetallicRoughness", "normalTexture", "occlusionTexture", "emissiveTexture"),
    *("emissiveFactor", "alphaMode", "alphaCutoff", "doubleSided", "extensions", "extras"),
)
# Written for faces without a material, because glTF's default material is metallic. Read back as no material.
_DEFAULT_MATERIAL: JsonObject = {"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}}
_DEFAULT_UNLIT_MATERIAL: JsonObject = {**_DEFAULT_MATERIAL, "extensions": {UNLIT: {}}}

# Encoder of an image; its second argument is one of IMAGE_KINDS.
ImageEncoder: TypeAlias = Callable[[Image, str], Image]


@dataclass(frozen=True, eq=False)
class GltfMaterialSource:
    """The original glTF properties of a material, for writing them back.

    Attributes
    ----------
    tree : JSON of the material; its texture indices are keys of `textures`.
    textures : image and sampler by texture index.
    color, image, wrap : the `Material` fields derived from `tree`, to detect later changes.
    multiplies_vertex_colors : True if the file has vertex colours on this material; they multiply the base
        colour.
    """

    tree: JsonObject
    textures: dict[int, tuple[Image, JsonObject]] = field(default_factory=dict)
    color: tuple[float, float, float, float] | None = None
    image: Image | None = None
    wrap: tuple[str, str] = ("repeat", "repeat")
    multiplies_vertex_colors: bool = False


@dataclass(frozen=True)
class UvPlacement:
    """UV set and texture transform of a material's base colour."""

    uv_set: int = 0
    transform: JsonObject = field(default_factory=dict)

    def apply(self, uvs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Apply KHR_texture_transform to coordinates (n, 2), with v pointing down."""
        if not self.transform:
            return uvs
        offset = np.array(self.transform.get("offset", (0, 0)), float).reshape(2)
        scale = np.array(self.transform.get("scale", (1, 1)), float).reshape(2)
        angle = float(self.transform.get("rotation", 0))
        # Counter-clockwise on the image, whose v axis points down.
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        return np.asarray((uvs * scale) @ turn.T + offset)


class MaterialReader:
    """Reader of the materials and images in use; reads each one once.

    Attributes
    ----------
    materials : the materials read so far.
    """

    def __init__(self, gltf: Gltf) -> None:
        self._gltf = gltf
        self._images_by_index: dict[int, Image | None] = {}
        self._materials_by_index: dict[int, tuple[int, UvPlacement]] = {}
        self._is_decoder_checked = False
        self.materials: list[Material] = []

    def read_material(self, index: Any, *, with_colors: bool) -> tuple[int, UvPlacement]:
        """Return the index in `materials` of a glTF material, and its UV placement.

        The index is -1 for a missing material and for the default material that scanloom writes.
        """
        if index is None:
            return -1, UvPlacement()
        if index not in self._materials_by_index:
            tree = self._gltf.get_item("materials", index)
            if tree in (_DEFAULT_MATERIAL, _DEFAULT_UNLIT_MATERIAL):
                return -1, UvPlacement()
            material, placement = self._convert_material(copy.deepcopy(tree), with_colors)
            self._materials_by_index[index] = len(self.materials), placement
            self.materials.append(material)
        return self._materials_by_index[index]

    def _convert_material(self, tree: JsonObject, with_colors: bool) -> tuple[Material, UvPlacement]:
        tree = {key: value for key, value in tree.items() if key in _KNOWN_PROPERTIES}
        name = str(tree.get("name", ""))
        surface = tree.get("pbrMetallicRoughness", {})
        base = surface.get(_BASE_COLOR_TEXTURE)
        references = list(_find_texture_references(tree))
        placement = UvPlacement()
        if base is not None or references:
            placement = _read_placement(base if base is not None else references[0][0][references[0][1]])
        textures: dict[int, tuple[Image, JsonObject]] = {}
        image: Image | None = None
        sampler: JsonObject = {}
        for holder, key in references:
            info = holder[key]
            is_usable = "index" in info and _read_placement(info) == placement
            found = self._read_texture(info["index"]) if is_usable else None
            if found is None:
                emit(
                    MESH_LEFT_OUT.warning(
                        "{key} of material {name!r} is left out: its image is missing, or it uses other "
                        "texture coordinates than the base colour",
                        self._gltf.path,
                        key=key,
                        name=name,
                    )
                )
                del holder[key]
                continue
            textures[info["index"]] = found
            if info is base:
                image, sampler = found
            _remove_placement(info)
        u, v = sampler.get("wrapS", 0), sampler.get("wrapT", 0)
        wrap = WRAP_MODES.get(u, "repeat"), WRAP_MODES.get(v, "repeat")
        color = None
        if "baseColorFactor" in surface:
            factor = np.clip(np.array(surface["baseColorFactor"], float).reshape(4), 0, 1)
            red, green, blue = convert_linear_to_srgb(factor[:3]).tolist()
            color = (red, green, blue, float(factor[3]))
        kept = GltfMaterialSource(tree, textures, color, image, wrap, with_colors)
        return Material(name, image, color, wrap, kept), placement

    def _read_texture(self, number: int) -> tuple[Image, JsonObject] | None:
        texture = self._gltf.get_item("textures", number)
        source = texture.get("source")
        if source is None:
            sources = (extension.get("source") for extension in texture.get("extensions", {}).values())
            source = next((s for s in sources if s is not None), None)
        if source is None:
            return None
        if source not in self._images_by_index:
            self._images_by_index[source] = self._read_image(self._gltf.get_item("images", source), source)
        image = self._images_by_index[source]
        sampler = texture.get("sampler")
        if image is None:
            return None
        return image, {} if sampler is None else self._gltf.get_item("samplers", sampler)

    def _read_image(self, tree: JsonObject, number: int) -> Image | None:
        name = str(tree.get("name", ""))
        uri = tree.get("uri")
        if uri is None:
            data = bytes(self._gltf.read_view(tree["bufferView"]))
        else:
            embedded = decode_data_uri(uri)
            if embedded is None:
                return read_texture(self._gltf.path, unquote(uri))
            data = embedded
        if not detect_image_type(data, name)[0]:
            emit(
                MESH_TEXTURE_DAMAGED.warning(
                    "the texture image {name} has an unknown format or is damaged",
                    self._gltf.path,
                    name=name or number,
                )
            )
            return None
        image = Image(name, data)
        if image.mime == KTX2_MIME:
            self._check_decoder()
        return image

    def _check_decoder(self) -> None:
        """Warn if KTX2 images can be copied, but not decoded."""
        if self._is_decoder_checked:
            return
        self._is_decoder_checked = True
        try:
            require_ktx2_encoder()
        except InputError as error:
            diagnostic = error.diagnostic.replace_location(self._gltf.path)
            emit(replace(diagnostic, severity=Severity.WARNING))


def _find_texture_references(tree: Any) -> Iterator[tuple[JsonObject, str]]:
    """Yield the parent object and key of each texture reference, extensions included."""
    for key, value in tree.items():
        if isinstance(value, dict):
            if key.endswith("Texture"):
                yield tree, key
            else:
                yield from _find_texture_references(value)


def _read_placement(info: JsonObject) -> UvPlacement:
    transform = dict(info.get("extensions", {}).get(_TEXTURE_TRANSFORM, {}))
    return UvPlacement(
        require_non_negative_int(transform.pop("texCoord", info.get("texCoord", 0))), transform
    )


def _remove_placement(info: JsonObject) -> None:
    """Remove the UV set and transform, which the corner coordinates already include."""
    info.pop("texCoord", None)
    _remove_extension(info, _TEXTURE_TRANSFORM)


def _remove_extension(tree: JsonObject, name: str) -> None:
    extensions = tree.get("extensions", {})
    extensions.pop(name, None)
    if not extensions:
        tree.pop("extensions", None)


def _drop_lighting(tree: JsonObject) -> None:
    """Make a material unlit, without the maps and extensions for lighting, which it ignores."""
    for name in ("normalTexture", "occlusionTexture"):
        tree.pop(name, None)
    extensions = tree.get("extensions", {})
    kept = {name: value for name, value in extensions.items() if not name.startswith("KHR_materials_")}
    tree["extensions"] = {**kept, UNLIT: {}}


def make_unlit_source() -> GltfMaterialSource:
    """Return the properties of an unlit material.

    It suits images with baked-in lighting, such as photos.
    """
    return GltfMaterialSource(copy.deepcopy(_DEFAULT_UNLIT_MATERIAL))


def make_unlit(material: Material) -> Material:
    """Return the material unlit, with its maps for programs that light it."""
    kept = material.kept if isinstance(material.kept, GltfMaterialSource) else make_lit_source()
    tree = copy.deepcopy(kept.tree)
    tree.setdefault("extensions", {})[UNLIT] = {}
    return replace(material, kept=replace(kept, tree=tree))


def make_lit_source() -> GltfMaterialSource:
    """Return the properties of a rough, non-metallic material."""
    return GltfMaterialSource(copy.deepcopy(_DEFAULT_MATERIAL))


def is_unlit(material: Material) -> bool:
    """Return True if the material is unlit (KHR_materials_unlit)."""
    return isinstance(material.kept, GltfMaterialSource) and UNLIT in material.kept.tree.get("extensions", {})


def multiplies_colors(material: Material) -> bool:
    """Return True if vertex colours multiply the material's image, as in its source file."""
    return isinstance(material.kept, GltfMaterialSource) and material.kept.multiplies_vertex_colors


def has_images(material: Material | None) -> bool:
    """Return True if a material has an image, including images kept only for writing."""
    if material is None:
        return False
    return material.image is not None or bool(
        isinstance(material.kept, GltfMaterialSource) and material.kept.textures
    )


class MaterialWriter:
    """Builder of the materials, textures, samplers and images of a new file.

    Attributes
    ----------
    tree : glTF description; receives "materials", "textures", "samplers" and "extensionsUsed".
    shading : one of SHADINGS, see `write_gltf`.
    bare_colors : True to write vertex colours without a material.
    encode_image : encoder of the images; None stores them unchanged.
    images : (bytes, media type, name) of each image; textures refer to their index.
    """

    def __init__(
        self, tree: JsonObject, shading: str, *, bare_colors: bool, encode_image: ImageEncoder | None = None
    ) -> None:
        self.tree = tree
        self._shading = shading
        self._bare_colors = bare_colors
        self._encode_image = encode_image
        self.images: list[tuple[bytes, str, str]] = []
        self._image_indices: dict[tuple[int, str], int | None] = {}

    def add_material(
        self, material: Material | None, *, with_colors: bool, steps: tuple[int, int] | None = None
    ) -> int | None:
        """Add a material and return its index; None for bare vertex colours.

        glTF multiplies vertex colours with the base colour. A material that did not do so in its source file
        is therefore written without a base colour.

        Parameters
        ----------
        material : None for faces without a material.
        with_colors : True if the primitive has vertex colours.
        steps : quantization steps of the texture coordinates along u and v; None if not quantized this way.
        """
        if material is None:
            if with_colors and self._bare_colors:
                return None
            if self._shading == "unlit":
                self._add_entry("extensionsUsed", UNLIT)
                return self._add_entry("materials", _DEFAULT_UNLIT_MATERIAL)
            return self._add_entry("materials", _DEFAULT_MATERIAL)
        kept = (
            material.kept
            if isinstance(material.kept, GltfMaterialSource)
            else GltfMaterialSource(_DEFAULT_MATERIAL)
        )
        tree = copy.deepcopy(kept.tree)
        if self._shading == "unlit":
            # Before images are stored: the file must not contain images of dropped extensions.
            _drop_lighting(tree)
        surface = tree.setdefault("pbrMetallicRoughness", {})
        has_other_image = material.image is not kept.image or material.wrap != kept.wrap
        if has_other_image:
            # Must come before images are stored: the file no longer uses this image.
            surface.pop(_BASE_COLOR_TEXTURE, None)
        for holder, key in list(_find_texture_references(tree)):
            number = self._add_texture(*kept.textures[holder[key]["index"]], key)
            if number is None:
                del holder[key]
            else:
                holder[key]["index"] = number
        tree.pop("name", None)
        if material.name:
            tree["name"] = material.name
        hidden = with_colors and not kept.multiplies_vertex_colors
        if material.base_color != kept.color or hidden:
            surface.pop("baseColorFactor", None)
            if material.base_color is not None and not hidden:
                light = convert_srgb_to_linear(np.array(material.base_color[:3])).tolist()
                surface["baseColorFactor"] = [*light, float(material.base_color[3])]
        if has_other_image and material.image is not None:
            number = self._add_texture(material.image, _make_sampler(material.wrap), _BASE_COLOR_TEXTURE)
            if number is not None:
                surface[_BASE_COLOR_TEXTURE] = {"index": number}
        if steps is not None:
            for holder, key in _find_texture_references(tree):
                moved = {"scale": [1 / count for count in steps]}
                holder[key].setdefault("extensions", {})[_TEXTURE_TRANSFORM] = moved
            self._add_entry("extensionsRequired", _TEXTURE_TRANSFORM)
        if self._shading == "lit":
            _remove_extension(tree, UNLIT)
        for name in sorted(_collect_extensions(tree)):
            self._add_entry("extensionsUsed", name)
        return self._add_entry("materials", tree)

    def _add_texture(self, image: Image, sampler: JsonObject, key: str) -> int | None:
        """Add the texture of a material's key; return its index, or None if the image cannot be stored."""
        kind = "" if self._encode_image is None else _get_image_kind(key)
        if (id(image), kind) not in self._image_indices:
            self._image_indices[id(image), kind] = self._store_image(image, kind)
        source = self._image_indices[id(image), kind]
        if source is None:
            return None
        texture: JsonObject = {"source": source}
        extension = _TEXTURE_EXTENSIONS.get(self.images[source][1])
        if extension is not None:
            texture = {"extensions": {extension: texture}}
            self._add_entry("extensionsUsed", extension)
            self._add_entry("extensionsRequired", extension)
        if sampler:
            texture["sampler"] = self._add_entry("samplers", sampler)
        return self._add_entry("textures", texture)

    def _store_image(self, image: Image, kind: str) -> int | None:
        if self._encode_image is not None:
            image = self._encode_image(image, kind)
        data, mime = image.file_bytes, image.mime
        if mime not in _CORE_MEDIA_TYPES and mime not in _TEXTURE_EXTENSIONS:
            try:
                data, mime = encode_png(image.pixels), "image/png"
            except MeshError as error:
                emit(MESH_TEXTURE_DAMAGED.warning("{reason} It is left out.", reason=str(error)))
                return None
        self.images.append((data, mime, image.name))
        return len(self.images) - 1

    def _add_entry(self, name: str, entry: Any) -> int:
        """Return an entry's index in a top-level list, appending new entries."""
        entries: list[Any] = self.tree.setdefault(name, [])
        if entry not in entries:
            entries.append(entry)
        return entries.index(entry)


def _get_image_kind(key: str) -> str:
    """Return the kind of pixels, one of IMAGE_KINDS, of a texture by its key in a material."""
    if key.lower().endswith("normaltexture"):
        return "normal"
    is_color = key in _COLOR_TEXTURES or key.endswith(_COLOR_TEXTURE_SUFFIX)
    return "color" if is_color else "data"


def _make_sampler(wrap: tuple[str, str]) -> JsonObject:
    if wrap == ("repeat", "repeat"):
        return {}
    codes = {way: code for code, way in WRAP_MODES.items()}
    return {"wrapS": codes[wrap[0]], "wrapT": codes[wrap[1]]}


def _collect_extensions(tree: Any) -> set[str]:
    found: set[str] = set()
    for key, value in tree.items():
        if isinstance(value, dict):
            found |= _collect_extensions(value) | (set(value) if key == "extensions" else set())
    return found
