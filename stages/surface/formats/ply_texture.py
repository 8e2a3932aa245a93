"""Materials, texture coordinates and parts in PLY files.

PLY has no standard for them. As in MeshLab's files, comments `TextureFile NAME` name the images, and faces
have a list `texcoord` and an image index `texnumber`. Everything else uses scanloom's own comments and face
properties: `comment Material {JSON}` with `material_index`, `comment Part NAME` with `part_index`, and
`corner_normals`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.surface.codes import MESH_TEXTURE_DAMAGED
from scanloom.stages.surface.formats.ply_format import Header, Lists, Table
from scanloom.stages.surface.formats.textures import read_texture, write_images
from scanloom.stages.surface.texture import WRAPS, Image, Material, Texture

_IMAGE = "TextureFile"
_MATERIAL = "Material"
_PART = "Part"
_VERTEX_UVS = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))

Ids = NDArray[np.int32]


def read_texture_of_ply(
    header: Header,
    vertex: Table,
    face: Table,
    triangles: Ids,
    corners: NDArray[np.int64],
    source: NDArray[np.int64],
    path: Path,
) -> Texture | None:
    """Read the texture; None if the file has neither texture coordinates nor materials.

    `corners` (m, 3) and `source` (m,) come from split_polygons; they are empty for triangle strips.
    """
    uvs = _corner_uvs(vertex, face, triangles, corners)
    names = _comments(header, _IMAGE)
    if uvs is None and not (names or _comments(header, _MATERIAL)):
        return None
    count = len(triangles)
    if uvs is None:
        uvs = np.zeros((count, 3, 2))
    finite = np.isfinite(uvs).all(axis=(1, 2))
    if not finite.all():
        lost = np.count_nonzero(~finite)
        emit(
            MESH_TEXTURE_DAMAGED.warning(
                "{count:,} triangles lose their texture: their texture coordinates are not finite",
                path,
                count=lost,
            )
        )
        uvs[~finite] = 0
    images = [(name, read_texture(path, name)) for name in names]
    materials = _own_materials(header, images)
    ids = _of_triangles(face, "material_index", source, len(materials), count)
    if ids is None:
        materials = tuple(Material(name, image) for name, image in images)
        ids = _of_triangles(face, "texnumber", source, len(materials), count)
    if ids is None:
        ids = np.full(count, 0 if materials else -1, np.int32)
    return Texture(uvs, ids, materials)


def _corner_uvs(
    vertex: Table, face: Table, triangles: Ids, corners: NDArray[np.int64]
) -> NDArray[np.float64] | None:
    per_corner = face.get("texcoord")
    polygons = face.get("vertex_indices", face.get("vertex_index"))
    if isinstance(per_corner, Lists) and isinstance(polygons, Lists):
        if len(corners) == 0 or len(per_corner.lengths) != len(polygons.lengths):
            return None
        if (per_corner.lengths == 2 * polygons.lengths).all():
            return per_corner.values.reshape(-1, 2).astype(np.float64)[corners]
        return _some_uvs(per_corner, polygons, corners)
    for s, t in _VERTEX_UVS:
        columns = vertex.get(s), vertex.get(t)
        if isinstance(columns[0], np.ndarray) and isinstance(columns[1], np.ndarray) and len(triangles):
            return np.stack(columns, axis=1).astype(np.float64)[triangles]  # type: ignore[arg-type]
    return None


def _some_uvs(per_corner: Lists, polygons: Lists, corners: NDArray[np.int64]) -> NDArray[np.float64] | None:
    """Return texture coordinates (m, 3, 2) if only some faces have them.

    The others get 0.
    """
    whole = per_corner.lengths == 2 * polygons.lengths
    if not whole.any():
        return None
    given = np.repeat(whole, per_corner.lengths)
    uvs = np.zeros((int(polygons.lengths.sum()), 2))
    uvs[np.repeat(whole, polygons.lengths)] = per_corner.values[given].reshape(-1, 2)
    return uvs[corners]


def _comments(header: Header, word: str) -> list[str]:
    pairs = (comment.split(None, 1) for comment in header.comments)
    return [pair[1] for pair in pairs if len(pair) == 2 and pair[0] == word]


def _of_triangles(face: Table, name: str, source: NDArray[np.int64], least: int, count: int) -> Ids | None:
    """Return a face property as index (m,) per triangle.

    An index outside 0 to `least` - 1 becomes -1.
    """
    numbers = face.get(name)
    if not isinstance(numbers, np.ndarray) or len(source) != count:
        return None
    ids = numbers[source]
    return np.where((ids >= 0) & (ids < least), ids, -1).astype(np.int32)


def _own_materials(header: Header, images: list[tuple[str, Image | None]]) -> tuple[Material, ...]:
    return tuple(_material(text, images) for text in _comments(header, _MATERIAL))


def _material(text: str, images: list[tuple[str, Image | None]]) -> Material:
    try:
        return _described_material(json.loads(text), images)
    except (ValueError, TypeError, AttributeError, OverflowError, RecursionError):
        return Material()


def _described_material(tree: Any, images: list[tuple[str, Image | None]]) -> Material:
    number, color, wrap = tree.get("image"), tree.get("base_color"), tree.get("wrap", ("repeat", "repeat"))
    image = images[number][1] if isinstance(number, int) and 0 <= number < len(images) else None
    if color is not None:
        red, green, blue, alpha = (min(max(float(value), 0.0), 1.0) for value in color)
        color = (red, green, blue, alpha)
    along_u, along_v = (way if way in WRAPS else "repeat" for way in wrap)
    return Material(str(tree.get("name", "")), image, color, (along_u, along_v))


def read_parts(header: Header, face: Table, source: NDArray[np.int64], count: int) -> tuple[Ids | None, Any]:
    """Read the part index (m,) of each of `count` triangles, and the part names."""
    names = tuple(_unquoted(text) for text in _comments(header, _PART))
    ids = _of_triangles(face, "part_index", source, len(names), count)
    return ids, () if ids is None else names


def _unquoted(text: str) -> str:
    try:
        return str(json.loads(text))
    except (ValueError, RecursionError):
        return text


def read_corner_normals(face: Table, corners: NDArray[np.int64]) -> NDArray[np.float64] | None:
    """Read corner normals (m, 3, 3).

    The result is None unless every polygon has three finite numbers per corner.
    """
    lists, polygons = face.get("corner_normals"), face.get("vertex_indices")
    if not isinstance(lists, Lists) or not isinstance(polygons, Lists) or len(corners) == 0:
        return None
    if len(lists.lengths) != len(polygons.lengths) or not (lists.lengths == 3 * polygons.lengths).all():
        return None
    normals = lists.values.reshape(-1, 3).astype(np.float64)[corners]
    return normals if np.isfinite(normals).all() else None


def texture_comments(path: Path, texture: Texture) -> tuple[list[str], Ids, bool]:
    """Write the images and return the comments that describe the texture.

    Returns
    -------
    comments : image names, and materials if the images alone do not describe them.
    texnumber : (m,) image index of each triangle, -1 for none.
    has_materials : True if the file also needs the face property `material_index`.
    """
    files = write_images(path, texture.images)
    number_of = {key: number for number, key in enumerate(files)}
    of_material = [number_of.get(id(material.image), -1) for material in texture.materials]
    texnumber = np.array([*of_material, -1], np.int32)[texture.material_ids]
    comments = [f"{_IMAGE} {name}" for name in files.values()]
    plain = of_material == list(range(len(of_material))) and all(
        material.base_color is None and material.wrap == ("repeat", "repeat") and material.name in ("", name)
        for material, name in zip(texture.materials, files.values(), strict=True)
    )
    if not plain:
        comments += [
            f"{_MATERIAL} {_described(material, number)}"
            for material, number in zip(texture.materials, of_material, strict=True)
        ]
    return comments, texnumber, not plain


def _described(material: Material, image: int) -> str:
    tree: dict[str, Any] = {"name": material.name}
    if image >= 0:
        tree["image"] = image
    if material.base_color is not None:
        tree["base_color"] = [float(value) for value in material.base_color]
    if material.wrap != ("repeat", "repeat"):
        tree["wrap"] = material.wrap
    return json.dumps(tree)


def part_comments(names: tuple[str, ...]) -> list[str]:
    """Return the header comments that name the parts."""
    return [f"{_PART} {json.dumps(name)}" for name in names]
