"""Texture images of tiles.

The resolution follows the proven shape error of each tile. The finest tiles sample their colours from the
source model, at the nearest point that faces the same way. Coarser tiles sample the next finer tiles, once
these show more detail than a few samples per texel can resolve. Each texel is thus the mean of the surface
under it. Mip levels of the model's image would bleed between its charts instead. Sampling includes the
neighbouring tiles, so colours are continuous across tile borders.
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
from scanloom.stages.files.image_bytes import encode_image
from scanloom.stages.lod.codes import LEVELS_MODEL_MISMATCH
from scanloom.stages.params import check_parameters, param
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats, RaycastingSurface, compute_bounding_box
from scanloom.stages.surface.surface_color import compute_surface_colors, has_color
from scanloom.stages.surface.texture import Image, Material, Texture
from scanloom.stages.surface.topology import compute_areas, require_area
from scanloom.stages.texturing.atlas_layout import AtlasLayout, lay_out_single
from scanloom.stages.texturing.atlas_painting import paint_pages
from scanloom.stages.texturing.color_lookup import ColorLookup
from scanloom.stages.texturing.detail_size import estimate_mesh_detail, estimate_triangle_details
from scanloom.stages.texturing.source_downscaling import downscale_images

# Group of these parameters in the help.
_GROUP_IMAGES = "Images"
# Samples per detail length. The larger value of single baked images changes the RMS colour error by less than
# 0.1 levels, and takes four times as long for texels as large as the model's.
_SAMPLES_PER_DETAIL = 1.3
# Maximum samples along a texel's side; finer detail is sampled from finer tiles or averaged before.
_MAX_SAMPLES = 4
_MAX_DETAIL_RATIO = _MAX_SAMPLES / _SAMPLES_PER_DETAIL
# Texels larger than requested by more than this factor mean that the image was too small. The factor allows
# for the compression of charts.
_MAX_TEXEL_RATIO = 1.15
# Number of precomputed copies of the model's images, each at half the resolution of the previous one.
_HALVED_COPIES = 3
# Maximum of 16-bit texture coordinates.
_UV_STEPS = 65535
# Maximum median distance between levels and model, relative to the levels' size; beyond, the model is
# rejected as another surface. Number of vertices sampled for it.
_MAX_DISTANCE_RATIO = 0.02
_DISTANCE_PROBES = 20_000
# Points of a tile at which the model's detail and the colour error are sampled.
_SAMPLE_POINTS = 4000
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
        group=_GROUP_IMAGES,
        low=0.1,
        high=100,
    )
    image_side: int = param(
        2048, "Longest side of a tile's image.", unit="texels", group=_GROUP_IMAGES, low=64, high=8192
    )
    image_format: str = param(
        "jpeg",
        "File format of the images; webp is smaller, but viewers must support EXT_texture_webp.",
        group=_GROUP_IMAGES,
        choices=("jpeg", "webp", "png"),
    )
    image_quality: int = param(90, "Quality of JPEG and WebP images.", group=_GROUP_IMAGES, low=1, high=100)

    def __post_init__(self) -> None:
        check_parameters(self)


@dataclass(frozen=True, eq=False)
class TileImage:
    """Size of a tile's image, and its colour error against the model.

    Attributes
    ----------
    bytes : size of its file.
    size : width and height, texels.
    texel_size : mean size of a texel on the tile, metres.
    coverage : ratio of the image that shows the surface.
    is_coarser_than_requested : the image was too small for the requested texel size.
    color_rms, color_95, color_max : colour error in levels, at points sampled on the tile, against the
        model's colours at the nearest points that face the same way. Sampled, so not proven. RMS is over
        points and channels; 95th percentile and maximum are of the largest channel difference of each point.
    """

    bytes: int
    size: tuple[int, int]
    texel_size: float
    coverage: float
    is_coarser_than_requested: bool
    color_rms: float
    color_95: float
    color_max: float

    def to_dict(self) -> dict[str, Any]:
        """Return the metrics written to tileset.json."""
        return {
            "texel_size_m": _round_to_three_digits(self.texel_size),
            "color_rms_levels_sampled": _round_to_three_digits(self.color_rms),
            "color_95_levels_sampled": _round_to_three_digits(self.color_95),
            "color_max_levels_sampled": _round_to_three_digits(self.color_max),
        }


def summarize_images(images: Sequence[TileImage]) -> dict[str, Any]:
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
        "tiles_coarser_than_requested": sum(image.is_coarser_than_requested for image in images),
        "color_rms_levels_sampled": {
            "median": float(np.median([image.color_rms for image in images])),
            "largest": max(image.color_rms for image in images),
        },
    }


@dataclass(frozen=True, eq=False)
class ColorSource:
    """Colour source of the images of tiles.

    Attributes
    ----------
    surface : model in the coordinates of the tiles.
    halved_copies : the same surface with images halved one or more times; empty without images.
    details : (m,) detail size of each triangle, from its texels or vertex colours, metres.
    """

    surface: RaycastingSurface
    halved_copies: Sequence[RaycastingSurface]
    details: Floats

    def estimate_detail(self, mesh: Mesh) -> float:
        """Return the mean detail size of the model near a mesh, metres, averaged over texels."""
        triangles, weights = _sample_points(mesh)
        points = np.einsum("kc,kcx->kx", weights, mesh.vertices[mesh.triangles[triangles]])
        details = self.details[self.surface.find_closest_points(points).triangles]
        return float(1 / np.sqrt((1 / details**2).mean()))

    def select_resolution(self, texel_size: float, detail: float) -> tuple[RaycastingSurface, float]:
        """Select the copy of the model that a few samples per texel can resolve.

        Returns
        -------
        The surface, and its detail size in metres.
        """
        halvings = max(math.ceil(math.log2(texel_size / (_MAX_DETAIL_RATIO * detail))), 0)
        halvings = min(halvings, len(self.halved_copies))
        return self.halved_copies[halvings - 1] if halvings else self.surface, detail * 2**halvings


@dataclass(frozen=True, eq=False)
class TileMesh:
    """Mesh of a tile and the tiles its image is sampled from.

    Attributes
    ----------
    mesh : without colours.
    error : proven shape error, metres.
    finer_tiles : indices of finer tiles that together cover the whole surface; empty for the finest.
    """

    mesh: Mesh
    error: float
    finer_tiles: tuple[int, ...]


def prepare_color_source(mesh: Mesh, levels: Mesh, origin: Floats) -> ColorSource:
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
    box = compute_bounding_box(mesh, levels)
    surface = RaycastingSurface(mesh, box)
    probes = levels.vertices[:: math.ceil(len(levels.vertices) / _DISTANCE_PROBES)]
    median_distance = float(np.median(surface.find_closest_points(probes).distances))
    size = float(np.linalg.norm(np.ptp(levels.vertices, axis=0)))
    if median_distance > _MAX_DISTANCE_RATIO * size:
        raise MeshError(
            LEVELS_MODEL_MISMATCH,
            (
                "does not match the levels, which are {size:.3g} m large: half of their vertices are more "
                "than {away:.3g} m away from it. It is another surface, or has other coordinates."
            ),
            "model",
            away=median_distance,
            size=size,
        )
    detail = estimate_mesh_detail(mesh)
    halved_copies = [
        surface.replace_mesh(downscale_images(mesh, detail * 2**halvings, 1.0))
        for halvings in range(1, _HALVED_COPIES + 1)
        if mesh.texture is not None
    ]
    return ColorSource(surface, halved_copies, estimate_triangle_details(mesh))


def paint_tile_images(
    tiles: Sequence[TileMesh], color_source: ColorSource, params: TileImageParams
) -> Iterator[tuple[int, Mesh, TileImage]]:
    """Paint the images of all tiles.

    Tiles are painted after all tiles in their `finer_tiles`. The result does not depend on the number of
    threads.

    Yields
    ------
    Index of the tile, its textured mesh, and the metrics of its image.

    Raises
    ------
    MeshError
        If a tile has no area or only degenerate triangles, or has too many charts for an image of
        `image_side`.
    """
    pending = set(range(len(tiles)))
    painted: dict[int, tuple[Mesh, float]] = {}
    while pending:
        batch = sorted(number for number in pending if painted.keys() >= set(tiles[number].finer_tiles))
        pending -= set(batch)
        paint = partial(_paint_tile, tiles, color_source, params, painted)
        painted_now = {}
        threads = get_worker_count()
        for number, result in zip(
            batch, map_ordered(paint, batch, threads=threads, max_pending=threads + 1), strict=True
        ):
            painted_now[number] = result.plain, result.image.texel_size
            yield number, result.mesh, result.image
        painted |= painted_now
        needed = {other for number in pending for other in tiles[number].finer_tiles}
        for number in painted.keys() - needed:
            # Release the mesh; the texel size and the fact that the tile is painted are still needed.
            painted[number] = _EMPTY_MESH, painted[number][1]


_EMPTY_MESH = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))


@dataclass(frozen=True, eq=False)
class _PaintedTile:
    """Tile with its image, raw (`plain`) and encoded (`mesh`)."""

    plain: Mesh
    mesh: Mesh
    image: TileImage


def _paint_tile(
    tiles: Sequence[TileMesh],
    color_source: ColorSource,
    params: TileImageParams,
    painted_tiles: Mapping[int, tuple[Mesh, float]],
    number: int,
) -> _PaintedTile:
    tile = tiles[number]
    mesh = tile.mesh
    require_area(mesh, "tile")
    detail = color_source.estimate_detail(mesh)
    requested_texel_size = max(tile.error / params.texels_per_error, detail)
    pages = lay_out_single(mesh, requested_texel_size, max_side=params.image_side)
    texel_size = pages.compute_mean_texel_size(mesh)
    if tile.finer_tiles and texel_size > _MAX_DETAIL_RATIO * detail:
        surface, detail = _merge_nearby_tiles(tile, texel_size, tiles, painted_tiles)
    else:
        surface, detail = color_source.select_resolution(texel_size, detail)
    samples = min(max(round(_SAMPLES_PER_DETAIL * texel_size / detail), 1), _MAX_SAMPLES)
    colors_of = ColorLookup(surface, mesh, texel_size)
    # One thread: tiles are already painted in parallel.
    painted = paint_pages(mesh, pages, samples, colors_of, continues_beyond=True, threads=1)
    (pixels,) = painted.images
    encoded = encode_image(pixels, params.image_format, params.image_quality)
    uvs = _quantize_uvs(pages)

    def attach_image(image: Image) -> Mesh:
        material = Material(image=image, wrap=("clamp", "clamp"))
        return mesh.with_(texture=Texture(uvs, pages.images, (material,)))

    # A separate Image object: decoding caches the pixels, which must not be kept with the result.
    rms, color_95, color_max = _compute_color_error(
        attach_image(Image(encoded=encoded)), color_source.surface, texel_size
    )
    is_coarser = texel_size > _MAX_TEXEL_RATIO * requested_texel_size
    height, width = pixels.shape[:2]
    image = TileImage(
        len(encoded), (width, height), texel_size, painted.coverage, is_coarser, rms, color_95, color_max
    )
    return _PaintedTile(attach_image(Image(given=pixels)), attach_image(Image(encoded=encoded)), image)


def _quantize_uvs(pages: AtlasLayout) -> Floats:
    """Round texture coordinates to 16 bits, as in the file."""
    return np.asarray(np.rint(pages.uvs * _UV_STEPS).clip(0, _UV_STEPS) / _UV_STEPS)


def _merge_nearby_tiles(
    tile: TileMesh,
    texel_size: float,
    tiles: Sequence[TileMesh],
    painted_tiles: Mapping[int, tuple[Mesh, float]],
) -> tuple[RaycastingSurface, float]:
    """Merge the finer tiles around a tile into one surface.

    Returns
    -------
    The surface, and the minimum texel size of the tiles, metres.
    """
    low, high = compute_bounding_box(tile.mesh)
    nearby = []
    for number in tile.finer_tiles:
        margin = _REACH_TEXELS * texel_size + _REACH_ERRORS * (tile.error + tiles[number].error)
        tile_low, tile_high = compute_bounding_box(tiles[number].mesh)
        if ((tile_low <= high + margin) & (tile_high >= low - margin)).all():
            nearby.append(number)
    meshes = [painted_tiles[number][0] for number in nearby]
    mesh = _merge_textured_meshes(meshes)
    return RaycastingSurface(mesh, compute_bounding_box(mesh, tile.mesh)), min(
        painted_tiles[number][1] for number in nearby
    )


def _merge_textured_meshes(meshes: Sequence[Mesh]) -> Mesh:
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


def _sample_points(mesh: Mesh) -> tuple[NDArray[np.int64], Floats]:
    """Sample points uniformly and reproducibly on a mesh.

    Returns
    -------
    Triangles (k,) and barycentric weights (k, 3).
    """
    rng = np.random.default_rng(0)
    area = compute_areas(mesh.vertices, mesh.triangles)
    triangles = np.sort(rng.choice(len(area), _SAMPLE_POINTS, p=area / area.sum())).astype(np.int64)
    return triangles, rng.dirichlet((1, 1, 1), _SAMPLE_POINTS)


def _compute_color_error(
    mesh: Mesh, reference: RaycastingSurface, texel_size: float
) -> tuple[float, float, float]:
    """Compute the colour error of a textured mesh against a model, levels.

    Returns
    -------
    RMS over points and channels, 95th percentile and maximum over points.
    """
    triangles, weights = _sample_points(mesh)
    reference_colors, _ = ColorLookup(reference, mesh, texel_size)(triangles, weights)
    differences = np.abs(compute_surface_colors(mesh, triangles, weights) - reference_colors)
    max_differences = differences.max(axis=1)
    return (
        float(np.sqrt((differences**2).mean())),
        float(np.quantile(max_differences, 0.95)),
        float(max_differences.max()),
    )


def _round_to_three_digits(value: float) -> float:
    return float(f"{value:.3g}")
