"""Atlas pages: layout of a surface in images."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import compute_signed_areas
from scanloom.stages.surface.topology import compute_areas
from scanloom.stages.texturing.codes import TEXTURE_ATLAS_TOO_SMALL

# Typical ratio of an image that charts fill; used to choose the image size.
_TYPICAL_FILL_RATIO = 0.62
_MIN_SIDE = 64
# Heights are multiples of this number of rows, so that images can be halved a few times (mip levels).
_ROW_MULTIPLE = 64
# Fill ratio of a square image that the first attempted side must not exceed.
_MAX_INITIAL_FILL_RATIO = 0.5
_MIN_PADDING = 2
# Default padding: one texel per this many texels of the image's side.
_SIDE_PER_PADDING = 256
# An image counts as full if its density is at least this ratio of a density that did not fit (`_FULL_RATIO`).
# Maximum number of attempts (`_MAX_FILL_ATTEMPTS`).
_FULL_RATIO = 0.985
_MAX_FILL_ATTEMPTS = 6
# Growth of the density per attempt, on top of the growth that the free rows suggest.
_DENSITY_GROWTH = 1.04
# Minimum side of an image in multiples of the padding; smaller images have no space for a chart.
_MIN_SIDE_PER_PADDING = 4
# For single-image layouts: texels of the side per texel of padding, and maximum padding. Viewers rarely use
# more than two mip levels of a tile's image.
_SINGLE_SIDE_PER_PADDING = 128
_SINGLE_MAX_PADDING = 8
# Growth of the side per attempt. Minimum density relative to the requested density: below, charts are mere
# points.
_SINGLE_SIDE_GROWTH = 1.12
_MIN_DENSITY_RATIO = 1e-4


@dataclass(frozen=True, eq=False)
class AtlasLayout:
    """Atlas layout: position of each triangle in the images.

    Attributes
    ----------
    corners : (m, 3, 2) float64, x and y in texels from the upper left corner of the image.
    pages : (m,) int32, image of each triangle; -1 for triangles without area.
    charts : (m,) int32, chart of each triangle; -1 for triangles without area.
    images : (m,) int32, image that `corners` refer to. A triangle without area is put at a corner of another
        triangle that shares its first vertex, or else into the first image.
    sizes : (width, height) of each image, texels.
    padding : minimum number of texels around each chart that continue its colours.
    texels_per_m : (m,) linear texel density of each triangle.
    """

    corners: NDArray[np.float64]
    pages: NDArray[np.int32]
    charts: NDArray[np.int32]
    images: NDArray[np.int32]
    sizes: tuple[tuple[int, int], ...]
    padding: int
    texels_per_m: NDArray[np.floating]

    @property
    def uvs(self) -> NDArray[np.float64]:
        """Texture coordinates (m, 3, 2); (0, 0) is the lower left corner of the image."""
        sizes = np.array(self.sizes, np.float64)[self.images]
        return np.asarray(self.corners * (1, -1) / sizes[:, None] + (0, 1))

    def reduce(self, factor: int) -> AtlasLayout:
        """Return the layout for images that are smaller by a factor along each side.

        The factor must divide the sizes of all images.
        """
        return replace(
            self,
            corners=self.corners / factor,
            sizes=tuple((width // factor, height // factor) for width, height in self.sizes),
            padding=self.padding // factor,
            texels_per_m=self.texels_per_m / factor,
        )

    def compute_mean_texel_size(self, mesh: Mesh) -> float:
        """Return the mean size of a texel on the mesh, metres."""
        area = float(compute_areas(mesh.vertices, mesh.triangles).sum())
        return math.sqrt(area / float(np.abs(compute_signed_areas(self.corners)).sum()))

    def compute_median_texel_size(self) -> float:
        """Return the median size of a texel on the mesh, metres."""
        texels = np.abs(compute_signed_areas(self.corners))
        order = np.argsort(self.texels_per_m, kind="stable")
        before = np.cumsum(texels[order])
        middle = min(int(np.searchsorted(before, before[-1] / 2)), len(order) - 1)
        return 1 / float(self.texels_per_m[order[middle]])


def lay_out_by_density(
    mesh: Mesh,
    texels_per_m: NDArray[np.float32],
    *,
    curve_positions: NDArray[np.uint32],
    max_side: int,
    max_texels: float,
    padding: int,
    progress: Progress,
) -> AtlasLayout:
    """Lay a mesh out in as many images as needed.

    The layout is deterministic. Each of several images shows one region of space, so that few photos show it.

    Parameters
    ----------
    texels_per_m : (m,) requested density of each triangle; reduced if the images would exceed `max_texels`.
    curve_positions : (m,) uint32, position of each triangle along a space-filling curve.
    max_side : maximum side of an image, texels.
    max_texels : maximum texels of all images together.
    padding : minimum number of texels around each chart that continue its colours.
    progress : called by the layout kernel.
    """
    texels = compute_areas(mesh.vertices, mesh.triangles) * texels_per_m.astype(np.float64) ** 2
    requested_texels = float(texels.sum()) / _TYPICAL_FILL_RATIO
    density = (texels_per_m * min(1.0, math.sqrt(max_texels / max(requested_texels, 1.0)))).astype(np.float32)
    side = _MIN_SIDE
    while side < max_side and side * side < min(requested_texels, max_texels):
        side *= 2
    count = math.ceil(min(requested_texels, max_texels) / side**2)
    texels_by_position = np.bincount(curve_positions, texels)
    before = np.cumsum(texels_by_position) - 0.5 * texels_by_position
    groups = (before * (count / max(float(texels.sum()), 1e-300))).astype(np.int32)[curve_positions]
    return _lay_out_groups(mesh, density, side, padding, progress, groups)


def lay_out_smallest(
    mesh: Mesh,
    texel_size: float,
    *,
    max_side: int,
    max_texels: float,
    padding: int | None,
    progress: Progress,
) -> AtlasLayout:
    """Lay a mesh out in the smallest possible square image.

    The density is increased until the image is full. If the largest image is too small, the layout uses
    several of the largest size. It is deterministic.

    Parameters
    ----------
    texel_size : maximum size of a texel on the surface, metres. Texels are larger if the surface would exceed
        `max_texels`; the image is then not filled up.
    max_side : maximum side of an image, texels.
    max_texels : maximum texels of surface in all images together.
    padding : minimum number of texels around each chart that continue its colours. By default 1/256 of the
        side, which is enough for a few mip levels, and 2 where that takes too much space.
    progress : called by the layout kernel.

    Raises
    ------
    MeshError
        If all triangles are degenerate.
    """
    area = float(compute_areas(mesh.vertices, mesh.triangles).sum())
    density = min(1 / texel_size, math.sqrt(max_texels / area))
    try_layout = partial(_lay_out_evenly, mesh, progress)
    side = _MIN_SIDE
    while side < max_side and (
        _MAX_INITIAL_FILL_RATIO * side**2 < area * density**2
        or side <= _MIN_SIDE_PER_PADDING * (padding or 0)
    ):
        side *= 2
    while True:
        used_padding = padding or max(_MIN_PADDING, side // _SIDE_PER_PADDING)
        pages = try_layout(density, side, used_padding)
        if len(pages.sizes) == 1:
            return (
                _fill_square(try_layout, pages, density, side, used_padding)
                if density == 1 / texel_size
                else pages
            )
        if side == max_side:
            break
        needed = (len(pages.sizes) - 1) * side**2
        side *= 2
        while side < max_side and side**2 < needed:
            side *= 2
    if (
        padding is None
        and sum(width * height for width, height in pages.sizes) > max_texels / _TYPICAL_FILL_RATIO
    ):
        pages = try_layout(density, side, _MIN_PADDING)
    return pages


def lay_out_single(mesh: Mesh, texel_size: float, *, max_side: int) -> AtlasLayout:
    """Lay a mesh out in one tightly sized image.

    The sides of the image need not be powers of two.

    Parameters
    ----------
    texel_size : size of a texel on the surface, metres; larger if the image would exceed `max_side`.
    max_side : maximum side of the image, texels.

    Raises
    ------
    MeshError
        If all triangles are degenerate, or the mesh has too many connected components for one image.
    """
    area = float(compute_areas(mesh.vertices, mesh.triangles).sum())
    density = 1 / texel_size
    side = _round_side(math.sqrt(area) * density / math.sqrt(_TYPICAL_FILL_RATIO), max_side)
    while density * texel_size > _MIN_DENSITY_RATIO:
        padding = min(max(_MIN_PADDING, side // _SINGLE_SIDE_PER_PADDING), _SINGLE_MAX_PADDING)
        pages = _lay_out_evenly(mesh, ignore_progress, density, side, padding)
        if len(pages.sizes) == 1:
            return pages
        if side == max_side:
            density /= _SINGLE_SIDE_GROWTH
        else:
            side = _round_side(side * _SINGLE_SIDE_GROWTH, max_side)
    raise MeshError(
        TEXTURE_ATLAS_TOO_SMALL,
        "has too many charts for an image of {max_side} × {max_side} texels.",
        "mesh",
        max_side=max_side,
    )


def lay_out_within(
    mesh: Mesh,
    densities: NDArray[np.float64],
    *,
    texels: float,
    max_texels: float | None,
    max_side: int,
) -> AtlasLayout:
    """Lay a mesh out with a given number of texels.

    Parameters
    ----------
    densities : (m,) linear texel density of each triangle, relative to each other.
    texels : number of texels that charts shall cover; fewer if `max_texels` requires it.
    max_texels : maximum texels of all images, gaps included; None for no limit.
    max_side : maximum side of an image, texels.

    Raises
    ------
    MeshError
        If all triangles are degenerate, or the mesh has too many charts for the texel limit.
    """
    weighted = compute_areas(mesh.vertices, mesh.triangles) * densities**2
    texel_limit = math.inf if max_texels is None else max_texels
    scale = math.sqrt(min(texels, _TYPICAL_FILL_RATIO * texel_limit) / float(weighted.sum()))
    smallest = scale * _MIN_DENSITY_RATIO
    side = _round_side(math.sqrt(min(texels / _TYPICAL_FILL_RATIO, texel_limit)), max_side)
    while scale > smallest:
        padding = max(_MIN_PADDING, side // _SIDE_PER_PADDING)
        # Scaled to texels: single precision then resolves a texel whatever the unit of length.
        scaled = mesh.with_(vertices=(mesh.vertices - mesh.vertices[mesh.triangles[0, 0]]) * scale)
        pages = _lay_out_groups(scaled, densities.astype(np.float32), side, padding, ignore_progress)
        total = sum(width * height for width, height in pages.sizes)
        if total <= texel_limit and (len(pages.sizes) == 1 or side == max_side):
            return replace(pages, texels_per_m=np.asarray(densities * scale))
        larger = _round_side(side * _SINGLE_SIDE_GROWTH, max_side)
        if len(pages.sizes) > 1 and side < larger and larger**2 <= texel_limit:
            side = larger
        else:
            # The last of several images is only as high as needed, so the total may be far below the limit.
            scale *= (
                min(math.sqrt(min(texel_limit, side**2) / total), 0.97)
                if total > texel_limit
                else 1 / _SINGLE_SIDE_GROWTH
            )
    raise MeshError(
        TEXTURE_ATLAS_TOO_SMALL,
        "has too many charts for images with as few texels as the original's.",
        "mesh",
    )


def _round_side(side: float, max_side: int) -> int:
    return min(max(math.ceil(side / _ROW_MULTIPLE) * _ROW_MULTIPLE, _MIN_SIDE), max_side)


def _fill_square(
    try_layout: Callable[[float, int, int], AtlasLayout],
    pages: AtlasLayout,
    density: float,
    side: int,
    padding: int,
) -> AtlasLayout:
    """Increase the density until the charts almost fill one square image."""
    too_dense = math.inf
    for _ in range(_MAX_FILL_ATTEMPTS):
        # Extrapolate as if all rows were filled alike.
        used = float(pages.corners[:, :, 1].max()) + padding
        next_density = min(density * math.sqrt(side / used) * _DENSITY_GROWTH, math.sqrt(density * too_dense))
        denser_pages = try_layout(next_density, side, padding)
        if len(denser_pages.sizes) == 1:
            pages, density = denser_pages, next_density
        else:
            too_dense = next_density
        if density > _FULL_RATIO * too_dense:
            break
    return replace(pages, sizes=((side, side),))


def _lay_out_evenly(mesh: Mesh, progress: Progress, density: float, side: int, padding: int) -> AtlasLayout:
    # Scaled to texels: single precision then resolves a texel whatever the unit of length.
    scaled = mesh.with_(vertices=(mesh.vertices - mesh.vertices[mesh.triangles[0, 0]]) * density)
    found = _lay_out_groups(scaled, np.ones(len(mesh.triangles), np.float32), side, padding, progress)
    return replace(found, texels_per_m=np.full(len(mesh.triangles), density))


def _lay_out_groups(
    mesh: Mesh,
    density: NDArray[np.float32],
    side: int,
    padding: int,
    progress: Progress,
    groups: NDArray[np.int32] | None = None,
) -> AtlasLayout:
    """Lay a mesh out in square images.

    Each group of triangles, `split` (m,), gets separate images.
    """
    count = len(mesh.triangles)
    corners, pages, charts = (
        np.zeros((count, 3, 2)),
        np.full(count, -1, np.int32),
        np.full(count, -1, np.int32),
    )
    sizes: list[tuple[int, int]] = []
    found_charts = 0
    groups = np.zeros(count, np.int32) if groups is None else groups
    for number in np.unique(groups):
        chosen = np.flatnonzero(groups == number)
        part = mesh if len(chosen) == count else _select_triangles(mesh, chosen)
        found = _kernels.lay_out_atlas(
            part.vertices, part.triangles, density[chosen], side=side, padding=padding, progress=progress
        )
        is_out = found.pages < 0
        corners[chosen] = found.corners
        pages[chosen] = np.where(is_out, -1, found.pages + len(sizes))
        charts[chosen] = np.where(is_out, -1, found.charts + found_charts)
        sizes += [(side, min(-(-height // _ROW_MULTIPLE) * _ROW_MULTIPLE, side)) for height in found.heights]
        found_charts += int(found.charts.max(initial=-1)) + 1
    if not sizes:
        raise MeshError(
            TEXTURE_ATLAS_TOO_SMALL,
            "all triangles are needles without a measurable area; they cannot be laid out in an image.",
            "mesh",
        )
    if not compute_signed_areas(corners).any():
        raise MeshError(
            TEXTURE_ATLAS_TOO_SMALL,
            "is so small compared with the texel size that its charts have no area in an image.",
            "mesh",
        )
    images = pages.copy()
    _place_flat(mesh, corners, images)
    return AtlasLayout(corners, pages, charts, images, tuple(sizes), padding, density)


def _select_triangles(mesh: Mesh, chosen: NDArray[np.intp]) -> Mesh:
    used, local = np.unique(mesh.triangles[chosen], return_inverse=True)
    return Mesh(mesh.vertices[used], local.reshape(-1, 3).astype(np.int32))


def _place_flat(mesh: Mesh, corners: NDArray[np.float64], images: NDArray[np.int32]) -> None:
    """Give triangles without area the texture coordinate of a neighbour, in place.

    The coordinate is taken from another triangle at their first vertex, and stays 0 if no other triangle has
    this vertex.
    """
    (flat,) = np.nonzero(images < 0)
    (others,) = np.nonzero(images >= 0)
    place, image = np.zeros((len(mesh.vertices), 2)), np.zeros(len(mesh.vertices), np.int32)
    place[mesh.triangles[others]] = corners[others]
    image[mesh.triangles[others]] = images[others, None]
    first = mesh.triangles[flat, 0]
    corners[flat], images[flat] = place[first, None], image[first]


@dataclass(frozen=True, eq=False)
class PageTexels:
    """Texels of one image that show the surface, ordered by triangle.

    Attributes
    ----------
    pixels : (n,) uint32, row × width + column.
    triangles : (n,) uint32.
    weights : (n, 3) float32, barycentric weights of the triangle's corners.
    width : width of the image, texels.
    """

    pixels: NDArray[np.uint32]
    triangles: NDArray[np.uint32]
    weights: NDArray[np.float32]
    width: int

    def split(self, count: int) -> list[PageTexels]:
        """Split the texels into chunks of at most `count`."""
        return [self._select(slice(start, start + count)) for start in range(0, len(self.pixels), count)]

    def split_by_location(self, curve_positions: NDArray[np.uint32], count: int) -> Iterator[PageTexels]:
        """Split the texels into spatially compact chunks of at most `count`.

        Parameters
        ----------
        curve_positions : (m,) position of each triangle of the mesh along a space-filling curve.
        count : maximum texels of a chunk.
        """
        if len(self.pixels) <= count:
            yield self
            return
        in_part = math.ceil(len(self.pixels) / math.ceil(len(self.pixels) / count))
        of_places = np.bincount(curve_positions[self.triangles], minlength=int(curve_positions.max()) + 1)
        part_of_place = np.maximum(np.cumsum(of_places) - 1, 0) // in_part
        # uint16 saves memory: there are many texels.
        part = part_of_place.astype(np.uint16)[curve_positions][self.triangles]
        for number in range(int(part_of_place[-1]) + 1):
            # A single curve position may have more than `count` texels and is split again.
            yield from self._select(np.flatnonzero(part == number)).split(count)

    def _select(self, rows: slice | NDArray[np.intp]) -> PageTexels:
        return PageTexels(self.pixels[rows], self.triangles[rows], self.weights[rows], self.width)


def rasterize_texels(pages: AtlasLayout, page: int) -> PageTexels:
    """Rasterise the triangles of an image: the surface point under each texel."""
    width, height = pages.sizes[page]
    return PageTexels(
        *_kernels.rasterize_texels(pages.corners, pages.pages, page=page, width=width, height=height),
        width=width,
    )
