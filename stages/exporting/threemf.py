"""3MF writer: millimetres, z-up, one object per part, with vertex colours or textures.

Follows the 3MF Consortium, "3MF Core Specification" 1.3 and "Materials and Properties Extension" 1.2.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.mesh import Mesh, require_writable
from scanloom.stages.surface.texture import Image, Material, Texture
from scanloom.stages.surface.welding import find_first_equal_rows

_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_MATERIAL = "http://schemas.microsoft.com/3dmanufacturing/material/2015/02"
_RELATIONSHIPS = "http://schemas.openxmlformats.org/package/2006/relationships"
_MODEL_TYPE = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_TEXTURE_TYPE = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dtexture"
_MODEL = "3D/3dmodel.model"
_XML = '<?xml version="1.0" encoding="UTF-8"?>\n'
_IMAGE_EXTENSIONS = {"image/jpeg": "jpeg", "image/png": "png"}
_TILE_STYLES = {"repeat": "wrap", "clamp": "clamp", "mirror": "mirror"}
# Fixed, so that equal meshes give equal files.
_TIMESTAMP = (1980, 1, 1, 0, 0, 0)


class _Properties(NamedTuple):
    """Property group of each triangle (m,), 0 for none, and the property of each corner (m, 3)."""

    groups: Ids
    indices: Ids


def write_3mf(path: Path, mesh: Mesh) -> None:
    """Write a mesh, in millimetres, as a 3MF file.

    Vertices at equal positions are joined, because a 3MF object must be closed. Triangles with two corners
    at one position are left out, because the format does not allow them.

    Raises
    ------
    MeshError
        If coordinates are not finite or exceed single precision.
    StageError
        If the file cannot be written.
    """
    require_writable(mesh, path, single_precision=True)
    images = () if mesh.texture is None else mesh.texture.images
    names = [f"3D/Textures/{row}.{_get_extension(image)}" for row, image in enumerate(images, 1)]
    with write_file_atomically(path) as draft, zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as archive:
        _add(archive, "[Content_Types].xml", _format_content_types())
        _add(archive, "_rels/.rels", _format_relationships([(f"/{_MODEL}", _MODEL_TYPE)]))
        _add(archive, _MODEL, "".join(_format_model(mesh, images, names)))
        if names:
            links = _format_relationships([(f"/{name}", _TEXTURE_TYPE) for name in names])
            _add(archive, "3D/_rels/3dmodel.model.rels", links)
        for name, image in zip(names, images, strict=True):
            data = (
                image.file_bytes if image.mime in _IMAGE_EXTENSIONS else Image(given=image.pixels).file_bytes
            )
            _add(archive, name, data)


def _add(archive: zipfile.ZipFile, name: str, content: str | bytes) -> None:
    entry = zipfile.ZipInfo(name, _TIMESTAMP)
    entry.compress_type = zipfile.ZIP_DEFLATED
    archive.writestr(entry, content)


def _get_extension(image: Image) -> str:
    return _IMAGE_EXTENSIONS.get(image.mime, "png")


def _format_content_types() -> str:
    types = {
        "rels": "application/vnd.openxmlformats-package.relationships+xml",
        "model": "application/vnd.ms-package.3dmanufacturing-3dmodel+xml",
        "png": "image/png",
        "jpeg": "image/jpeg",
    }
    rows = "".join(f'<Default Extension="{end}" ContentType="{kind}"/>' for end, kind in types.items())
    return f'{_XML}<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">{rows}</Types>'


def _format_relationships(targets: Iterable[tuple[str, str]]) -> str:
    rows = "".join(
        f'<Relationship Target="{target}" Id="rel{row}" Type="{kind}"/>'
        for row, (target, kind) in enumerate(targets, 1)
    )
    return f'{_XML}<Relationships xmlns="{_RELATIONSHIPS}">{rows}</Relationships>'


def _format_model(mesh: Mesh, images: tuple[Image, ...], names: list[str]) -> Iterator[str]:
    yield f'{_XML}<model unit="millimeter" xml:lang="en-US" xmlns="{_CORE}" xmlns:m="{_MATERIAL}"><resources>'
    resources, properties = _collect_properties(mesh, images, names)
    yield from resources
    part_ids = np.zeros(len(mesh.triangles), np.int64) if mesh.part_ids is None else mesh.part_ids
    first_object = len(resources) + 1
    points, triangles = _join_equal_positions(mesh)
    a, b, c = triangles.T
    is_allowed = (a != b) & (b != c) & (c != a)
    parts = np.unique(part_ids[is_allowed]).tolist()
    for row, part in enumerate(parts):
        rows = np.flatnonzero(is_allowed & (part_ids == part))
        yield from _format_object(points, triangles, rows, properties, first_object + row)
    items = "".join(f'<item objectid="{first_object + row}"/>' for row in range(len(parts)))
    yield f"</resources><build>{items}</build></model>"


def _collect_properties(
    mesh: Mesh, images: tuple[Image, ...], names: list[str]
) -> tuple[list[str], _Properties]:
    """Return the resources of colours and textures, numbered from 1, and the properties of triangles."""
    resources: list[str] = []
    groups = np.zeros(len(mesh.triangles), np.int64)
    indices = np.zeros((len(mesh.triangles), 3), np.int64)
    if mesh.colors is not None:
        colors, color_ids = np.unique(mesh.colors, axis=0, return_inverse=True)
        resources.append(_format_colors(colors, 1))
        groups[:], indices[:] = 1, color_ids.reshape(-1)[mesh.triangles]
    if mesh.texture is None:
        return resources, _Properties(groups, indices)
    for number, material in enumerate(mesh.texture.materials):
        (rows,) = np.nonzero(mesh.texture.material_ids == number)
        if len(rows) == 0:
            continue
        if material.image is not None:
            row = next(i for i, image in enumerate(images) if image is material.image)
            texture_id = len(resources) + 1
            resources.append(_format_texture(material, names[row], images[row], texture_id))
            uvs, index = _list_uvs(mesh.texture, rows)
            resources.append(_format_uvs(uvs, texture_id + 1, texture_id))
            groups[rows], indices[rows] = texture_id + 1, index
        elif material.base_color is not None and mesh.colors is None:
            color = (255 * np.array([material.base_color[:3]])).round().astype(np.uint8)
            resources.append(_format_colors(color, len(resources) + 1))
            groups[rows], indices[rows] = len(resources), 0
    return resources, _Properties(groups, indices)


def _list_uvs(texture: Texture, rows: Ids) -> tuple[NDArray[np.float64], Ids]:
    """Return the distinct texture coordinates of triangles, and the index of each corner's."""
    uvs = texture.uvs[rows].reshape(-1, 2)
    first = find_first_equal_rows(list(uvs.T))
    used, index = np.unique(first, return_inverse=True)
    return uvs[used], index.reshape(-1, 3)


def _format_colors(colors: NDArray[np.uint8], number: int) -> str:
    rows = "".join(f'<m:color color="#{r:02X}{g:02X}{b:02X}"/>' for r, g, b in colors.tolist())
    return f'<m:colorgroup id="{number}">{rows}</m:colorgroup>'


def _format_texture(material: Material, name: str, image: Image, number: int) -> str:
    u, v = (_TILE_STYLES[mode] for mode in material.wrap)
    mime = f"image/{_get_extension(image)}"
    return (
        f'<m:texture2d id="{number}" path="/{name}" contenttype="{mime}" tilestyleu="{u}" tilestylev="{v}"/>'
    )


def _format_uvs(uvs: NDArray[np.float64], number: int, texture: int) -> str:
    rows = "".join(f'<m:tex2coord u="{u:.7g}" v="{v:.7g}"/>' for u, v in uvs.tolist())
    return f'<m:texture2dgroup id="{number}" texid="{texture}">{rows}</m:texture2dgroup>'


def _join_equal_positions(mesh: Mesh) -> tuple[NDArray[np.float32], Ids]:
    """Return the vertices in single precision, and triangles that use one vertex per position."""
    points = mesh.vertices.astype(np.float32)
    return points, find_first_equal_rows(list(points.T))[mesh.triangles]


def _format_object(
    points: NDArray[np.float32], triangles: Ids, rows: Ids, properties: _Properties, number: int
) -> Iterator[str]:
    used, index = np.unique(triangles[rows], return_inverse=True)
    yield f'<object id="{number}" type="model"><mesh><vertices>'
    # Nine digits hold single precision exactly.
    yield "".join(f'<vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>' for x, y, z in points[used].tolist())
    yield "</vertices><triangles>"
    groups, corners = properties.groups[rows].tolist(), properties.indices[rows].tolist()
    for (a, b, c), group, (p, q, r) in zip(index.reshape(-1, 3).tolist(), groups, corners, strict=True):
        own = f' pid="{group}" p1="{p}" p2="{q}" p3="{r}"' if group else ""
        yield f'<triangle v1="{a}" v2="{b}" v3="{c}"{own}/>'
    yield "</triangles></mesh></object>"
