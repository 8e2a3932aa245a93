"""Texture images of tiles.

The resolution follows the proven shape error of each tile. The finest tiles sample their colours from the
source model, at the nearest point that faces the same way. Coarser tiles sample the next finer tiles, once
these show more detail than a few samples per texel can resolve. Each texel is thus the mean of the surface
under it. Mip levels of the model's image would bleed between its charts instead. Sampling looks up all tiles
around, so colours are continuous across tile borders.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.files.image_bytes import encoded_image
from scanloom.stages.lod.codes import LEVELS_MODEL_MISMATCH
from scanloom.stages.params import check, param
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.surface.color import color_at, has_color
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats, Surface, bounding_box
from scanloom.stages.surface.texture import Image, Material, Texture
from scanloom.stages.surface.topology import areas, require_area
from scanloom.stages.texturing.detail import detail_of, details_of
from scanloom.stages.texturing.facing import FacingColors
from scanloom.stages.texturing.pages import Pages, in_one
from scanloom.stages.texturing.painted_pages import painted_pages
from scanloom.stages.texturing.reducing import reduced

# Group of these parameters in the help.
_IMAGES = "Images"
# Samples per detail length. The larger value of single baked images changes the RMS colour error by less than
# 0.1 levels, and takes four times as long for texels as large as the model's.
_SAMPLES_PER_DETAIL = 1.3
# Maximum samples along a texel's side; finer detail is sampled from finer tiles or averaged before.
_MOST_SAMPLES = 4
_FINER = _MOST_SAMPLES / _SAMPLES_PER_DETAIL
# Texels larger than requested by more than this factor mean that the image was too small. The factor allows
# for the compression of charts.
_COARSER = 1.15
# Number of precomputed copies of the model's images, each at half the resolution of the previous one.
_HALVINGS = 3
# Maximum of 16-bit texture coordinates.
_UV_STEPS = 65535
# Maximum median distance between levels and model, relative to the levels' size; beyond, the model is
# rejected as another surface. Number of vertices sampled for it.
_FAR = 0.02
_PROBES = 20_000
# Points of a tile at which the model's detail and the colour error are sampled.
_POINTS = 4000
# Margin around a tile's bounding box from which colours are sampled, in texels and in multiples of both
# tiles' errors.
_REACH_TEXELS, _REACH_ERRORS = 8.0, 2.0


@dataclass(frozen=True, kw_only=True)
class TileImageParams:
    """Parameters of the images of tiles."""

    texels_per_error: float = param(
        4.0,
        "Texels per length of the tile's proven error, never finer than the model's images. Viewers show a "
        "tile until its error is about 16 pixels.",
        group=_IMAGES,
        low=0.1,
        high=100,
    )
    image_side: int = param(
        2048, "Longest side of a tile's image.", unit="texels", group=_IMAGES, low=64, high=8192
    )
    image_format: str = param(
        "jpeg",
        "File format of the images; webp is smaller, but viewers must support EXT_texture_webp.",
        group=_IMAGES,
        choices=("jpeg", "webp", "png"),
    )
    image_quality: int = param(90, "Quality of JPEG and WebP images.", group=_IMAGES, low=1, high=100)

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, eq=False)
class TileImage:
    """Size of a tile's image, and its colour error against the model.

    Attributes
    ----------
    bytes : size of its file.
    size : width and height, texels.
    texel_size : mean size of a texel on the tile, metres.
    coverage : ratio of the image that shows the surface.
    is_full : the image was too small for the requested texel size.
    color_rms, color_95, color_most : colour error in levels, at points sampled on the tile, against the
        model's colours at the nearest points that face the same way. Sampled, so not proven. RMS is over
        points and channels; 95th percentile and maximum are of the largest channel difference of each point.
    """

    bytes: int
    size: tuple[int, int]
    texel_size: float
    coverage: float
    is_full: bool
    color_rms: float
    color_95: float
    color_most: float

    def figures(self) -> dict[str, Any]:
        """Return the metrics written to tileset.json."""
        return {
            "texel_size_m": _three_digits(self.texel_size),
            "color_rms_levels_sampled": _three_digits(self.color_rms),
            "color_95_levels_sampled": _three_digits(self.color_95),
            "color_max_levels_sampled": _three_digits(self.color_most),
        }


def figures_of(images: Sequence[TileImage]) -> dict[str, Any]:
    """Summarise sizes and colour errors of the images of tiles, root first."""
    return {
        "total_bytes": sum(image.bytes for image in images),
        "root_bytes": images[0].bytes,
        "median_bytes": int(np.median([image.bytes for image in images])),
        "root_size": list(images[0].size),
        "longest_side": max(max(image.size) for image in images),
        "coverage": float(np.median([image.coverage for image in images])),
        "finest_texel_m": min(image.texel_size for image in images),
        "coarsest_texel_m": max(image.texel_size for image in images),
        "tiles_without_room": sum(image.is_full for image in images),
        "color_rms_levels_sampled": {
            "median": float(np.median([image.color_rms for image in images])),
            "largest": max(image.color_rms for image in images),
        },
    }


@dataclass(frozen=True, eq=False)
class Model:
    """Colour source of the images of tiles.

    Attributes
    ----------
    surface : model in the coordinates of the tiles.
    coarser : the same surface with images halved one or more times; empty without images.
    details : (m,) detail size of each triangle, from its texels or vertex colours, metres.
    """

    surface: Surface
    coarser: Sequence[Surface]
    details: Floats

    def detail_on(self, mesh: Mesh) -> float:
        """Return the mean detail size of the model near a mesh, metres, averaged over texels."""
        triangles, weights = _spread(mesh)
        points = np.einsum("kc,kcx->kx", weights, mesh.vertices[mesh.triangles[triangles]])
        details = self.details[self.surface.closest(points).triangles]
        return float(1 / np.sqrt((1 / details**2).mean()))

    def for_texels(self, texel_size: float, detail: float) -> tuple[Surface, float]:
        """Select the copy of the model that a few samples per texel can resolve.

        Returns
        -------
        The surface, and its detail size in metres.
        """
        halvings = max(math.ceil(math.log2(texel_size / (_FINER * detail))), 0)
        halvings = min(halvings, len(self.coarser))
        return self.coarser[halvings - 1] if halvings else self.surface, detail * 2**halvings


@dataclass(frozen=True, eq=False)
class Piece:
    """Mesh of a tile and the tiles its image is sampled from.

    Attributes
    ----------
    mesh : without colours.
    error : proven shape error, metres.
    below : indices of finer tiles that together cover the whole surface; empty for the finest.
    """

    mesh: Mesh
    error: float
    below: tuple[int, ...]


def model_of(mesh: Mesh, levels: Mesh, origin: Floats) -> Model:
    """Prepare a mesh as colour source for the levels.

    Parameters
    ----------
    mesh : with a texture or vertex colours, in the coordinates of the levels.
    levels : finest mesh of the levels, relative to `origin`.
    origin : (3,) metres.

    Raises
    ------
    MeshError
        If the mesh has no colours or no area, or is another surface than the levels.
    """
    require_area(mesh, "model")
    if not has_color(mesh):
        raise MeshError(
            LEVELS_MODEL_MISMATCH, "has neither an image nor vertex colours for the tiles.", "model"
        )
    if origin.any():
        mesh = mesh.with_(vertices=mesh.vertices - origin)
    box = bounding_box(mesh, levels)
    surface = Surface(mesh, box)
    probes = levels.vertices[:: math.ceil(len(levels.vertices) / _PROBES)]
    away = float(np.median(surface.closest(probes).distances))
    size = float(np.linalg.norm(np.ptp(levels.vertices, axis=0)))
    if away > _FAR * size:
        raise MeshError(
            LEVELS_MODEL_MISMATCH,
            (
                "does not match the levels, which are {size:.3g} m large: half of their vertices are more "
                "than {away:.3g} m away from it. It is another surface, or has other coordinates."
            ),
            "model",
            away=away,
            size=size,
        )
    detail = detail_of(mesh)
    coarser = [
        surface.showing(reduced(mesh, detail * 2**halvings, 1.0))
        for halvings in range(1, _HALVINGS + 1)
        if mesh.texture is not None
    ]
    return Model(surface, coarser, details_of(mesh))


def with_images(
    pieces: Sequence[Piece], model: Model, params: TileImageParams
) -> Iterator[tuple[int, Mesh, TileImage]]:
    """Paint the images of all tiles.

    Tiles are painted after all tiles in their `below`. The result does not depend on the number of threads.

    Yields
    ------
    Index of the tile, its textured mesh, and the metrics of its image.

    Raises
    ------
    MeshError
        If a tile has no area or only degenerate triangles, or has too many charts for an image of
        `image_side`.
    """
    waiting = set(range(len(pieces)))
    painted: dict[int, tuple[Mesh, float]] = {}
    while waiting:
        now = sorted(number for number in waiting if painted.keys() >= set(pieces[number].below))
        waiting -= set(now)
        paint = partial(_painted, pieces, model, params, painted)
        done = {}
        threads = workers()
        for number, result in zip(
            now, read_ahead(paint, now, threads=threads, ahead=threads + 1), strict=True
        ):
            done[number] = result.plain, result.image.texel_size
            yield number, result.mesh, result.image
        painted |= done
        needed = {other for number in waiting for other in pieces[number].below}
        for number in painted.keys() - needed:
            # Release the mesh; the texel size and the fact that the tile is painted are still needed.
            painted[number] = _NOTHING, painted[number][1]


_NOTHING = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))


@dataclass(frozen=True, eq=False)
class _Painted:
    """Tile with its image, raw (`plain`) and encoded (`mesh`)."""

    plain: Mesh
    mesh: Mesh
    image: TileImage


def _painted(
    pieces: Sequence[Piece],
    model: Model,
    params: TileImageParams,
    finer: Mapping[int, tuple[Mesh, float]],
    number: int,
) -> _Painted:
    piece = pieces[number]
    mesh = piece.mesh
    require_area(mesh, "tile")
    detail = model.detail_on(mesh)
    wanted = max(piece.error / params.texels_per_error, detail)
    pages = in_one(mesh, wanted, max_side=params.image_side)
    texel_size = pages.texel_size(mesh)
    if piece.below and texel_size > _FINER * detail:
        surface, detail = _around(piece, texel_size, pieces, finer)
    else:
        surface, detail = model.for_texels(texel_size, detail)
    samples = min(max(round(_SAMPLES_PER_DETAIL * texel_size / detail), 1), _MOST_SAMPLES)
    colors_of = FacingColors(surface, mesh, texel_size)
    # One thread: tiles are already painted in parallel.
    found = painted_pages(mesh, pages, samples, colors_of, goes_on=True, threads=1)
    (pixels,) = found.images
    encoded = encoded_image(pixels, params.image_format, params.image_quality)
    uvs = _rounded(pages)

    def with_image(image: Image) -> Mesh:
        material = Material(image=image, wrap=("clamp", "clamp"))
        return mesh.with_(texture=Texture(uvs, pages.images, (material,)))

    # A separate Image object: decoding caches the pixels, which must not be kept with the result.
    rms, most_of_95, most = _differences(with_image(Image(encoded=encoded)), model.surface, texel_size)
    is_full = texel_size > _COARSER * wanted
    height, width = pixels.shape[:2]
    image = TileImage(
        len(encoded), (width, height), texel_size, found.coverage, is_full, rms, most_of_95, most
    )
    return _Painted(with_image(Image(given=pixels)), with_image(Image(encoded=encoded)), image)


def _rounded(pages: Pages) -> Floats:
    """Round texture coordinates to 16 bits, as in the file."""
    return np.asarray(np.rint(pages.uvs * _UV_STEPS).clip(0, _UV_STEPS) / _UV_STEPS)


def _around(
    piece: Piece, texel_size: float, pieces: Sequence[Piece], finer: Mapping[int, tuple[Mesh, float]]
) -> tuple[Surface, float]:
    """Merge the finer tiles around a tile into one surface.

    Returns
    -------
    The surface, and the minimum texel size of the tiles, metres.
    """
    low, high = bounding_box(piece.mesh)
    chosen = []
    for number in piece.below:
        reach = _REACH_TEXELS * texel_size + _REACH_ERRORS * (piece.error + pieces[number].error)
        its_low, its_high = bounding_box(pieces[number].mesh)
        if ((its_low <= high + reach) & (its_high >= low - reach)).all():
            chosen.append(number)
    meshes = [finer[number][0] for number in chosen]
    mesh = _joined(meshes)
    return Surface(mesh, bounding_box(mesh, piece.mesh)), min(finer[number][1] for number in chosen)


def _joined(meshes: Sequence[Mesh]) -> Mesh:
    """Merge textured meshes into one, with one material per mesh."""
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    textures = [mesh.texture for mesh in meshes if mesh.texture is not None]
    return Mesh(
        np.vstack([mesh.vertices for mesh in meshes]),
        np.vstack([mesh.triangles + at for mesh, at in zip(meshes, first, strict=True)]).astype(np.int32),
        texture=Texture(
            np.vstack([texture.uvs for texture in textures]),
            np.repeat(np.arange(len(meshes)), [len(mesh.triangles) for mesh in meshes]).astype(np.int32),
            tuple(texture.materials[0] for texture in textures),
        ),
    )


def _spread(mesh: Mesh) -> tuple[NDArray[np.int64], Floats]:
    """Sample points uniformly and reproducibly on a mesh.

    Returns
    -------
    Triangles (k,) and barycentric weights (k, 3).
    """
    rng = np.random.default_rng(0)
    area = areas(mesh.vertices, mesh.triangles)
    triangles = np.sort(rng.choice(len(area), _POINTS, p=area / area.sum())).astype(np.int64)
    return triangles, rng.dirichlet((1, 1, 1), _POINTS)


def _differences(mesh: Mesh, model: Surface, texel_size: float) -> tuple[float, float, float]:
    """Compute the colour error of a textured mesh against a model, levels.

    Returns
    -------
    RMS over points and channels, 95th percentile and maximum over points.
    """
    triangles, weights = _spread(mesh)
    was, _ = FacingColors(model, mesh, texel_size)(triangles, weights)
    apart = np.abs(color_at(mesh, triangles, weights) - was)
    of_points = apart.max(axis=1)
    return float(np.sqrt((apart**2).mean())), float(np.quantile(of_points, 0.95)), float(of_points.max())


def _three_digits(value: float) -> float:
    return float(f"{value:.3g}")
