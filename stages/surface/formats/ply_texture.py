"""Materials, texture coordinates and parts in PLY files.

PLY has no standard for them. As in MeshLab's files, comments `TextureFile NAME` name the images, and faces
have a list `texcoord` and an image index `texnumber`. Everything else uses scanloom's own comments and face
properties: `comment Material {JSON}` with `material_index`, `comment Part NAME` with `part_index`, and
`get_corner_normals`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.files.documents import parse_short_integer
from scanloom.stages.surface.codes import MESH_TEXTURE_DAMAGED
from scanloom.stages.surface.formats.ply_format import ListColumn, PlyHeader, PlyTable
from scanloom.stages.surface.formats.texture_files import read_texture, write_images
from scanloom.stages.surface.texture import WRAP_MODES, Image, Material, Texture

_IMAGE_KEYWORD = "TextureFile"
_MATERIAL_KEYWORD = "Material"
_PART_KEYWORD = "Part"
_VERTEX_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))

Ids = NDArray[np.int32]


def read_ply_texture(
    header: PlyHeader,
    vertex: PlyTable,
    face: PlyTable,
    triangles: Ids,
    corners: NDArray[np.int64],
    source: NDArray[np.int64],
    path: Path,
) -> Texture | None:
    """Read the texture; None if the file has neither texture coordinates nor materials.

    `corners` (m, 3) and `source` (m,) come from split_polygons; they are empty for triangle strips.
    """
    uvs = _read_corner_uvs(vertex, face, triangles, corners)
    names = _find_comments(header, _IMAGE_KEYWORD)
    if uvs is None and not (names or _find_comments(header, _MATERIAL_KEYWORD)):
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
    materials = _read_materials(header, images)
    ids = _read_triangle_index(face, "material_index", source, len(materials), count)
    if ids is None:
        materials = tuple(Material(name, image) for name, image in images)
        ids = _read_triangle_index(face, "texnumber", source, len(materials), count)
    if ids is None:
        ids = np.full(count, 0 if materials else -1, np.int32)
    return Texture(uvs, ids, materials)


def _read_corner_uvs(
    vertex: PlyTable, face: PlyTable, triangles: Ids, corners: NDArray[np.int64]
) -> NDArray[np.float64] | None:
    per_corner = face.get("texcoord")
    polygons = face.get("vertex_indices", face.get("vertex_index"))
    if isinstance(per_corner, ListColumn) and isinstance(polygons, ListColumn):
        if len(corners) == 0 or len(per_corner.lengths) != len(polygons.lengths):
            return None
        if (per_corner.lengths == 2 * polygons.lengths).all():
            return per_corner.values.reshape(-1, 2).astype(np.float64)[corners]
        return _fill_missing_uvs(per_corner, polygons, corners)
    for s, t in _VERTEX_UV_NAMES:
        columns = vertex.get(s), vertex.get(t)
        if isinstance(columns[0], np.ndarray) and isinstance(columns[1], np.ndarray) and len(triangles):
            return np.stack(columns, axis=1).astype(np.float64)[triangles]  # type: ignore[arg-type]
    return None


def _fill_missing_uvs(
    per_corner: ListColumn, polygons: ListColumn, corners: NDArray[np.int64]
) -> NDArray[np.float64] | None:
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


def _find_comments(header: PlyHeader, word: str) -> list[str]:
    pairs = (comment.split(None, 1) for comment in header.comments)
    return [pair[1] for pair in pairs if len(pair) == 2 and pair[0] == word]


def _read_triangle_index(
    face: PlyTable, name: str, source: NDArray[np.int64], index_limit: int, triangle_count: int
) -> Ids | None:
    """Return a face property as index (m,) per triangle.

    An index outside 0 to `index_limit` - 1 becomes -1.
    """
    numbers = face.get(name)
    if not isinstance(numbers, np.ndarray) or len(source) != triangle_count:
        return None
    ids = numbers[source]
    return np.where((ids >= 0) & (ids < index_limit), ids, -1).astype(np.int32)


def _read_materials(header: PlyHeader, images: list[tuple[str, Image | None]]) -> tuple[Material, ...]:
    return tuple(_parse_material(text, images) for text in _find_comments(header, _MATERIAL_KEYWORD))


def _parse_material(text: str, images: list[tuple[str, Image | None]]) -> Material:
    try:
        return _convert_material(json.loads(text, parse_int=parse_short_integer), images)
    except (ValueError, TypeError, AttributeError, OverflowError, RecursionError):
        return Material()


def _convert_material(tree: Any, images: list[tuple[str, Image | None]]) -> Material:
    number, color, wrap = tree.get("image"), tree.get("base_color"), tree.get("wrap", ("repeat", "repeat"))
    image = images[number][1] if isinstance(number, int) and 0 <= number < len(images) else None
    if color is not None:
        red, green, blue, alpha = (min(max(float(value), 0.0), 1.0) for value in color)
        color = (red, green, blue, alpha)
    along_u, along_v = (way if way in WRAP_MODES else "repeat" for way in wrap)
    return Material(str(tree.get("name", "")), image, color, (along_u, along_v))


def read_parts(
    header: PlyHeader, face: PlyTable, source: NDArray[np.int64], count: int
) -> tuple[Ids | None, Any]:
    """Read the part index (m,) of each of `triangle_count` triangles, and the part names."""
    names = tuple(_unquote(text) for text in _find_comments(header, _PART_KEYWORD))
    ids = _read_triangle_index(face, "part_index", source, len(names), count)
    return ids, () if ids is None else names


def _unquote(text: str) -> str:
    try:
        return str(json.loads(text))
    except (ValueError, RecursionError):
        return text


def read_corner_normals(face: PlyTable, corners: NDArray[np.int64]) -> NDArray[np.float64] | None:
    """Read corner normals (m, 3, 3).

    The result is None unless every polygon has three finite numbers per corner.
    """
    lists, polygons = face.get("corner_normals"), face.get("vertex_indices")
    if not isinstance(lists, ListColumn) or not isinstance(polygons, ListColumn) or len(corners) == 0:
        return None
    if len(lists.lengths) != len(polygons.lengths) or not (lists.lengths == 3 * polygons.lengths).all():
        return None
    normals = lists.values.reshape(-1, 3).astype(np.float64)[corners]
    return normals if np.isfinite(normals).all() else None


def write_texture_images(path: Path, texture: Texture) -> tuple[list[str], Ids, bool]:
    """Write the images and return the comments that describe the texture.

    Returns
    -------
    comments : image names, and materials if the images alone do not describe them.
    texnumber : (m,) image index of each triangle, -1 for none.
    has_materials : True if the file also needs the face property `material_index`.
    """
    files = write_images(path, texture.images)
    number_of = {key: number for number, key in enumerate(files)}
    image_of_material = [number_of.get(id(material.image), -1) for material in texture.materials]
    texnumber = np.array([*image_of_material, -1], np.int32)[texture.material_ids]
    comments = [f"{_IMAGE_KEYWORD} {name}" for name in files.values()]
    is_plain = image_of_material == list(range(len(image_of_material))) and all(
        material.base_color is None and material.wrap == ("repeat", "repeat") and material.name in ("", name)
        for material, name in zip(texture.materials, files.values(), strict=True)
    )
    if not is_plain:
        comments += [
            f"{_MATERIAL_KEYWORD} {_describe_material(material, number)}"
            for material, number in zip(texture.materials, image_of_material, strict=True)
        ]
    return comments, texnumber, not is_plain


def _describe_material(material: Material, image: int) -> str:
    tree: dict[str, Any] = {"name": material.name}
    if image >= 0:
        tree["image"] = image
    if material.base_color is not None:
        tree["base_color"] = [float(value) for value in material.base_color]
    if material.wrap != ("repeat", "repeat"):
        tree["wrap"] = material.wrap
    return json.dumps(tree)


def make_part_comments(names: tuple[str, ...]) -> list[str]:
    """Return the header comments that name the parts."""
    return [f"{_PART_KEYWORD} {json.dumps(name)}" for name in names]
