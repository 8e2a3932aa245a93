"""Texture coordinates, materials and images of a mesh."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID
from scanloom.stages.diagnostics.errors import InputError, MeshError
from scanloom.stages.files.image_bytes import decode_image, encode_png
from scanloom.stages.files.image_headers import detect_image_type, read_header_size
from scanloom.stages.files.ktx2 import KTX2_MIME, decode_ktx2
from scanloom.stages.printing import format_count, format_line
from scanloom.stages.surface.codes import MESH_NOT_FINITE, MESH_TEXTURE_DAMAGED

Pixels = NDArray[np.uint8]

# Wrap modes of an image along u and v.
WRAP_MODES = ("repeat", "clamp", "mirror")


@dataclass(frozen=True, eq=False)
class Image:
    """A texture image: encoded file content, computed pixels, or both.

    Attributes
    ----------
    name : file name, possibly with spaces; empty for a new image.
    encoded : file content, which writers store unchanged.
    given : (h, w, 3) RGB or (h, w, 4) RGBA uint8, top row first, for an image that is not encoded yet.
    """

    name: str = ""
    encoded: bytes | None = field(default=None, repr=False)
    given: Pixels | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        size = "" if self.given is None else " × ".join(map(str, self.given.shape[1::-1])) + " px"
        held = "" if self.encoded is None else format_count(len(self.encoded), "byte")
        return format_line(self, (self.name, size, held))

    @cached_property
    def pixels(self) -> Pixels:
        """(h, w, 3) RGB or (h, w, 4) RGBA uint8, top row first; decoded on first access.

        Raises
        ------
        MeshError
            If the image cannot be decoded.
        """
        if self.given is not None:
            return self.given
        pixels = None
        if self.mime == KTX2_MIME and self.encoded is not None:
            try:
                pixels = decode_ktx2(self.encoded)
            except InputError as error:
                raise MeshError.from_diagnostic(error.diagnostic) from error
        elif self.encoded is not None:
            pixels = decode_image(self.encoded, self.name)
        if pixels is None:
            raise MeshError(
                MESH_TEXTURE_DAMAGED,
                "the texture image {detail} cannot be decoded.",
                detail=self.name or "without a name",
            )
        return pixels

    @cached_property
    def size(self) -> tuple[int, int] | None:
        """Width and height in texels from the image header, without decoding; None if unreadable."""
        if self.given is not None:
            return self.given.shape[1], self.given.shape[0]
        return None if self.encoded is None else read_header_size(self.encoded, self.name)

    @cached_property
    def file_bytes(self) -> bytes:
        """Content of the image file: the original bytes, or the pixels encoded as PNG."""
        return self.encoded if self.encoded is not None else encode_png(self.pixels)

    @property
    def extension(self) -> str:
        """File extension for `read_image_bytes`, such as ".png"; from `name` if the content is unknown."""
        return detect_image_type(self.encoded, self.name)[0] if self.encoded is not None else ".png"

    @property
    def mime(self) -> str:
        """Media type of `read_image_bytes`, such as "image/png"."""
        return detect_image_type(self.encoded, self.name)[1] if self.encoded is not None else "image/png"


@dataclass(frozen=True, eq=False)
class Material:
    """Base colour and image of triangles, with the original properties of the file.

    Attributes
    ----------
    name : name in the file; empty if it has none.
    image : base colour image, or None. Materials with the same image share the object.
    base_color : sRGB red, green, blue, and alpha, 0 to 1; None if the file states none. It multiplies the
        image in
        linear light, as in glTF. Kd of an MTL file is used only without an image, because programs disagree
        on its effect on an image.
    wrap : wrap modes of the image along u and v: "repeat", "clamp" or "mirror".
    kept : further properties, used only when writing the same file format.
    """

    name: str = ""
    image: Image | None = None
    base_color: tuple[float, float, float, float] | None = None
    wrap: tuple[str, str] = ("repeat", "repeat")
    kept: Any = None

    def __repr__(self) -> str:
        color = "" if self.base_color is None else f"colour {' '.join(f'{c:.3g}' for c in self.base_color)}"
        return format_line(self, (self.name, "" if self.image is None else repr(self.image), color))


@dataclass(frozen=True, eq=False)
class Texture:
    """Texture coordinates and materials of a mesh's triangles.

    Attributes
    ----------
    uvs : (m, 3, 2) float64 per corner, finite; (0, 0) is the lower left corner of the image. Values outside 0
        to 1
        follow the material's `wrap`. (0, 0) at all three corners means no coordinates.
    material_ids : (m,) int32 index in `materials`; -1 for none.
    materials : in file order.
    """

    uvs: NDArray[np.float64]
    material_ids: NDArray[np.int32]
    materials: tuple[Material, ...] = ()

    def __repr__(self) -> str:
        return format_line(
            self,
            (
                format_count(len(self.material_ids), "triangle"),
                format_count(len(self.materials), "material"),
                format_count(len(self.images), "image"),
            ),
        )

    @property
    def images(self) -> tuple[Image, ...]:
        """Images of all materials, each once."""
        found = {id(m.image): m.image for m in self.materials if m.image is not None}
        return tuple(found.values())

    def has_uvs(self) -> NDArray[np.bool_]:
        """Return a mask (m,) of the triangles with texture coordinates."""
        return np.asarray((self.uvs != 0).any(axis=(1, 2)))

    def select_triangles(self, source: NDArray[Any], uvs: NDArray[np.float64] | None = None) -> Texture:
        """Select the texture of chosen triangles.

        Parameters
        ----------
        source : row indices, -1 for a triangle without texture; or a boolean mask.
        uvs : coordinates of the chosen triangles, if they differ from the source's.
        """
        return replace(
            self,
            uvs=select_rows(self.uvs, source, 0.0) if uvs is None else uvs,
            material_ids=select_rows(self.material_ids, source, -1),
        )


def compute_signed_areas(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute signed areas (m,) of 2-D triangles (m, 3, 2); negative if clockwise."""
    (x1, y1), (x2, y2) = ((corners[:, i] - corners[:, 0]).T for i in (1, 2))
    return np.asarray((x1 * y2 - y1 * x2) / 2)


def select_rows(array: NDArray[Any], source: NDArray[Any], missing: float) -> NDArray[Any]:
    """Select rows by index or mask; index -1 gives `missing`."""
    chosen: NDArray[Any] = array[source]
    if source.dtype.kind == "i":
        chosen[source < 0] = missing
    return chosen


def validate_texture(texture: Texture, triangle_count: int, where: str) -> Texture:
    """Validate an external texture and convert its arrays to the documented dtypes.

    Raises
    ------
    MeshError
        If a shape or count is wrong, a coordinate is not finite, or a material index is out of range.
    """
    uvs, material_ids = np.asarray(texture.uvs), np.asarray(texture.material_ids)
    if uvs.ndim != 3 or uvs.shape[1:] != (3, 2) or uvs.dtype.kind not in "iuf":
        raise MeshError(
            USAGE_ARGUMENT_INVALID,
            (
                "texture coordinates are {uvs_dtype} of shape {uvs_shape}; numbers of shape "
                "m × 3 × 2 are expected."
            ),
            where,
            uvs_dtype=uvs.dtype,
            uvs_shape=uvs.shape,
        )
    if len(uvs) != triangle_count or material_ids.shape != (triangle_count,):
        raise MeshError(
            USAGE_ARGUMENT_INVALID,
            (
                "there are {uvs_count} × 3 texture coordinates and {material_ids_size} "
                "material indices for {triangle_count} triangles."
            ),
            where,
            uvs_count=len(uvs),
            material_ids_size=material_ids.size,
            triangle_count=triangle_count,
        )
    if not np.isfinite(uvs).all():
        bad = int(np.flatnonzero(~np.isfinite(uvs).all(axis=(1, 2)))[0])
        raise MeshError(
            MESH_NOT_FINITE,
            "texture coordinates of triangle {bad} are {uvs}, not finite",
            where,
            remedy="set them to 0 for a triangle without texture.",
            bad=bad,
            uvs=uvs[bad].tolist(),
        )
    count = len(texture.materials)
    if ((material_ids < -1) | (material_ids >= count)).any():
        raise MeshError(
            USAGE_ARGUMENT_INVALID,
            "a material index is beyond the {count} texture materials.",
            where,
            count=count,
        )
    return replace(
        texture,
        uvs=np.ascontiguousarray(uvs, np.float64),
        material_ids=np.ascontiguousarray(material_ids, np.int32),
    )
