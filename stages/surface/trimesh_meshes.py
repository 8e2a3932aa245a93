"""Conversion from and to trimesh.Trimesh.

Trimesh has one texture coordinate per vertex. Vertices on texture seams are therefore duplicated on export
and welded on import. Materials become a SimpleMaterial, or a MultiMaterial with `face_materials`. Corner
normals and parts are stored in `face_attributes`, part names and the up direction in `metadata`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.surface.codes import MESH_LEFT_OUT
from scanloom.stages.surface.formats.color_conversion import convert_linear_to_srgb, to_uint8
from scanloom.stages.surface.library_protocols import TrimeshMesh
from scanloom.stages.surface.mesh import Mesh, validate_mesh
from scanloom.stages.surface.texture import WRAP_MODES, Image, Material, Texture

if TYPE_CHECKING:
    from trimesh import Trimesh

_Ids = NDArray[np.int32]

# trimesh's default colour of a material.
_DEFAULT_COLOR = (102, 102, 102, 255)
_WHITE = (255, 255, 255, 255)
# Key in `info` of a PIL image for the original file name and content.
_FILE_KEY = "scanloom_file"
_OTHER_MAPS = ("normalTexture", "emissiveTexture", "occlusionTexture", "metallicRoughnessTexture")


def from_trimesh(data: TrimeshMesh, where: str) -> Mesh:
    """Convert and validate a trimesh.Trimesh."""
    visual: Any = data.visual
    other: Any = data
    mesh = Mesh(
        vertices=np.array(data.vertices),
        triangles=np.array(data.faces),
        colors=_read_vertex_colors(visual, len(data.vertices), where),
        # Only normals that were set or computed before; the property itself would compute them.
        normals=np.array(data.vertex_normals) if "vertex_normals" in data._cache else None,
        corner_normals=_read_attribute(other.face_attributes, "corner_normals", (len(data.faces), 3, 3)),
    )
    part_ids, part_names = _read_parts(other)
    mesh = mesh.with_(part_ids=part_ids, part_names=part_names, up=_read_up(other.metadata.get("up")))
    mesh = validate_mesh(mesh, where)
    if len(mesh.triangles) > 0 and visual.kind == "texture":
        mesh = _add_texture(mesh, visual, where)
    return mesh


def _read_vertex_colors(visual: Any, count: int, where: str) -> NDArray[np.uint8] | None:
    if visual.kind == "face":
        emit(MESH_LEFT_OUT.warning("face colours are left out; only vertex colours are used", where))
    if visual.kind == "vertex":
        colors = np.array(visual.vertex_colors)
    elif visual.kind == "texture" and "color" in visual.vertex_attributes:
        colors = np.array(visual.vertex_attributes["color"])
    else:
        return None
    if colors.ndim != 2 or len(colors) != count or colors.shape[1] not in (3, 4):
        return None
    levels = to_uint8(colors)
    if levels.shape[1] == 4 and levels[:, 3].min(initial=255) < 255:
        emit(MESH_LEFT_OUT.warning("the transparency of vertex colours is left out", where))
    return np.ascontiguousarray(levels[:, :3])


def _read_attribute(attributes: Any, name: str, shape: tuple[int, ...]) -> NDArray[Any] | None:
    """Return an attribute if it is numeric with this shape, else None."""
    array = np.array(attributes[name]) if name in attributes else np.zeros(0)
    return array if array.shape == shape and array.dtype.kind in "iuf" else None


def _read_parts(data: Any) -> tuple[_Ids | None, tuple[str, ...]]:
    names = data.metadata.get("part_names")
    ids = _read_attribute(data.face_attributes, "part_index", (len(data.faces),))
    if ids is None or not isinstance(names, (list, tuple)) or ids.dtype.kind not in "iu":
        return None, ()
    if ((ids < -1) | (ids >= len(names))).any():
        return None, ()
    return ids.astype(np.int32), tuple(str(name) for name in names)


def _read_up(given: Any) -> tuple[float, float, float] | None:
    is_direction = isinstance(given, list) and len(given) == 3 and all(isinstance(x, float) for x in given)
    return cast("Any", tuple(given)) if is_direction else None


def _add_texture(mesh: Mesh, visual: Any, where: str) -> Mesh:
    held = visual.material
    several = list(held.materials) if hasattr(held, "materials") else [held]
    images: dict[int, Image] = {}
    materials = tuple(_read_material(each, images, where) for each in several)
    count = len(mesh.triangles)
    ids = _read_material_ids(visual.face_materials, count, len(materials))
    uvs = visual.uv
    has_uvs = uvs is not None and len(uvs) == len(mesh.vertices)
    if not has_uvs and not any(material.base_color is not None for material in materials):
        if any(material.image is not None for material in materials):
            emit(
                MESH_LEFT_OUT.warning(
                    "texture images are left out: the mesh has no texture coordinates", where
                )
            )
        return mesh
    corner_uvs = np.array(uvs, np.float64)[:, :2][mesh.triangles] if has_uvs else np.zeros((count, 3, 2))
    if not any(material.image or material.base_color or material.name for material in materials):
        ids, materials = np.full(count, -1, np.int32), ()
    mesh = validate_mesh(mesh.with_(texture=Texture(corner_uvs, ids, materials)), where)
    attributes = visual.vertex_attributes
    source = np.asarray(attributes["vertex_index"]) if "vertex_index" in attributes else None
    return mesh if source is None else _weld_copies(mesh, source)


def _read_material_ids(given: Any, count: int, materials: int) -> _Ids:
    ids = np.zeros(count, np.int32) if given is None else np.asarray(given)
    if ids.shape != (count,) or ids.dtype.kind not in "iu":
        ids = np.zeros(count, np.int32)
    return np.where((ids >= 0) & (ids < materials), ids, -1).astype(np.int32)


def _read_material(data: Any, images: dict[int, Image], where: str) -> Material:
    """Convert a SimpleMaterial or PBRMaterial; `images` caches shared images by id."""
    name = str(getattr(data, "name", None) or "")
    if hasattr(data, "baseColorTexture"):
        image = _read_image(data.baseColorTexture, images)
        factor = data.baseColorFactor
        color = None if factor is None else tuple((np.asarray(factor, np.float64) / 255).tolist())
        if color is not None:
            color = (*convert_linear_to_srgb(np.array(color[:3])).tolist(), color[3])
        lost = sorted(name for name in _OTHER_MAPS if getattr(data, name, None) is not None)
        if lost:
            emit(
                MESH_LEFT_OUT.warning(
                    "material images other than the base colour are left out: {names}",
                    where,
                    names=", ".join(lost),
                )
            )
        return Material(name, image, None if image is not None and color == (1, 1, 1, 1) else color)
    image = _read_image(getattr(data, "image", None), images)
    properties = getattr(data, "kwargs", None) or {}
    wrap = properties.get("wrap")
    is_wrap = isinstance(wrap, tuple) and len(wrap) == 2 and set(wrap) <= set(WRAP_MODES)
    return Material(
        name=name,
        image=image,
        base_color=_read_color(data, image, properties.get("base_color")),
        wrap=cast("Any", wrap) if is_wrap else ("repeat", "repeat"),
        kept=properties.get("kept"),
    )


def _read_color(data: Any, image: Image | None, exact: Any) -> tuple[float, float, float, float] | None:
    """Return a SimpleMaterial's colour, in full precision if its 8-bit copy is unchanged."""
    diffuse = tuple(np.asarray(data.diffuse).tolist())
    if exact is not None and _to_levels(exact) == diffuse:
        red, green, blue, alpha = exact
        return red, green, blue, alpha
    # As for MTL files: programs disagree on the effect of a diffuse colour on an image.
    if image is not None or diffuse == _DEFAULT_COLOR or len(diffuse) != 4:
        return None
    red, green, blue, alpha = (level / 255 for level in diffuse)
    return red, green, blue, alpha


def _to_levels(color: Any) -> tuple[int, ...]:
    return tuple(np.rint(255 * np.clip(color, 0, 1)).astype(int).tolist())


def _read_image(data: Any, images: dict[int, Image]) -> Image | None:
    if data is None:
        return None
    if id(data) not in images:
        has_alpha = data.mode in ("RGBA", "LA", "PA")
        pixels = np.asarray(data.convert("RGBA" if has_alpha else "RGB"), np.uint8)
        if pixels.shape[:2] == (1, 1) and tuple(pixels[0, 0, :3]) == _DEFAULT_COLOR[:3]:
            # trimesh's placeholder for a missing image.
            return None
        images[id(data)] = _recover_file(data, pixels) or Image(given=pixels)
    return images[id(data)]


def _recover_file(data: Any, pixels: NDArray[np.uint8]) -> Image | None:
    """Return the original file of an image if its pixels are unchanged."""
    held = data.info.get(_FILE_KEY)
    if held is None:
        return None
    image = Image(*held)
    try:
        return image if np.array_equal(image.pixels, pixels) else None
    except MeshError:
        return None


def _weld_copies(mesh: Mesh, source: NDArray[Any]) -> Mesh:
    """Weld the duplicates along texture seams, unless one of them was modified."""
    if source.shape != (len(mesh.vertices),) or source.dtype.kind not in "iu" or len(source) == 0:
        return mesh
    _, first, place = np.unique(source, return_index=True, return_inverse=True)
    place = place.reshape(-1)
    for values in (mesh.vertices, mesh.colors, mesh.normals):
        if values is not None and (values != values[first][place]).any():
            return mesh
    return mesh.with_(
        vertices=mesh.vertices[first],
        triangles=place[mesh.triangles].astype(np.int32),
        colors=None if mesh.colors is None else mesh.colors[first],
        normals=None if mesh.normals is None else mesh.normals[first],
    )


def to_trimesh(mesh: Mesh) -> Trimesh:
    """Convert a mesh to a trimesh.Trimesh; `to_mesh` restores the same mesh.

    Vertices on texture seams are duplicated, because the class has one texture coordinate per vertex. Several
    materials become a MultiMaterial with `face_materials`. trimesh's viewer and exporters ignore these; write
    such meshes with `write_mesh`. Vertex colours of a textured mesh are in
    `visual.vertex_attributes["color"]`.
    """
    from trimesh import Trimesh

    source = np.arange(len(mesh.vertices))
    triangles: NDArray[np.integer] = mesh.triangles
    visual_arguments: dict[str, Any] = {"vertex_colors": mesh.colors}
    if mesh.texture is not None and len(mesh.triangles) > 0:
        source, triangles, uvs = _split_seams(mesh, mesh.texture)
        visual_arguments = {"visual": _build_visual(mesh, mesh.texture, source, uvs)}
    attributes: dict[str, Any] = {}
    if mesh.corner_normals is not None:
        attributes["corner_normals"] = mesh.corner_normals
    metadata: dict[str, Any] = {}
    if mesh.part_ids is not None:
        attributes["part_index"] = mesh.part_ids
        metadata["part_names"] = list(mesh.part_names)
    if mesh.up is not None:
        metadata["up"] = list(mesh.up)
    return Trimesh(
        mesh.vertices[source],
        triangles,
        # trimesh computes a maximum over the normals, which fails for an empty array.
        vertex_normals=mesh.normals[source] if mesh.normals is not None and len(source) else None,
        face_attributes=attributes,
        metadata=metadata,
        process=False,
        **visual_arguments,
    )


def _split_seams(
    mesh: Mesh, texture: Texture
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Duplicate each vertex per distinct texture coordinate.

    Returns
    -------
    The source vertex (k,) of each copy, triangles (m, 3) of the copies, and texture coordinates (k, 2).
    Unreferenced vertices come last.
    """
    corners = mesh.triangles.reshape(-1)
    wedges, first, wedge_of_corner = np.unique(
        np.column_stack((corners, texture.uvs.reshape(-1, 2))), axis=0, return_index=True, return_inverse=True
    )
    is_used = np.zeros(len(mesh.vertices), bool)
    is_used[corners] = True
    unused = np.flatnonzero(~is_used)
    source = np.concatenate([corners[first].astype(np.int64), unused])
    uvs = np.concatenate([wedges[:, 1:], np.zeros((len(unused), 2))])
    return source, wedge_of_corner.reshape(-1, 3), uvs


def _build_visual(mesh: Mesh, texture: Texture, source: NDArray[np.int64], uvs: NDArray[np.float64]) -> Any:
    import trimesh

    images: dict[int, Any] = {}
    materials = [_build_material(material, images) for material in texture.materials]
    types: Any = trimesh.visual.material
    is_plain = len(materials) == 1
    visual: Any = cast("Any", trimesh.visual).TextureVisuals(
        uv=uvs,
        material=materials[0] if is_plain else types.MultiMaterial(materials=materials),
        face_materials=None if is_plain and not texture.material_ids.any() else texture.material_ids.copy(),
    )
    visual.vertex_attributes["vertex_index"] = source
    if mesh.colors is not None:
        visual.vertex_attributes["color"] = np.column_stack(
            (mesh.colors[source], np.full(len(source), 255, np.uint8))
        )
    return visual


def _build_material(material: Material, images: dict[int, Any]) -> Any:
    import trimesh
    from PIL.Image import fromarray

    types: Any = trimesh.visual.material
    image = None
    if material.image is not None:
        key = id(material.image)
        if key not in images:
            images[key] = fromarray(np.ascontiguousarray(material.image.pixels))
            if material.image.encoded is not None:
                images[key].info[_FILE_KEY] = (material.image.name, material.image.encoded)
        image = images[key]
    color = material.base_color
    # White, so that an image without a base colour is displayed unchanged.
    diffuse = _to_levels(color) if color is not None else _WHITE if image is not None else None
    properties = {"base_color": color, "wrap": material.wrap, "kept": material.kept}
    return types.SimpleMaterial(
        image=image,
        diffuse=None if diffuse is None else np.array(diffuse, np.uint8),
        name=material.name or None,
        **properties,
    )
