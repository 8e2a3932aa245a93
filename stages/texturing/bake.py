"""Baking: a light mesh gets a texture that holds the colours of the original surface.

Every texel is taken to its place on the light mesh, from there to the nearest point of the original that
faces the same way, and gets the colour there (Cignoni, Montani, Rocchini and Scopigno 1998, "A general method
for preserving attribute values on simplified meshes"). What is between the charts is filled from them, so
that neither bilinear sampling nor smaller copies of the image (mip levels) bring in a colour from elsewhere.
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
# Of the images, that charts fill.
_FILLED = 0.5
# An image has room for charts beside so many times the padding.
_SIDES_OF_PADDING = 4
_MOST_SAMPLES = 4
# Of all texels, by default: an image whose details are too fine for a few samples is averaged before, which
# takes far less time and shows the same.
_ALL_SAMPLES = 16e6
# An image that is finer by no more than this factor is shown as it is.
_ALIKE = 1.25
# A light mesh of more than this many times the original's area shows something else: it gets no more texels
# for being large.
_MOST_AREA = 4
_COMPARED = 100_000


@dataclass(frozen=True, kw_only=True)
class BakeParams:
    """How finely the colours of the original are kept, and in how large an image."""

    texel_size: float | None = param(
        None,
        "Size of a texel on the surface, at most; the image is the smallest that has room for it, and is "
        "filled. Default: 0.4 of the original's mean edge, or the size of its own texels.",
        unit="m",
        low=0,
        low_open=True,
        common=True,
    )
    max_size: int = param(
        4096,
        "Largest side of an image: a power of two. There are as many images as are needed.",
        unit="texels",
        low=_MIN_SIZE,
        high=8192,
    )
    max_texels: float = param(
        16.0,
        "Texels of all images together, about; where more were needed, texels are larger.",
        unit="million texels",
        low=0.01,
        high=1000,
    )
    padding: int | None = param(
        None,
        "Texels around each chart that show its colours; between two charts there are twice as many. With 8 "
        "the image can be halved twice and no colour gets from one chart into another; at most a quarter of "
        "max_size. Default: 1/256 of the side, or 2 where that leaves no room.",
        unit="texels",
        low=1,
        high=128,
    )
    samples: int | None = param(
        None,
        "Samples along each side of a texel, whose mean it gets. Default: enough to meet all detail of the "
        "original, 1 to 4.",
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
                "is {padding} texels; an image of {max_size} has no room beside it.",
                Where(parameter="padding"),
                padding=self.padding,
                max_size=self.max_size,
            )


@dataclass(frozen=True, eq=False)
class Baked:
    """A textured mesh and how well it shows its original.

    Attributes
    ----------
    mesh : the light mesh with texture images, without vertex colours.
    sizes : (width, height) of each image, texels.
    texel_size : metres, of a texel on the surface, in the mean.
    coverage : share of the images that shows the surface.
    charts : pieces the surface is cut into.
    padding : texels around each chart that show its colours, at least.
    samples : along each side of a texel.
    turned : share of the samples whose nearest point faced away, and that took another one.
    color : difference from the original's colours, sampled on the original.
    vertex_color : the same for the light mesh's vertex colours; None if it has none.
    image_bytes, source_image_bytes : of all new images, and of those they replace, as files; None where there
        were none.
    resolution_scale : of a side of an image, below 1 where it was made smaller to have no more bytes.
    quality : of JPEG or WebP, the lowest of all images; None for PNG.
    diagnostics : what baking left out.
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
        """Return how often an image can be halved (mip levels) with no colour crossing to another chart."""
        # A bilinear sample of a halved image reaches twice as far as a texel of it is wide.
        return max(int(math.log2(self.padding)) - 1, 0)

    def figures(self) -> dict[str, Any]:
        """Return all figures for JSON, units in the names."""
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
    """Give a light mesh a texture that holds the colours of its original.

    The same meshes give the same image. Memory beside the meshes and the image is bounded.

    Parameters
    ----------
    light : Mesh, Open3D or trimesh mesh, or a pair of arrays; need not be a manifold. Its own colours and
        texture are replaced.
    original : in the same place, with vertex colours or a texture.
    params : see BakeParams; single ones can be given by name.
    progress : told of rows of the images.

    Raises
    ------
    MeshError
        If a mesh is not valid or has no area, the light mesh is of needles alone, or the original has no
        colours.
    """
    params = resolve(BakeParams, params, changes)
    with collecting() as diagnostics:
        found = _baked(light, original, params, progress)
    return replace(found, diagnostics=tuple(diagnostics))


def _baked(light: MeshLike, original: MeshLike, params: BakeParams, progress: Progress) -> Baked:
    given, reference = as_mesh(light, "light mesh"), as_mesh(original, "original")
    require_area(given, "light mesh")
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
        emit(TEXTURE_BAKE_LEFT_OUT.warning("bake left out: the transparency of the original's images."))
    if shown is not reference:
        sizes = ", ".join(f"{width} × {height}" for width, height in pages.sizes)
        emit(
            TEXTURE_BAKE_LEFT_OUT.warning(
                "bake left out: detail of the original's images that {sizes} texels cannot show.", sizes=sizes
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
    """Return the mesh with the images, and without vertex colours: a viewer would multiply the two.

    It takes no light where the original takes none.
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
    """Return how much larger the original's details are on the light mesh: 1 where both show one surface."""
    light_area, area = (float(areas(mesh.vertices, mesh.triangles).sum()) for mesh in (light, original))
    return math.sqrt(light_area / area) if light_area > _MOST_AREA * area else 1.0


def _most_samples(texels: float) -> int:
    """Return how many samples along its side each of so many texels may have."""
    return max(min(int(math.sqrt(_ALL_SAMPLES / texels)), _MOST_SAMPLES), 1)


def _area(mesh: Mesh) -> float:
    return float(areas(mesh.vertices, mesh.triangles).sum())


def _color_error(original: Surface, mesh: Mesh, box: Floats) -> ColorError | None:
    return compare_surfaces(original, Surface(mesh, box), CompareParams(samples=_COMPARED)).color_a_to_b
