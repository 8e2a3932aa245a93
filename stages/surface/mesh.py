"""The mesh class that all stages exchange, and its validation."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.files.image_bytes import encode_png
from scanloom.stages.printing import format_count, format_extent, format_line, render_table
from scanloom.stages.surface.codes import MESH_INDEX_OUT_OF_RANGE
from scanloom.stages.surface.finite_check import FLOAT32_MAX, require_finite
from scanloom.stages.surface.texture import Image, Material, Texture, select_rows, validate_texture
from scanloom.stages.surface.thumbnail import render_thumbnail

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import MeshKeywords

__all__ = [
    "Colors",
    "Image",
    "Material",
    "Mesh",
    "Texture",
    "Triangles",
    "Vertices",
    "require_writable",
    "validate_mesh",
]

Vertices = NDArray[np.float64]
Triangles = NDArray[np.int32]
Colors = NDArray[np.uint8]

_PROCESSING_REMEDY = "remove or repair these before processing."
# Shared with writers that have no Mesh, such as level-of-detail files.
WRITING_REMEDY = "nothing is written. Remove or repair these first."
# Tolerance of the length of `up`; a vector outside it is normalized.
_UNIT_LENGTH_TOLERANCE = 1e-12


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangle mesh with optional colours, normals, texture and parts.

    Treat it as immutable: functions return a new mesh. A point cloud is a mesh without triangles; stages that
    do not support clouds raise an error.

    Attributes
    ----------
    vertices : (n, 3) float64, metres.
    triangles : (m, 3) int32, counter-clockwise seen from outside.
    colors : (n, 3) uint8 RGB, or None.
    intensity_max : if the colours are the grey intensity of a PLY file, the intensity at level 255; else
        None. Files in other formats, and the results of most functions, have grey colours instead.
    normals : (n, 3) float64 unit vertex normals, or None.
    texture : texture coordinates per corner and a material per triangle (see Texture), or None.
    corner_normals : (m, 3, 3) float64 unit normals per corner, or None. Present if the corners of a vertex
        differ,
        as along sharp edges; 0 for a corner without a normal. `normals` is then None or holds means.
    part_ids : (m,) int32 index in `part_names`, -1 for no part; or None. Parts are OBJ objects and groups,
        and
        glTF nodes.
    part_names : names of the parts; not necessarily unique.
    diagnostics : data that the file reader or a conversion changed or dropped.
    up : (3,) unit vector of the up direction, or None if unknown. Positions are not rotated to it. glTF files
        (y-up by definition) are written with a rotation, which reading undoes.
    """

    vertices: Vertices
    triangles: Triangles
    colors: Colors | None = None
    normals: NDArray[np.float64] | None = None
    texture: Texture | None = None
    corner_normals: NDArray[np.float64] | None = None
    part_ids: NDArray[np.int32] | None = None
    part_names: tuple[str, ...] = ()
    diagnostics: tuple[Diagnostic, ...] = field(default=())
    up: tuple[float, float, float] | None = None
    intensity_max: float | None = None

    def __repr__(self) -> str:
        return format_line(self, self._facts())

    _repr_html_ = render_table

    def _facts(self) -> tuple[str, ...]:
        images = 0 if self.texture is None else len(self.texture.images)
        return (
            format_count(len(self.triangles), "triangle")
            or format_count(len(self.vertices), "point")
            or "no triangles",
            "" if self.colors is None else "colours",
            "" if self.texture is None else format_count(images, "texture image") or "texture without images",
            format_count(0 if self.part_ids is None else len(self.part_names), "part"),
            format_extent(self.vertices),
            format_count(len(self.diagnostics), "diagnostic"),
        )

    def _thumbnail(self) -> bytes | None:
        picture = render_thumbnail(self.vertices, self.triangles, self.colors, self.texture)
        return None if picture is None else encode_png(picture)

    def with_(self, **changes: Unpack[MeshKeywords]) -> Mesh:
        """Return a copy with some fields replaced; use `replace_triangles` for new triangles."""
        return replace(self, **changes)

    def with_triangles(
        self,
        triangles: Triangles,
        source: NDArray[Any],
        *,
        uvs: NDArray[np.float64] | None = None,
        corner_normals: NDArray[np.float64] | None = None,
    ) -> Mesh:
        """Return a copy with other triangles; material, part and corners come from source triangles.

        Parameters
        ----------
        triangles : (k, 3) int32.
        source : (k,) source triangle of each new triangle, -1 for none: no material, texture coordinates or
            part. Or a
            boolean mask (m,) of the triangles to keep.
        uvs : (k, 3, 2), if the corners differ from the source's; ignored for a mesh without texture.
        corner_normals : (k, 3, 3), if the corners differ from the source's; ignored for a mesh without corner
            normals.
            By default, triangles without a source get 0.
        """
        texture, part_ids = self.texture, self.part_ids
        if self.corner_normals is None:
            corner_normals = None
        elif corner_normals is None:
            corner_normals = select_rows(self.corner_normals, source, 0.0)
        return replace(
            self,
            triangles=triangles,
            texture=None if texture is None else texture.select_triangles(source, uvs),
            corner_normals=corner_normals,
            part_ids=None if part_ids is None else select_rows(part_ids, source, -1),
        )


def validate_mesh(mesh: Mesh, where: str = "mesh") -> Mesh:
    """Validate an external mesh and convert its arrays to the documented dtypes.

    Parameters
    ----------
    mesh : mesh with arrays of any numeric type.
    where : file or argument, for messages.

    Raises
    ------
    MeshError
        If a shape is wrong, a value is not finite, or an index is out of range; names the first such row.
    """
    vertices = _validate_array(mesh.vertices, np.float64, (3,), "vertices", where)
    triangles = _validate_indices(mesh.triangles, len(vertices), where)
    colors = mesh.colors
    if colors is not None:
        colors = _validate_array(colors, np.uint8, (3,), "colors", where)
        _require_count(colors, len(vertices), "colors", where)
    normals = mesh.normals
    if normals is not None:
        normals = _validate_array(normals, np.float64, (3,), "normals", where)
        _require_count(normals, len(vertices), "normals", where)
    texture, corner_normals, part_ids = mesh.texture, mesh.corner_normals, mesh.part_ids
    require_finite([("vertex", vertices)], where, _PROCESSING_REMEDY)
    if texture is not None:
        texture = validate_texture(texture, len(triangles), where)
    if corner_normals is not None:
        corner_normals = _validate_array(corner_normals, np.float64, (3, 3), "corner normals", where)
        _require_count(corner_normals, len(triangles), "corner normals", where, "triangles")
    require_finite(
        [("normal", normals), ("corner normals of triangle", corner_normals)], where, _PROCESSING_REMEDY
    )
    if part_ids is not None:
        part_ids = _validate_part_ids(part_ids, len(triangles), len(mesh.part_names), where)
    if mesh.intensity_max is not None and not 0 < mesh.intensity_max < np.inf:
        raise MeshError(
            USAGE_ARGUMENT_INVALID,
            "intensity_max is {intensity_max}; a positive number is expected.",
            where,
            intensity_max=mesh.intensity_max,
        )
    return mesh.with_(
        vertices=vertices,
        triangles=triangles,
        colors=colors,
        normals=normals,
        texture=texture,
        corner_normals=corner_normals,
        part_ids=part_ids,
        up=None if mesh.up is None else _validate_direction(mesh.up, where),
    )


def require_writable(mesh: Mesh, path: Path | str, *, single_precision: bool = False) -> None:
    """Refuse to write a mesh with non-finite coordinates.

    Every mesh writer calls this function before writing.

    Parameters
    ----------
    mesh : mesh to write.
    path : output file, for messages.
    single_precision : True if positions and normals must fit in single precision. Writers clip texture
        coordinates themselves.

    Raises
    ------
    MeshError
        Names the first invalid vertex, normal or triangle.
    """
    uvs = None if mesh.texture is None else mesh.texture.uvs
    require_finite([("texture coordinates of triangle", uvs)], path, WRITING_REMEDY)
    arrays = (
        ("vertex", mesh.vertices),
        ("normal", mesh.normals),
        ("corner normals of triangle", mesh.corner_normals),
    )
    if single_precision:
        require_finite(arrays, path, f"{WRITING_REMEDY} PLY and OBJ hold larger numbers.", FLOAT32_MAX)
    else:
        require_finite(arrays, path, WRITING_REMEDY)


def _validate_direction(up: Any, where: str) -> tuple[float, float, float]:
    array = np.asarray(up)
    is_vector = array.shape == (3,) and array.dtype.kind in "iuf"
    length = float(np.linalg.norm(array)) if is_vector else 0.0
    if not 0 < length < np.inf:
        raise MeshError(
            USAGE_ARGUMENT_INVALID,
            "up is {up}; three numbers, not all of them 0, are expected.",
            where,
            up=up,
        )
    if abs(length - 1) > _UNIT_LENGTH_TOLERANCE:
        array = array / length
    x, y, z = array.tolist()
    return x, y, z


def _validate_part_ids(data: Any, triangle_count: int, part_count: int, where: str) -> NDArray[np.int32]:
    array = np.asarray(data)
    if array.shape != (triangle_count,) or array.dtype.kind not in "iu":
        raise MeshError(
            USAGE_ARGUMENT_INVALID,
            "there are {array_size} part indices for {triangle_count} triangles.",
            where,
            array_size=array.size,
            triangle_count=triangle_count,
        )
    if ((array < -1) | (array >= part_count)).any():
        raise MeshError(
            USAGE_ARGUMENT_INVALID,
            "a part index is beyond the {part_count} part names.",
            where,
            part_count=part_count,
        )
    return np.ascontiguousarray(array, np.int32)


def _validate_array(data: Any, dtype: Any, columns: tuple[int, ...], name: str, where: str) -> Any:
    array = np.asarray(data)
    if array.ndim != 1 + len(columns) or array.shape[1:] != columns:
        wanted = "n × " + " × ".join(map(str, columns))
        raise MeshError(
            USAGE_ARGUMENT_INVALID,
            "{name} have shape {array_shape}; {wanted} is expected.",
            where,
            name=name,
            array_shape=array.shape,
            wanted=wanted,
        )
    if dtype is np.uint8 and array.dtype != np.uint8:
        raise MeshError(
            USAGE_ARGUMENT_INVALID,
            "{name} are {array_dtype}; 8-bit values (uint8) are expected.",
            where,
            name=name,
            array_dtype=array.dtype,
        )
    if array.dtype.kind not in "iuf":
        raise MeshError(
            USAGE_ARGUMENT_INVALID,
            "{name} are {array_dtype}; numbers are expected.",
            where,
            name=name,
            array_dtype=array.dtype,
        )
    return np.ascontiguousarray(array, dtype=dtype)


def _validate_indices(data: Any, vertex_count: int, where: str) -> Triangles:
    array = np.asarray(data)
    if array.size == 0:
        return np.zeros((0, 3), np.int32)
    if array.ndim != 2 or array.shape[1] != 3:
        raise MeshError(
            USAGE_ARGUMENT_INVALID,
            "triangles have shape {array_shape}; m × 3 is expected.",
            where,
            array_shape=array.shape,
        )
    if array.dtype.kind not in "iu":
        raise MeshError(
            USAGE_ARGUMENT_INVALID,
            "triangles are {array_dtype}; whole numbers are expected.",
            where,
            array_dtype=array.dtype,
        )
    if array.min() < 0 or array.max() >= vertex_count:
        bad = np.flatnonzero(((array < 0) | (array >= vertex_count)).any(axis=1))
        row = array[bad[0]].tolist()
        raise MeshError(
            MESH_INDEX_OUT_OF_RANGE,
            (
                "triangle {bad} uses vertices {row}, but there are only {vertex_count} "
                "({bad_count} such triangles); the file is damaged or cut short."
            ),
            where,
            bad=bad[0],
            row=row,
            vertex_count=vertex_count,
            bad_count=len(bad),
        )
    return np.ascontiguousarray(array, dtype=np.int32)


def _require_count(array: NDArray[Any], count: int, name: str, where: str, of: str = "vertices") -> None:
    if len(array) != count:
        raise MeshError(
            USAGE_ARGUMENT_INVALID,
            "there are {array_count} {name} for {count} {of}.",
            where,
            array_count=len(array),
            name=name,
            count=count,
            of=of,
        )
