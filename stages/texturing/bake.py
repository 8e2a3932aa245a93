"""Baking: a light mesh gets a texture that holds the colours of the original surface.

Every texel is taken to its place on the light mesh, from there to the nearest point of the original that
faces the same way, and gets the colour there (Cignoni, Montani, Rocchini and Scopigno 1998, "A general method
for preserving attribute values on simplified meshes"). What is between the charts is filled from them, so
that neither bilinear sampling nor smaller copies of the image (mip levels) bring in a colour from elsewhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from stages.comparing.compare import ColorError, CompareParams, compare_surfaces
from stages.errors import MeshError, UsageError
from stages.params import check, param, resolve
from stages.printing import by_figures, table
from stages.progress import Progress, silent
from stages.scans.prefetch import read_ahead, workers
from stages.surface.color import has_color, pixels_of
from stages.surface.convert import MeshLike, as_mesh
from stages.surface.mesh import Mesh
from stages.surface.rasterize import covered, strips
from stages.surface.raycasting import Floats, Surface, bounding_box
from stages.surface.texture import Image, Material, Texture, signed_areas
from stages.surface.topology import areas, require_area
from stages.texturing.atlas import Atlas, unwrap
from stages.texturing.facing import FacingColors
from stages.texturing.filling import filled_up
from stages.texturing.reducing import reduced

if TYPE_CHECKING:
    from typing_extensions import Unpack

RESULT_VERSION = 4

_MIN_SIZE = 64
# Of the image, that charts fill; used to choose its size.
_FILLED = 0.5
_LEAST_PADDING = 2
# So many texels of an image's side have one texel of padding by default.
_SIDE_PER_PADDING = 256
_MOST_SAMPLES = 4
# Of the mean edge: what is interpolated between vertices has kinks along edges, many of them shorter.
_DETAIL_OF_EDGE = 0.4
# An original has no more details than this in a triangle, by its vertex colours: where a few triangles are
# large among tiny ones, an image that shows these everywhere would take minutes for a handful of colours.
_DETAILS_OF_TRIANGLE = 2000
# A light mesh of more than this many times the original's area shows something else: it gets no more texels
# for being large.
_MOST_AREA = 4
# Samples in a length of one detail of the original, at least. On a scanned banana and a fused room more of
# them change the error by less than 0.1 dB.
_SAMPLES_PER_DETAIL = 1.5
_COMPARED = 100_000


@dataclass(frozen=True, kw_only=True)
class BakeParams:
    """How finely the colours of the original are kept, and in how large an image."""

    texel_size: float | None = param(
        None,
        "Size of a texel on the surface, at most; the image is the smallest that has room for it, up to "
        "max_size, and is filled. Default: 0.4 of the original's mean edge, or the size of its own texels.",
        unit="m",
        low=0,
        low_open=True,
    )
    max_size: int = param(
        4096, "Largest side of the image: a power of two.", unit="texels", low=_MIN_SIZE, high=8192
    )
    padding: int | None = param(
        None,
        "Texels around each chart that show its colours; between two charts there are twice as many. With 8 "
        "the image can be halved twice and no colour gets from one chart into another. Default: 1/256 of "
        "the side, at least 2.",
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
            raise UsageError(f"max_size is {self.max_size} texels; it must be a power of two.")


class BakeKeywords(TypedDict, total=False):
    """BakeParams as keywords of `bake`."""

    texel_size: float | None
    max_size: int
    padding: int | None
    samples: int | None


@dataclass(frozen=True, eq=False)
class Baked:
    """A textured mesh and how well it shows its original.

    Attributes
    ----------
    mesh : the light mesh with one texture image, without vertex colours.
    size : texels, of a side of the image.
    texel_size : metres, of a texel on the surface, in the mean.
    coverage : share of the image that shows the surface.
    charts : pieces the surface is cut into.
    padding : texels around each chart that show its colours, at least.
    samples : along each side of a texel.
    turned : share of the samples whose nearest point faced away, and that took another one.
    color : difference from the original's colours, sampled on the original.
    vertex_color : the same for the light mesh's vertex colours; None if it has none.
    """

    mesh: Mesh
    size: int
    texel_size: float
    coverage: float
    charts: int
    padding: int
    samples: int
    turned: float
    color: ColorError
    vertex_color: ColorError | None

    __repr__ = by_figures
    _repr_html_ = table

    @property
    def halvings(self) -> int:
        """Return how often the image can be halved (mip levels) with no colour crossing to another chart."""
        # A bilinear sample of a halved image reaches twice as far as a texel of it is wide.
        return max(int(math.log2(self.padding)) - 1, 0)

    def figures(self) -> dict[str, Any]:
        """Return all figures for JSON, units in the names."""
        return {
            "triangles": len(self.mesh.triangles),
            "image_size_texels": self.size,
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
    progress : told of rows of the image.

    Raises
    ------
    MeshError
        If a mesh is not valid or has no area, or the original has no colours.
    StageError
        If no atlas is found, or its charts do not fit with their padding.
    """
    params = resolve(BakeParams, params, changes)
    given, reference = as_mesh(light, "light mesh"), as_mesh(original, "original")
    require_area(given, "light mesh")
    require_area(reference, "original")
    if not has_color(reference):
        raise MeshError("has neither vertex colours nor a texture; there is nothing to bake.", "original")
    stretch = _stretch(given, reference)
    finest = max(params.texel_size or 0.0, _side(given) / params.max_size)
    shown = reduced(reference, finest / stretch, _MOST_SAMPLES / _SAMPLES_PER_DETAIL)
    detail = _detail(shown) * stretch
    size = _image_size(given, params.texel_size or detail, params.max_size)
    padding = params.padding or max(_LEAST_PADDING, size // _SIDE_PER_PADDING)
    atlas = unwrap(given, size, padding, progress)
    texel_size = _texel_size(given, atlas)
    samples = params.samples or min(math.ceil(_SAMPLES_PER_DETAIL * texel_size / detail), _MOST_SAMPLES)
    box = bounding_box(given, reference)
    surface = Surface(reference, box)
    colors_of = FacingColors(surface if shown is reference else Surface(shown, box), given, texel_size)
    image, coverage, turned = _image(atlas, samples, colors_of, progress)
    mesh = _textured(given, atlas, image)
    if _is_transparent(reference):
        mesh = mesh.with_(notes=(*mesh.notes, "bake left out: the transparency of the original's images."))
    if shown is not reference:
        note = f"bake left out: detail of the original's images that {size} × {size} texels cannot show."
        mesh = mesh.with_(notes=(*mesh.notes, note))
    error, before = (_color_error(surface, one, box) for one in (mesh, given))
    assert error is not None
    return Baked(
        mesh=mesh,
        size=size,
        texel_size=texel_size,
        coverage=coverage,
        charts=int(atlas.charts.max()) + 1,
        padding=padding,
        samples=samples,
        turned=turned,
        color=error,
        vertex_color=before if given.colors is not None else None,
    )


def _textured(mesh: Mesh, atlas: Atlas, image: NDArray[np.uint8]) -> Mesh:
    """Return the mesh with the image, and without vertex colours: a viewer would multiply the two."""
    materials = (Material(name="baked", image=Image(name="baked.png", given=image), wrap=("clamp", "clamp")),)
    material_ids = np.zeros(len(mesh.triangles), np.int32)
    return mesh.with_(colors=None, texture=Texture(atlas.uvs, material_ids, materials))


def _is_transparent(mesh: Mesh) -> bool:
    images = [] if mesh.texture is None else [pixels_of(material) for material in mesh.texture.materials]
    return any(image is not None and image.shape[2] == 4 and image[..., 3].min() < 255 for image in images)


def _detail(original: Mesh) -> float:
    """Return the size, in metres, of the smallest thing the original's colours can show."""
    corners = original.vertices[original.triangles]
    area = areas(original.vertices, original.triangles)
    texture = original.texture
    if texture is not None:
        images = [pixels_of(material) for material in texture.materials]
        # The last one stands for triangles without a material.
        texels_of = np.array([*(_texel_count(image) for image in images), 0])
        texels = np.abs(signed_areas(texture.uvs)) * texels_of[texture.material_ids]
        on_image = texels > 0
        # Where most of the surface has a texture, that is what there is to keep.
        if area[on_image].sum() > area.sum() / 2:
            return math.sqrt(area[on_image].sum() / texels.sum())
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    least = math.sqrt(area.sum() / (_DETAILS_OF_TRIANGLE * len(area)))
    return max(_DETAIL_OF_EDGE * float(lengths.mean()), least)


def _texel_count(image: NDArray[np.uint8] | None) -> int:
    """Return how many texels show a detail: a single one has none, however often it is repeated."""
    count = 0 if image is None else image.shape[0] * image.shape[1]
    return count if count > 1 else 0


def _stretch(light: Mesh, original: Mesh) -> float:
    """Return how much larger the original's details are on the light mesh: 1 where both show one surface."""
    light_area, area = (float(areas(mesh.vertices, mesh.triangles).sum()) for mesh in (light, original))
    return math.sqrt(light_area / area) if light_area > _MOST_AREA * area else 1.0


def _image_size(mesh: Mesh, texel_size: float, max_size: int) -> int:
    wanted = _side(mesh) / texel_size
    size = _MIN_SIZE
    while size < min(wanted, max_size):
        size *= 2
    return size


def _side(mesh: Mesh) -> float:
    """Return how long, in metres, the side of an image is that shows all of a mesh."""
    return math.sqrt(areas(mesh.vertices, mesh.triangles).sum() / _FILLED)


def _texel_size(mesh: Mesh, atlas: Atlas) -> float:
    texels = np.abs(signed_areas(atlas.corners)).sum()
    return math.sqrt(float(areas(mesh.vertices, mesh.triangles).sum()) / float(texels))


def _color_error(original: Surface, mesh: Mesh, box: Floats) -> ColorError | None:
    return compare_surfaces(original, Surface(mesh, box), CompareParams(samples=_COMPARED)).color_a_to_b


@dataclass(frozen=True, eq=False)
class _Strip:
    """Rows of the image: `filled` texels have a sample on the surface, `turned` samples faced away."""

    texels: NDArray[np.float32]
    filled: NDArray[np.bool_]
    samples: int
    turned: int


def _image(
    atlas: Atlas, samples: int, colors_of: FacingColors, progress: Progress
) -> tuple[NDArray[np.uint8], float, float]:
    """Return the image of an atlas, full to its edges, and two shares.

    That which charts have of it, and that of the samples whose nearest point faced away.
    """
    size = atlas.size
    image = np.zeros((size, size, 3), np.float32)
    filled = np.zeros((size, size), bool)
    rows = strips(size, size * samples**2)
    asked = turned = 0
    paint = partial(_strip, atlas, samples, colors_of)
    for (start, end), strip in zip(
        rows, read_ahead(paint, rows, threads=workers(), ahead=workers() + 1), strict=True
    ):
        image[start:end], filled[start:end] = strip.texels, strip.filled
        asked, turned = asked + strip.samples, turned + strip.turned
        progress(end, size)
    _mark_small(atlas, image, filled, colors_of)
    return filled_up(image, filled, atlas.padding), float(filled.mean()), turned / max(asked, 1)


def _strip(atlas: Atlas, samples: int, colors_of: FacingColors, rows: tuple[int, int]) -> _Strip:
    fine = (rows[0] * samples, rows[1] * samples)
    found = covered(atlas.corners * samples, fine, atlas.size * samples)
    colors, turned = colors_of(found.triangles, found.weights)
    texels = (found.rows // samples - rows[0]) * atlas.size + found.columns // samples
    count = (rows[1] - rows[0]) * atlas.size
    hits = np.bincount(texels, minlength=count)
    sums = [np.bincount(texels, colors[:, channel], minlength=count) for channel in range(3)]
    means = np.stack(sums, axis=1) / np.maximum(hits, 1)[:, None]
    return _Strip(
        texels=means.reshape(-1, atlas.size, 3).astype(np.float32),
        filled=(hits > 0).reshape(-1, atlas.size),
        samples=len(texels),
        turned=turned,
    )


def _mark_small(
    atlas: Atlas, image: NDArray[np.float32], filled: NDArray[np.bool_], colors_of: FacingColors
) -> None:
    """Give triangles too small to hold a sample the texel at their middle, where nothing else has it."""
    column, row = np.floor(atlas.corners.mean(axis=1)).astype(np.int64).clip(0, atlas.size - 1).T
    (missed,) = np.nonzero((atlas.charts >= 0) & ~filled[row, column])
    row, column = row[missed], column[missed]
    image[row, column], _ = colors_of(missed, np.full((len(missed), 3), 1 / 3))
    filled[row, column] = True
