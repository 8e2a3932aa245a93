"""Conversion from and to Open3D triangle meshes: `t.geometry` and the legacy class.

The tensor class stores arbitrary attributes. Materials after the first get numbered names (`albedo_1`,
`base_color_1`), which Open3D keeps but does not render. The legacy class stores only images: a material with
a colour and no image becomes an image of one pixel.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.surface.codes import MESH_CONVERSION_LOSS, MESH_LEFT_OUT
from scanloom.stages.surface.formats.color_conversion import to_uint8
from scanloom.stages.surface.library_protocols import Open3DLegacyMesh, Open3DMesh, TensorMap
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.surface_color import multiply_base_color
from scanloom.stages.surface.texture import Image, Material, Pixels, Texture

if TYPE_CHECKING:
    from open3d import geometry, t  # noqa: TID251

_WHITE = (1.0, 1.0, 1.0, 1.0)
# Names defined by Open3D; materials after the first append their index.
_IMAGE, _COLOR = "albedo", "base_color"
# Properties added by scanloom: the number of materials, and a flag for a first material without a colour,
# which Open3D would default to white.
_MATERIAL_COUNT, _COLOR_UNSET = "material_count", "base_color_unset"


def from_open3d(data: Open3DMesh, where: str) -> Mesh:
    """Convert an open3d.t.geometry.TriangleMesh; the result is not validated."""

    def read_array(attributes: TensorMap, name: str) -> Any:
        return attributes[name].cpu().numpy().copy() if name in attributes else None

    vertices, triangles = read_array(data.vertex, "positions"), read_array(data.triangle, "indices")
    colors, uvs = read_array(data.vertex, "colors"), read_array(data.triangle, "texture_uvs")
    materials = _read_materials(data, where)
    texture = None
    if uvs is not None:
        texture = _build_texture(uvs, read_array(data.triangle, "material_ids"), materials)
    part_ids = read_array(data.triangle, "part_ids")
    return Mesh(
        vertices=np.zeros((0, 3)) if vertices is None else vertices,
        triangles=np.zeros((0, 3), np.int32) if triangles is None else triangles,
        colors=None if colors is None else _to_levels(colors),
        normals=read_array(data.vertex, "normals"),
        texture=texture,
        corner_normals=read_array(data.triangle, "corner_normals"),
        part_ids=part_ids,
        part_names=() if part_ids is None else _name_parts(part_ids),
    )


def _name_parts(part_ids: NDArray[Any]) -> tuple[str, ...]:
    count = int(part_ids.max(initial=-1)) + 1
    return tuple(f"part {index}" for index in range(count))


def _read_materials(data: Open3DMesh, where: str) -> tuple[Material, ...]:
    """Read the materials of a tensor mesh; warn about dropped texture maps."""
    if not data.has_valid_material():
        return ()
    properties: Any = data.material
    maps, colors, numbers = (
        properties.texture_maps,
        properties.vector_properties,
        properties.scalar_properties,
    )
    count = int(numbers[_MATERIAL_COUNT]) if _MATERIAL_COUNT in numbers else 1
    materials = []
    for index in range(count):
        image_name, color_name = _make_indexed_name(_IMAGE, index), _make_indexed_name(_COLOR, index)
        image = None
        if image_name in maps:
            image = Image(given=_to_rgb(maps[image_name].cpu().as_tensor().numpy().copy()))
        color = None
        if color_name in colors and (index > 0 or _COLOR_UNSET not in numbers):
            color = tuple(float(value) for value in colors[color_name])
        if image is not None and color == _WHITE:
            color = None
        materials.append(Material(image=image, base_color=cast("Any", color)))
    others = sorted(name for name, _ in maps.items() if not name.startswith(_IMAGE))
    if others:
        emit(
            MESH_LEFT_OUT.warning(
                "material images other than albedo are left out: {names}", where, names=", ".join(others)
            )
        )
    # Open3D's default material carries no information and is dropped.
    has_own = count > 1 or materials[0].image is not None or materials[0].base_color not in (None, _WHITE)
    return tuple(materials) if has_own or _MATERIAL_COUNT in numbers else ()


def _make_indexed_name(name: str, index: int) -> str:
    return name if index == 0 else f"{name}_{index}"


def from_open3d_legacy(data: Open3DLegacyMesh) -> Mesh:
    """Convert an open3d.geometry.TriangleMesh; the result is not validated."""
    texture = None
    if data.has_triangle_uvs():
        uvs = np.array(data.triangle_uvs).reshape(-1, 3, 2)
        material_ids = np.array(data.triangle_material_ids)
        # Empty images become materials without an image, to keep the material indices valid.
        materials = tuple(_read_legacy_material(image) for image in data.textures)
        texture = _build_texture(uvs, material_ids if len(material_ids) == len(uvs) else None, materials)
    return Mesh(
        vertices=np.array(data.vertices),
        triangles=np.array(data.triangles),
        colors=_to_levels(np.asarray(data.vertex_colors)) if data.has_vertex_colors() else None,
        normals=np.array(data.vertex_normals) if data.has_vertex_normals() else None,
        texture=texture,
    )


def _read_legacy_material(image: Any) -> Material:
    if image.is_empty():
        return Material()
    # The legacy class stores images bottom row first.
    pixels = _to_rgb(np.asarray(image)[::-1])
    if pixels.shape[:2] == (1, 1):
        red, green, blue, *alpha = (pixels[0, 0] / 255).tolist()
        return Material(base_color=(red, green, blue, alpha[0] if alpha else 1.0))
    return Material(image=Image(given=pixels))


def _build_texture(
    uvs: NDArray[Any], material_ids: NDArray[Any] | None, materials: tuple[Material, ...]
) -> Texture:
    ids = np.zeros(len(uvs), np.int32) if material_ids is None else material_ids.reshape(-1).astype(np.int32)
    return Texture(uvs.astype(np.float64), np.where((ids >= 0) & (ids < len(materials)), ids, -1), materials)


def _to_levels(colors: NDArray[Any]) -> NDArray[np.uint8]:
    # Clip first: a float colour slightly above 1 would make `to_uint8` assume the range 0 to 255.
    return to_uint8(np.clip(colors, 0, 1) if colors.dtype.kind == "f" else colors)


def _to_rgb(image: NDArray[Any]) -> NDArray[np.uint8]:
    image = to_uint8(image)
    if image.ndim == 2 or image.shape[2] == 1:
        image = np.repeat(image.reshape(*image.shape[:2], 1), 3, axis=2)
    return np.ascontiguousarray(image)


def to_open3d(mesh: Mesh) -> t.geometry.TriangleMesh:
    """Convert a mesh to an open3d.t.geometry.TriangleMesh.

    Positions and normals are float64, indices int32, colours uint8. Open3D renders the image of the first
    material; further images are stored as `albedo_1` etc. Open3D's `clone` and `to_legacy` drop materials.
    Data that the class cannot hold is reported (`mesh.conversion-loss`).
    """
    from scanloom.stages._open3d import import_open3d

    o3d = import_open3d()
    tensor = o3d.core.Tensor
    result = o3d.t.geometry.TriangleMesh()
    result.vertex.positions = tensor(mesh.vertices)
    result.triangle.indices = tensor(mesh.triangles)
    if mesh.colors is not None:
        result.vertex.colors = tensor(mesh.colors)
    if mesh.normals is not None:
        result.vertex.normals = tensor(mesh.normals)
    if mesh.corner_normals is not None:
        result.triangle["corner_normals"] = tensor(mesh.corner_normals)
    if mesh.part_ids is not None:
        result.triangle["part_ids"] = tensor(mesh.part_ids)
    if mesh.texture is not None:
        result.triangle.texture_uvs = tensor(mesh.texture.uvs)
        result.triangle.material_ids = tensor(mesh.texture.material_ids)
        _set_tensor_materials(o3d, result.material, mesh.texture.materials)
    losses = [*_find_material_losses(mesh), *(["part names"] if any(mesh.part_names) else [])]
    if mesh.up is not None:
        losses.append("the up direction")
    _report_losses("open3d.t.geometry.TriangleMesh", losses)
    return cast("t.geometry.TriangleMesh", result)


def _set_tensor_materials(o3d: Any, target: Any, materials: tuple[Material, ...]) -> None:
    if not materials:
        return
    target.set_default_properties()
    target.scalar_properties[_MATERIAL_COUNT] = float(len(materials))
    if materials[0].image is None and materials[0].base_color is None:
        target.scalar_properties[_COLOR_UNSET] = 1.0
    for index, material in enumerate(materials):
        if material.image is not None:
            pixels = np.ascontiguousarray(material.image.pixels)
            target.texture_maps[_make_indexed_name(_IMAGE, index)] = o3d.t.geometry.Image(
                o3d.core.Tensor(pixels)
            )
        if material.base_color is not None:
            target.vector_properties[_make_indexed_name(_COLOR, index)] = np.array(
                material.base_color, np.float32
            )


def to_open3d_legacy(mesh: Mesh) -> geometry.TriangleMesh:
    """Convert a mesh to a legacy open3d.geometry.TriangleMesh.

    Colours become floats 0 to 1, from which the 8-bit values are recovered exactly. Base colours are
    multiplied into the images. Data that the class cannot hold is reported (`mesh.conversion-loss`).
    """
    from scanloom.stages._open3d import import_open3d

    o3d = import_open3d()
    result = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.triangles)
    )
    if mesh.colors is not None:
        result.vertex_colors = o3d.utility.Vector3dVector(mesh.colors / 255)
    if mesh.normals is not None:
        result.vertex_normals = o3d.utility.Vector3dVector(mesh.normals)
    if mesh.texture is not None:
        result.triangle_uvs = o3d.utility.Vector2dVector(mesh.texture.uvs.reshape(-1, 2))
        result.triangle_material_ids = o3d.utility.IntVector(mesh.texture.material_ids)
        result.textures = [_build_legacy_image(o3d, material) for material in mesh.texture.materials]
    has = (
        ("corner normals", mesh.corner_normals is not None),
        ("parts", mesh.part_ids is not None),
        ("the up direction", mesh.up is not None),
    )
    losses = [*_find_material_losses(mesh), *(name for name, is_lost in has if is_lost)]
    _report_losses("open3d.geometry.TriangleMesh", losses)
    return cast("geometry.TriangleMesh", result)


def _build_legacy_image(o3d: Any, material: Material) -> Any:
    """Return a material's image for the legacy class.

    The bottom row is first. The image is empty if the material has neither image nor colour.
    """
    if material.image is not None:
        return o3d.geometry.Image(np.ascontiguousarray(_tint_pixels(material.image.pixels, material)[::-1]))
    if material.base_color is None:
        return o3d.geometry.Image()
    channels = 3 if material.base_color[3] >= 1 else 4
    levels = np.rint(255 * np.clip(material.base_color[:channels], 0, 1)).astype(np.uint8)
    return o3d.geometry.Image(levels.reshape(1, 1, channels))


def _tint_pixels(pixels: Pixels, material: Material) -> Pixels:
    """Multiply an image by the base colour of its material."""
    if material.base_color is None or min(material.base_color[:3]) >= 1:
        return pixels
    colors = pixels[..., :3].reshape(-1, 3).astype(np.float32)
    levels = np.rint(multiply_base_color(colors, material)).astype(np.uint8)
    return np.concatenate([levels.reshape(*pixels.shape[:2], 3), pixels[..., 3:]], axis=2)


def _report_losses(class_name: str, losses: Iterable[str]) -> None:
    """Emit one warning that lists all dropped data, if any."""
    found = list(losses)
    if found:
        emit(
            MESH_CONVERSION_LOSS.warning(
                "{class_name} cannot hold {losses} of this mesh: left out.",
                remedy="Pass the Mesh itself, or write it with write_mesh as GLB, OBJ or PLY.",
                class_name=class_name,
                losses=" and ".join(found),
            )
        )


def _find_material_losses(mesh: Mesh) -> list[str]:
    """List the material properties in use other than image and base colour."""
    materials = () if mesh.texture is None else mesh.texture.materials
    losses = (
        ("material names", any(material.name for material in materials)),
        ("wrap modes of images", any(set(material.wrap) != {"repeat"} for material in materials)),
        ("shading properties of materials", any(material.kept is not None for material in materials)),
    )
    return [name for name, is_lost in losses if is_lost]
