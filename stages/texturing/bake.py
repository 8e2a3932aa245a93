"""Bake the colours of an original surface onto its simplified mesh.

Each texel is mapped to its point on the simplified mesh. The texel takes the colour of the nearest point of
the original that faces the same way (Cignoni, Montani, Rocchini and Scopigno 1998, "A general method for
preserving attribute values on simplified meshes"). Gaps between charts are filled with colours of the charts
around them, so bilinear sampling and mip levels do not bleed foreign colours.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.compare import ColorError, CompareParams, compare_surfaces
from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic, Where
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.params import check, param, resolve
from scanloom.stages.printing import by_figures, table
from scanloom.stages.progress import Progress, silent
from scanloom.stages.surface.color import has_color, is_transparent
from scanloom.stages.surface.convert import MeshLike, as_mesh
from scanloom.stages.surface.formats.gltf_materials import is_shown_as_it_is, shown_as_it_is
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats, Surface, bounding_box
from scanloom.stages.surface.texture import Image, Material, Texture
from scanloom.stages.surface.topology import areas, require_area
from scanloom.stages.texturing.codes import TEXTURE_ATLAS_TOO_SMALL, TEXTURE_BAKE_LEFT_OUT
from scanloom.stages.texturing.detail import SAMPLES_PER_DETAIL, detail_of
from scanloom.stages.texturing.facing import FacingColors
from scanloom.stages.texturing.pages import Pages, fitted
from scanloom.stages.texturing.painted_pages import painted_pages
from scanloom.stages.texturing.reducing import reduced

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import BakeKeywords

RESULT_VERSION = 7

_MIN_SIZE = 64
# Typical ratio of an image that charts fill; converts `max_texels` to texels of surface.
_FILLED = 0.5
# Minimum side of an image in multiples of the padding; smaller images have no space for a chart.
_SIDES_OF_PADDING = 4
_MOST_SAMPLES = 4
# Default limit of samples in all texels together. Finer source images are averaged before sampling instead,
# which is much faster and gives the same result.
_ALL_SAMPLES = 16e6
# Source images up to this factor finer than the target are sampled as they are.
_ALIKE = 1.25
# Maximum area of the simplified mesh relative to the original. A larger mesh is of another surface, and its
# area does not increase the number of texels.
_MOST_AREA = 4
_COMPARED = 100_000


@dataclass(frozen=True, kw_only=True)
class BakeParams:
    """Parameters of baking: texel size, image size and sampling."""

    texel_size: float | None = param(
        None,
        "Maximum size of a texel on the surface; the smallest sufficient image is used and filled. Default: "
        "0.4 of the original's mean edge length, or the size of its own texels.",
        unit="m",
        low=0,
        low_open=True,
        common=True,
    )
    max_size: int = param(
        4096,
        "Longest side of an image; a power of two. Several images are written if one is not enough.",
        unit="texels",
        low=_MIN_SIZE,
        high=8192,
    )
    max_texels: float = param(
        16.0,
        "Approximate limit of all images together; texels get larger if more would be needed.",
        unit="million texels",
        low=0.01,
        high=1000,
    )
    padding: int | None = param(
        None,
        "Texels around each chart that continue its colours; the gap between two charts is twice as wide. "
        "8 texels keep two mip levels free of colour bleeding. At most a quarter of max_size. Default: 1/256 "
        "of the side, or 2 if that takes too much space.",
        unit="texels",
        low=1,
        high=128,
    )
    samples: int | None = param(
        None,
        "Samples along each side of a texel, which are averaged. Default: 1 to 4, enough to capture all "
        "detail of the original.",
        low=1,
        high=8,
    )

    def __post_init__(self) -> None:
        check(self)
        if self.max_size & (self.max_size - 1):
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is {max_size} texels; it must be a power of two.",
                Where(parameter="max_size"),
                max_size=self.max_size,
            )
        if _SIDES_OF_PADDING * (self.padding or 0) > self.max_size:
            raise UsageError(
                TEXTURE_ATLAS_TOO_SMALL,
                "is {padding} texels; it must be at most a quarter of max_size ({max_size} texels).",
                Where(parameter="padding"),
                padding=self.padding,
                max_size=self.max_size,
            )


@dataclass(frozen=True, eq=False)
class Baked:
    """Textured mesh and its deviation from the original.

    Attributes
    ----------
    mesh : the simplified mesh with texture images, without vertex colours.
    sizes : (width, height) of each image, texels.
    texel_size : mean size of a texel on the surface, metres.
    coverage : ratio of the images that shows the surface.
    charts : number of charts.
    padding : minimum number of texels around each chart that continue its colours.
    samples : samples along each side of a texel.
    turned : ratio of samples whose nearest point faced away and was replaced by a point that faces the same
        way.
    color : colour difference from the original, sampled on the original.
    vertex_color : the same for the vertex colours of the simplified mesh; None without vertex colours.
    image_bytes, source_image_bytes : file sizes of the new images, and of the images they replace; None if no
        image was replaced.
    resolution_scale : scale of an image side; below 1 if images were reduced to fit into the byte limit.
    quality : lowest JPEG or WebP quality of all images; None for PNG.
    diagnostics : warnings, such as attributes that baking drops.
    """

    mesh: Mesh
    sizes: tuple[tuple[int, int], ...]
    texel_size: float
    coverage: float
    charts: int
    padding: int
    samples: int
    turned: float
    color: ColorError
    vertex_color: ColorError | None
    image_bytes: int | None = None
    source_image_bytes: int | None = None
    resolution_scale: float = 1.0
    quality: int | None = None
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = by_figures
    _repr_html_ = table

    @property
    def halvings(self) -> int:
        """Number of mip levels without colour bleeding between charts."""
        # A bilinear sample reaches two texels of the halved image across.
        return max(int(math.log2(self.padding)) - 1, 0)

    def figures(self) -> dict[str, Any]:
        """Return all metrics for JSON, with units in the keys."""
        return {
            "triangles": len(self.mesh.triangles),
            "images": [list(size) for size in self.sizes],
            "texel_size_m": self.texel_size,
            "texels_per_m": 1 / self.texel_size,
            "coverage": self.coverage,
            "charts": self.charts,
            "padding_texels": self.padding,
            "halvings": self.halvings,
            "samples_per_texel": self.samples**2,
            "turned_samples": self.turned,
            "color": self.color.figures(),
            "vertex_color": self.vertex_color and self.vertex_color.figures(),
            **self._file_figures(),
        }

    def _file_figures(self) -> dict[str, Any]:
        if self.image_bytes is None:
            return {}
        return {
            "image_bytes": self.image_bytes,
            "source_image_bytes": self.source_image_bytes,
            "resolution_scale": self.resolution_scale,
            "quality": self.quality,
        }


def bake(
    light: MeshLike,
    original: MeshLike,
    params: BakeParams | None = None,
    *,
    progress: Progress = silent,
    **changes: Unpack[BakeKeywords],
) -> Baked:
    """Bake the colours of an original mesh onto its simplified mesh.

    The result is deterministic. Memory besides the meshes and the images is bounded.

    Parameters
    ----------
    light : the simplified mesh: Mesh, Open3D or trimesh mesh, or a pair of arrays; need not be manifold. Its
        colours and texture are replaced.
    original : mesh in the same coordinates, with vertex colours or a texture.
    params : see BakeParams; single parameters can be given by keyword.
    progress : called with the number of finished rows of the images and their total.

    Returns
    -------
    Baked : the textured mesh, and its colour difference from the original.

    Raises
    ------
    MeshError
        If a mesh is invalid or has no area, the simplified mesh consists of degenerate triangles only, or the
        original has no colours.
    """
    params = resolve(BakeParams, params, changes)
    with collecting() as diagnostics:
        found = _baked(light, original, params, progress)
    return replace(found, diagnostics=tuple(diagnostics))


def _baked(light: MeshLike, original: MeshLike, params: BakeParams, progress: Progress) -> Baked:
    given, reference = as_mesh(light, "simplified mesh"), as_mesh(original, "original")
    require_area(given, "simplified mesh")
    require_area(reference, "original")
    if not has_color(reference):
        raise MeshError(
            TEXTURE_BAKE_LEFT_OUT,
            "has neither vertex colours nor a texture; there is nothing to bake.",
            "original",
        )
    stretch = _stretch(given, reference)
    most = params.max_texels * 1e6 * _FILLED
    finest = max(params.texel_size or 0.0, math.sqrt(_area(given) / most))
    finer = max(_most_samples(_area(given) / finest**2) / SAMPLES_PER_DETAIL, _ALIKE)
    shown = reduced(reference, finest / stretch, finer)
    detail = detail_of(shown) * stretch
    pages = fitted(
        given,
        params.texel_size or detail,
        max_side=params.max_size,
        max_texels=most,
        padding=params.padding,
        progress=lambda *_: progress(0, 1),
    )
    texel_size = pages.texel_size(given)
    enough = math.ceil(SAMPLES_PER_DETAIL * texel_size / detail)
    samples = params.samples or min(enough, _most_samples(_area(given) / texel_size**2))
    box = bounding_box(given, reference)
    surface = Surface(reference, box)
    colors_of = FacingColors(surface if shown is reference else Surface(shown, box), given, texel_size)
    painted = painted_pages(given, pages, samples, colors_of, progress=progress)
    mesh = _textured(given, pages, painted.images, reference)
    if is_transparent(reference):
        emit(TEXTURE_BAKE_LEFT_OUT.warning("bake drops the transparency of the original's images."))
    if shown is not reference:
        sizes = ", ".join(f"{width} × {height}" for width, height in pages.sizes)
        emit(
            TEXTURE_BAKE_LEFT_OUT.warning(
                "images of {sizes} texels cannot show all detail of the original's images; finer detail is "
                "averaged.",
                remedy="Larger values of max_texels and max_size keep more.",
                sizes=sizes,
            )
        )
    error, before = (_color_error(surface, one, box) for one in (mesh, given))
    assert error is not None
    return Baked(
        mesh=mesh,
        sizes=pages.sizes,
        texel_size=texel_size,
        coverage=painted.coverage,
        charts=int(pages.charts.max()) + 1,
        padding=pages.padding,
        samples=samples,
        turned=painted.turned,
        color=error,
        vertex_color=before if given.colors is not None else None,
    )


def _textured(mesh: Mesh, pages: Pages, images: Sequence[NDArray[np.uint8]], original: Mesh) -> Mesh:
    """Attach the images to a mesh and remove its vertex colours.

    Vertex colours are removed because viewers multiply them with the texture. The material is unlit if all
    materials of the original are.
    """
    names = [f"baked-{number}" for number in range(1, len(images) + 1)] if len(images) > 1 else ["baked"]
    theirs = () if original.texture is None else original.texture.materials
    kept = shown_as_it_is() if theirs and all(map(is_shown_as_it_is, theirs)) else None
    materials = tuple(
        Material(name, Image(name=f"{name}.png", given=image), wrap=("clamp", "clamp"), kept=kept)
        for name, image in zip(names, images, strict=True)
    )
    return mesh.with_(colors=None, texture=Texture(pages.uvs, pages.images, materials))


def _stretch(light: Mesh, original: Mesh) -> float:
    """Return the scale of details on the simplified mesh relative to the original.

    The scale is 1 unless the simplified mesh has more than `_MOST_AREA` times the area.
    """
    light_area, area = (float(areas(mesh.vertices, mesh.triangles).sum()) for mesh in (light, original))
    return math.sqrt(light_area / area) if light_area > _MOST_AREA * area else 1.0


def _most_samples(texels: float) -> int:
    """Return the affordable samples along a texel's side."""
    return max(min(int(math.sqrt(_ALL_SAMPLES / texels)), _MOST_SAMPLES), 1)


def _area(mesh: Mesh) -> float:
    return float(areas(mesh.vertices, mesh.triangles).sum())


def _color_error(original: Surface, mesh: Mesh, box: Floats) -> ColorError | None:
    return compare_surfaces(original, Surface(mesh, box), CompareParams(samples=_COMPARED)).color_a_to_b
