"""Meshes of other libraries in and out, without loss, and without importing a library nobody used.

What each class can hold: Open3D's legacy class has all but parts, normals of corners and what materials say
beside their images; its tensor class one texture image; trimesh texture coordinates per vertex only, so
vertices on seams are duplicated on the way out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stages.errors import MeshError
from stages.surface.color import sampled, tinted
from stages.surface.foreign_meshes import Open3DLegacyMesh, Open3DMesh, TensorMap, TrimeshMesh
from stages.surface.formats.colors import to_uint8
from stages.surface.mesh import Mesh, validated
from stages.surface.texture import Image, Material, Texture

if TYPE_CHECKING:
    from open3d import geometry, t  # noqa: TID251
    from trimesh import Trimesh

MeshLike: TypeAlias = Mesh | Open3DMesh | Open3DLegacyMesh | TrimeshMesh | tuple[ArrayLike, ArrayLike]

_UNTEXTURED = 128  # grey, for vertices that nothing colours


def as_mesh(data: MeshLike, where: str = "mesh") -> Mesh:
    """Return any mesh as a validated Mesh; the arrays are copies of another library's.

    Parameters
    ----------
    data : Mesh, open3d.t.geometry.TriangleMesh, open3d.geometry.TriangleMesh, trimesh.Trimesh, or
        (vertices (n, 3), triangles (m, 3)). Open3D's float colours are 0..1.
    where : what messages call it.

    Raises
    ------
    MeshError
        For another type, wrong shapes, values that are not finite, indices out of range.
    """
    if isinstance(data, Mesh):
        return validated(data, where)
    if isinstance(data, tuple) and len(data) == 2:
        return validated(Mesh(np.asarray(data[0]), np.asarray(data[1])), where)
    # Type checkers go by their members; names tell here, and which library they are of.
    other: Any = data
    for cls in type(data).__mro__:
        module = cls.__module__
        if cls.__name__ == "TriangleMesh" and module.startswith("open3d."):
            convert = _from_open3d if ".t.geometry" in module else _from_open3d_legacy
            return validated(convert(other), where)
        if cls.__name__ == "Trimesh" and module.startswith("trimesh."):
            return _from_trimesh(other, where)
    raise MeshError(
        f"is a {type(data).__name__}; a Mesh, an Open3D or trimesh triangle mesh, or a pair of arrays "
        "(vertices, triangles) is expected.",
        where,
    )


def _from_open3d(data: Open3DMesh) -> Mesh:
    def array(attributes: TensorMap, name: str) -> Any:
        return attributes[name].cpu().numpy().copy() if name in attributes else None

    vertices, triangles = array(data.vertex, "positions"), array(data.triangle, "indices")
    colors, uvs = array(data.vertex, "colors"), array(data.triangle, "texture_uvs")
    texture = None
    if uvs is not None:
        material_ids = array(data.triangle, "material_ids")
        images: tuple[NDArray[np.uint8], ...] = ()
        if data.has_valid_material() and "albedo" in (maps := data.material.texture_maps):
            images = (_rgb(maps["albedo"].cpu().as_tensor().numpy().copy()),)
        texture = _texture(uvs, material_ids, images)
    return Mesh(
        vertices=np.zeros((0, 3)) if vertices is None else vertices,
        triangles=np.zeros((0, 3), np.int32) if triangles is None else triangles,
        colors=None if colors is None else _from_unit(colors),
        normals=array(data.vertex, "normals"),
        texture=texture,
    )


def _from_open3d_legacy(data: Open3DLegacyMesh) -> Mesh:
    texture = None
    if data.has_triangle_uvs():
        uvs = np.array(data.triangle_uvs).reshape(-1, 3, 2)
        # This class keeps images bottom row first.
        images = tuple(_rgb(np.asarray(image)[::-1]) for image in data.textures if not image.is_empty())
        material_ids = np.array(data.triangle_material_ids)
        texture = _texture(uvs, material_ids if len(material_ids) == len(uvs) else None, images)
    return Mesh(
        vertices=np.array(data.vertices),
        triangles=np.array(data.triangles),
        colors=_from_unit(np.asarray(data.vertex_colors)) if data.has_vertex_colors() else None,
        normals=np.array(data.vertex_normals) if data.has_vertex_normals() else None,
        texture=texture,
    )


def _from_trimesh(data: TrimeshMesh, where: str) -> Mesh:
    visual: Any = data.visual
    mesh = Mesh(
        vertices=np.array(data.vertices),
        triangles=np.array(data.faces),
        colors=np.array(visual.vertex_colors[:, :3]) if visual.kind == "vertex" else None,
        # Reading the property would compute normals that were never given.
        normals=np.array(data.vertex_normals) if "vertex_normals" in data._cache else None,
        notes=("colours of faces are left out; only colours of vertices are used",) * (visual.kind == "face"),
    )
    mesh = validated(mesh, where)
    uvs = getattr(visual, "uv", None)
    if uvs is None or len(uvs) != len(mesh.vertices) or len(mesh.triangles) == 0:
        return mesh
    image = _trimesh_image(visual.material)
    texture = _texture(np.array(uvs, np.float64)[mesh.triangles], None, () if image is None else (image,))
    return validated(mesh.with_(texture=texture), where)


def _trimesh_image(material: Any) -> NDArray[np.uint8] | None:
    image = getattr(material, "image", None)
    if image is None:
        image = getattr(material, "baseColorTexture", None)
    if image is None:
        return None
    return np.asarray(image.convert("RGBA" if image.mode in ("RGBA", "LA", "PA") else "RGB"), np.uint8)


def _texture(
    uvs: NDArray[Any], material_ids: NDArray[Any] | None, images: tuple[NDArray[np.uint8], ...]
) -> Texture:
    ids = np.zeros(len(uvs), np.int32) if material_ids is None else material_ids.reshape(-1).astype(np.int32)
    materials = tuple(Material(image=Image(given=image)) for image in images)
    return Texture(uvs.astype(np.float64), np.where((ids >= 0) & (ids < len(images)), ids, -1), materials)


def _from_unit(colors: NDArray[Any]) -> NDArray[np.uint8]:
    # Clipped first: a colour a rounding error above 1 must not pass for one of 0..255.
    return to_uint8(np.clip(colors, 0, 1) if colors.dtype.kind == "f" else colors)


def _rgb(image: NDArray[Any]) -> NDArray[np.uint8]:
    image = to_uint8(image)
    if image.ndim == 2 or image.shape[2] == 1:
        image = np.repeat(image.reshape(*image.shape[:2], 1), 3, axis=2)
    return np.ascontiguousarray(image)


def to_open3d(mesh: Mesh) -> t.geometry.TriangleMesh:
    """Return an open3d.t.geometry.TriangleMesh: float64 positions and normals, int32 indices, uint8 colours.

    The class holds one texture image; of several, the first is passed on.
    """
    from stages._open3d import open3d

    o3d = open3d()
    result = o3d.t.geometry.TriangleMesh()
    result.vertex.positions = o3d.core.Tensor(mesh.vertices)
    result.triangle.indices = o3d.core.Tensor(mesh.triangles)
    if mesh.colors is not None:
        result.vertex.colors = o3d.core.Tensor(mesh.colors)
    if mesh.normals is not None:
        result.vertex.normals = o3d.core.Tensor(mesh.normals)
    if mesh.texture is not None:
        result.triangle.texture_uvs = o3d.core.Tensor(mesh.texture.uvs)
        result.triangle.material_ids = o3d.core.Tensor(_image_ids(mesh.texture))
        if mesh.texture.images:
            result.material.set_default_properties()
            image = np.ascontiguousarray(mesh.texture.images[0].pixels)
            result.material.texture_maps["albedo"] = o3d.t.geometry.Image(o3d.core.Tensor(image))
    return cast("t.geometry.TriangleMesh", result)


def to_open3d_legacy(mesh: Mesh) -> geometry.TriangleMesh:
    """Return an open3d.geometry.TriangleMesh; colours become 0..1 floats that come back exactly."""
    from stages._open3d import open3d

    o3d = open3d()
    result = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.triangles)
    )
    if mesh.colors is not None:
        result.vertex_colors = o3d.utility.Vector3dVector(mesh.colors / 255)
    if mesh.normals is not None:
        result.vertex_normals = o3d.utility.Vector3dVector(mesh.normals)
    if mesh.texture is not None:
        result.triangle_uvs = o3d.utility.Vector2dVector(mesh.texture.uvs.reshape(-1, 2))
        result.triangle_material_ids = o3d.utility.IntVector(_image_ids(mesh.texture))
        flipped = (np.ascontiguousarray(image.pixels[::-1]) for image in mesh.texture.images)
        result.textures = [o3d.geometry.Image(image) for image in flipped]
    return cast("geometry.TriangleMesh", result)


def _image_ids(texture: Texture) -> NDArray[np.int32]:
    """Return (m,) which of `texture.images` each triangle takes its colours from; -1 for none."""
    numbers = {id(image): number for number, image in enumerate(texture.images)}
    of_material = [numbers.get(id(material.image), -1) for material in texture.materials]
    return np.array([*of_material, -1], np.int32)[texture.material_ids]


def to_trimesh(mesh: Mesh) -> Trimesh:
    """Return a trimesh.Trimesh, nothing merged or reordered.

    A texture of one image is kept, and no colours beside it; vertices on its seams are duplicated, for the
    class holds one texture coordinate a vertex. Several images do not fit: use `with_vertex_colors` first.
    """
    from trimesh import Trimesh

    if mesh.texture is not None and len(mesh.texture.images) == 1:
        return _textured_trimesh(mesh, mesh.texture)
    return Trimesh(
        mesh.vertices,
        mesh.triangles,
        vertex_colors=mesh.colors,
        # It asks how long they are at most, which none has an answer to.
        vertex_normals=mesh.normals if len(mesh.vertices) else None,
        process=False,
    )


def _textured_trimesh(mesh: Mesh, texture: Texture) -> Trimesh:
    import trimesh
    from PIL.Image import fromarray

    uvs = texture.uvs.reshape(-1, 2)
    corners = mesh.triangles.reshape(-1)
    wedges, first, wedge_of_corner = np.unique(
        np.column_stack((corners, uvs)), axis=0, return_index=True, return_inverse=True
    )
    source = corners[first]
    visual: Any = trimesh.visual
    material = visual.material.SimpleMaterial(image=fromarray(texture.images[0].pixels))
    return trimesh.Trimesh(
        mesh.vertices[source],
        wedge_of_corner.reshape(-1, 3),
        vertex_normals=None if mesh.normals is None else mesh.normals[source],
        visual=visual.TextureVisuals(uv=wedges[:, 1:], material=material),
        process=False,
    )


def with_vertex_colors(mesh: Mesh) -> Mesh:
    """Return the mesh with its texture turned into vertex colours; unchanged if it has no texture.

    Each textured corner samples its image bilinearly, beyond its edges as the material says, times the base
    colour; a vertex takes the mean of its corners, which differ along seams only. Where there is no image,
    vertices keep their colour, else take the base colour of their material, else become grey. A mesh
    whose materials say nothing of colours gets none. A note names an image that cannot be decoded.
    """
    texture = mesh.texture
    if texture is None:
        return mesh
    count = len(mesh.vertices)
    sums, corners_of = np.zeros((count, 3)), np.zeros(count)
    notes = list(mesh.notes)
    has_uvs = texture.has_uvs()
    for number, material in enumerate(texture.materials):
        chosen = texture.material_ids == number
        for rows, image in ((chosen & has_uvs, material.image), (chosen & ~has_uvs, None)):
            samples = _corner_colors(material, image, texture.uvs[rows].reshape(-1, 2), notes)
            if samples is None or (image is None and mesh.colors is not None):
                continue
            corners = mesh.triangles[rows].reshape(-1)
            corners_of += np.bincount(corners, minlength=count)
            for channel in range(3):
                sums[:, channel] += np.bincount(corners, samples[:, channel], minlength=count)
    colored = corners_of > 0
    colors = mesh.colors
    if colored.any():
        colors = np.full((count, 3), _UNTEXTURED, np.uint8) if colors is None else colors.copy()
        colors[colored] = np.rint(sums[colored] / corners_of[colored, None]).astype(np.uint8)
    return mesh.with_(colors=colors, texture=None, notes=tuple(notes))


def _corner_colors(
    material: Material, image: Image | None, uvs: NDArray[np.float64], notes: list[str]
) -> NDArray[np.floating] | None:
    """Return (k, 3) colours 0..255 at texture coordinates (k, 2); None if nothing is known of them."""
    if image is not None and len(uvs):
        try:
            return tinted(sampled(image.pixels, uvs, material.wrap), material)
        except MeshError as error:
            notes.append(str(error))
    if material.base_color is None:
        return None
    return np.tile(np.array(material.base_color[:3]) * 255, (len(uvs), 1))
