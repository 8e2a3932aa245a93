"""The images of a texture: the surface laid out in them, and what lies under their texels."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.progress import Progress, silent
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import signed_areas
from scanloom.stages.surface.topology import areas
from scanloom.stages.texturing.codes import TEXTURE_ATLAS_TOO_SMALL

# Of an image, that charts fill in the mean; used to choose its size.
_FILLED = 0.62
_MIN_SIDE = 64
# Rows of an image are a multiple of this, so that it can be halved a few times.
_ROWS = 64
# Of a square image, what is to be filled at least: no smaller one is tried.
_LEAST_FILLED = 0.5
_LEAST_PADDING = 2
# So many texels of an image's side have one texel of padding by default.
_SIDE_PER_PADDING = 256
# An image is full if its charts are as large as this, at least, of the size that does not fit; so often is it
# tried to fill it.
_FULL = 0.985
_FILLINGS = 6
# Of the density, at least, from one try to the next.
_GROWTH = 1.04
# A side has room for a chart if it is longer than so many times the padding.
_SIDES_OF_PADDING = 4
# Where one image is to hold all: texels of its side to one of padding, and the most of that. Viewers show a
# tile's image hardly ever halved more than once or twice.
_SIDE_PER_PADDING_OF_ONE = 128
_MOST_PADDING_OF_ONE = 8
# From one try to the next, of its side; and of its density, so little that pieces are mere points.
_GROWTH_OF_ONE = 1.12
_LEAST_DENSITY = 1e-4


@dataclass(frozen=True, eq=False)
class Pages:
    """Where each triangle lies in which image.

    Attributes
    ----------
    corners : (m, 3, 2) float64, x and y in texels from the upper left corner of the image.
    pages : (m,) int32, the image of each triangle; -1 for those without area, which have none.
    charts : (m,) int32, likewise the chart.
    images : (m,) int32, the image that `corners` lie in: those of a triangle without area are where another
        triangle has its first corner, in the first image if none has.
    sizes : (width, height) of each image, texels.
    padding : texels around each chart that are its own, at least.
    texels_per_m : of each triangle.
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
        """Return texture coordinates (m, 3, 2); (0, 0) is the lower left corner of the image."""
        sizes = np.array(self.sizes, np.float64)[self.images]
        return np.asarray(self.corners * (1, -1) / sizes[:, None] + (0, 1))

    def texel_size(self, mesh: Mesh) -> float:
        """Return how large a texel is on the mesh, metres, in the mean."""
        area = float(areas(mesh.vertices, mesh.triangles).sum())
        return math.sqrt(area / float(np.abs(signed_areas(self.corners)).sum()))

    def usual_texel_size(self) -> float:
        """Return how large a texel is on the mesh, metres, the median of all."""
        texels = np.abs(signed_areas(self.corners))
        order = np.argsort(self.texels_per_m, kind="stable")
        before = np.cumsum(texels[order])
        middle = min(int(np.searchsorted(before, before[-1] / 2)), len(order) - 1)
        return 1 / float(self.texels_per_m[order[middle]])


def laid_out(
    mesh: Mesh,
    texels_per_m: NDArray[np.float32],
    *,
    places: NDArray[np.uint32],
    max_side: int,
    max_texels: float,
    padding: int,
    progress: Progress,
) -> Pages:
    """Lay a mesh out in as many images as it needs; the same mesh gives the same images.

    Of several images each shows a part of space, so that few photos show it.

    Parameters
    ----------
    texels_per_m : (m,) wanted for each triangle; less where all images had more than `max_texels`.
    places : (m,) of the triangles along a curve through space.
    max_side : texels, of an image.
    padding : texels around each chart that are its own, at least.
    """
    texels = areas(mesh.vertices, mesh.triangles) * texels_per_m.astype(np.float64) ** 2
    wanted = float(texels.sum()) / _FILLED
    density = (texels_per_m * min(1.0, math.sqrt(max_texels / max(wanted, 1.0)))).astype(np.float32)
    side = _MIN_SIDE
    while side < max_side and side * side < min(wanted, max_texels):
        side *= 2
    count = math.ceil(min(wanted, max_texels) / side**2)
    of_places = np.bincount(places, texels)
    before = np.cumsum(of_places) - 0.5 * of_places
    parts = (before * (count / max(float(texels.sum()), 1e-300))).astype(np.int32)[places]
    return _pages(mesh, density, side, padding, progress, parts)


def fitted(
    mesh: Mesh,
    texel_size: float,
    *,
    max_side: int,
    max_texels: float,
    padding: int | None,
    progress: Progress,
) -> Pages:
    """Lay a mesh out in the smallest square image that has room for it, and fill that.

    Where none has, there are several images, of the largest side. The same mesh gives the same images.

    Parameters
    ----------
    texel_size : metres, of a texel on the surface, at most; more where the surface had more than
        `max_texels`: the image is no larger than these need then.
    max_side : texels, of an image.
    padding : texels around each chart that are its own, at least; by default as many as images of this size
        need for a few halvings, or as few as are needed at all where there is no room for more.

    Raises
    ------
    MeshError
        If all triangles are needles.
    """
    area = float(areas(mesh.vertices, mesh.triangles).sum())
    density = min(1 / texel_size, math.sqrt(max_texels / area))
    tried = partial(_even, mesh, progress)
    side = _MIN_SIDE
    while side < max_side and (
        _LEAST_FILLED * side**2 < area * density**2 or side <= _SIDES_OF_PADDING * (padding or 0)
    ):
        side *= 2
    while True:
        room = padding or max(_LEAST_PADDING, side // _SIDE_PER_PADDING)
        pages = tried(density, side, room)
        if len(pages.sizes) == 1:
            return _filled(tried, pages, density, side, room) if density == 1 / texel_size else pages
        if side == max_side:
            break
        needed = (len(pages.sizes) - 1) * side**2
        side *= 2
        while side < max_side and side**2 < needed:
            side *= 2
    if padding is None and sum(width * height for width, height in pages.sizes) > max_texels / _FILLED:
        pages = tried(density, side, _LEAST_PADDING)
    return pages


def in_one(mesh: Mesh, texel_size: float, *, max_side: int) -> Pages:
    """Lay a mesh out in one image, hardly larger than needed, whose sides are no powers of two.

    Parameters
    ----------
    texel_size : metres, of a texel on the surface; more where the image had no room for that.
    max_side : texels.

    Raises
    ------
    MeshError
        If all triangles are needles, or the mesh is in so many pieces that no image has room for them.
    """
    area = float(areas(mesh.vertices, mesh.triangles).sum())
    density = 1 / texel_size
    side = _whole(math.sqrt(area) * density / math.sqrt(_FILLED), max_side)
    while density * texel_size > _LEAST_DENSITY:
        padding = min(max(_LEAST_PADDING, side // _SIDE_PER_PADDING_OF_ONE), _MOST_PADDING_OF_ONE)
        pages = _even(mesh, silent, density, side, padding)
        if len(pages.sizes) == 1:
            return pages
        if side == max_side:
            density /= _GROWTH_OF_ONE
        else:
            side = _whole(side * _GROWTH_OF_ONE, max_side)
    raise MeshError(
        TEXTURE_ATLAS_TOO_SMALL,
        "falls into too many pieces for an image of {max_side} × {max_side} texels.",
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
) -> Pages:
    """Lay a mesh out in images that hold so many texels of surface, and no more than so many in all.

    Parameters
    ----------
    densities : (m,) of the texels of each triangle along a length, relative to each other.
    texels : that charts cover, less where `max_texels` leaves no room for them.
    max_texels : of all images, gaps included; None for no limit.
    max_side : texels, of an image.

    Raises
    ------
    MeshError
        If all triangles are needles, or the mesh falls into too many charts for so few texels.
    """
    weighted = areas(mesh.vertices, mesh.triangles) * densities**2
    most = math.inf if max_texels is None else max_texels
    scale = math.sqrt(min(texels, _FILLED * most) / float(weighted.sum()))
    smallest = scale * _LEAST_DENSITY
    side = _whole(math.sqrt(min(texels / _FILLED, most)), max_side)
    while scale > smallest:
        padding = max(_LEAST_PADDING, side // _SIDE_PER_PADDING)
        # In texels: of any unit of length, single precision has room for one a texel.
        scaled = mesh.with_(vertices=(mesh.vertices - mesh.vertices[mesh.triangles[0, 0]]) * scale)
        pages = _pages(scaled, densities.astype(np.float32), side, padding, silent)
        total = sum(width * height for width, height in pages.sizes)
        if total <= most and (len(pages.sizes) == 1 or side == max_side):
            return replace(pages, texels_per_m=np.asarray(densities * scale))
        larger = _whole(side * _GROWTH_OF_ONE, max_side)
        if len(pages.sizes) > 1 and side < larger and larger**2 <= most:
            side = larger
        else:
            # Of several images, the last one is only as high as it has to be.
            scale *= min(math.sqrt(min(most, side**2) / total), 0.97) if total > most else 1 / _GROWTH_OF_ONE
    raise MeshError(
        TEXTURE_ATLAS_TOO_SMALL, "falls into too many charts for an image of so few texels.", "mesh"
    )


def _whole(side: float, max_side: int) -> int:
    return min(max(math.ceil(side / _ROWS) * _ROWS, _MIN_SIDE), max_side)


def _filled(
    tried: Callable[[float, int, int], Pages], pages: Pages, density: float, side: int, padding: int
) -> Pages:
    """Return the pages of about the largest density at which one square image has room for all."""
    too_much = math.inf
    for _ in range(_FILLINGS):
        # As if all rows were filled alike.
        used = float(pages.corners[:, :, 1].max()) + padding
        following = min(density * math.sqrt(side / used) * _GROWTH, math.sqrt(density * too_much))
        more = tried(following, side, padding)
        if len(more.sizes) == 1:
            pages, density = more, following
        else:
            too_much = following
        if density > _FULL * too_much:
            break
    return replace(pages, sizes=((side, side),))


def _even(mesh: Mesh, progress: Progress, density: float, side: int, padding: int) -> Pages:
    # In texels: of any unit of length, single precision has room for one a texel.
    scaled = mesh.with_(vertices=(mesh.vertices - mesh.vertices[mesh.triangles[0, 0]]) * density)
    found = _pages(scaled, np.ones(len(mesh.triangles), np.float32), side, padding, progress)
    return replace(found, texels_per_m=np.full(len(mesh.triangles), density))


def _pages(
    mesh: Mesh,
    density: NDArray[np.float32],
    side: int,
    padding: int,
    progress: Progress,
    parts: NDArray[np.int32] | None = None,
) -> Pages:
    """Lay a mesh out in square images of this side, each part (m,) of its triangles in images of its own."""
    count = len(mesh.triangles)
    corners, pages, charts = (
        np.zeros((count, 3, 2)),
        np.full(count, -1, np.int32),
        np.full(count, -1, np.int32),
    )
    sizes: list[tuple[int, int]] = []
    found_charts = 0
    parts = np.zeros(count, np.int32) if parts is None else parts
    for number in np.unique(parts):
        chosen = np.flatnonzero(parts == number)
        part = mesh if len(chosen) == count else _part(mesh, chosen)
        found = _kernels.lay_out(
            part.vertices, part.triangles, density[chosen], side=side, padding=padding, progress=progress
        )
        is_out = found.pages < 0
        corners[chosen] = found.corners
        pages[chosen] = np.where(is_out, -1, found.pages + len(sizes))
        charts[chosen] = np.where(is_out, -1, found.charts + found_charts)
        sizes += [(side, min(-(-height // _ROWS) * _ROWS, side)) for height in found.heights]
        found_charts += int(found.charts.max(initial=-1)) + 1
    if not sizes:
        raise MeshError(
            TEXTURE_ATLAS_TOO_SMALL,
            "all its triangles are needles; none can be laid out in an image.",
            "mesh",
        )
    images = pages.copy()
    _place_flat(mesh, corners, images)
    return Pages(corners, pages, charts, images, tuple(sizes), padding, density)


def _part(mesh: Mesh, chosen: NDArray[np.intp]) -> Mesh:
    used, local = np.unique(mesh.triangles[chosen], return_inverse=True)
    return Mesh(mesh.vertices[used], local.reshape(-1, 3).astype(np.int32))


def _place_flat(mesh: Mesh, corners: NDArray[np.float64], images: NDArray[np.int32]) -> None:
    """Put all corners of triangles without area where another triangle has the first one, if one has."""
    (flat,) = np.nonzero(images < 0)
    (others,) = np.nonzero(images >= 0)
    place, image = np.zeros((len(mesh.vertices), 2)), np.zeros(len(mesh.vertices), np.int32)
    place[mesh.triangles[others]] = corners[others]
    image[mesh.triangles[others]] = images[others, None]
    first = mesh.triangles[flat, 0]
    corners[flat], images[flat] = place[first, None], image[first]


@dataclass(frozen=True, eq=False)
class Texels:
    """Texels of one image that show the surface, in the order of their triangles.

    Attributes
    ----------
    pixels : (n,) uint32, row × width + column.
    triangles : (n,) uint32.
    shares : (n, 3) float32, of the triangle's corners.
    width : of the image.
    """

    pixels: NDArray[np.uint32]
    triangles: NDArray[np.uint32]
    shares: NDArray[np.float32]
    width: int

    def parts(self, count: int) -> list[Texels]:
        """Return them in parts of at most so many."""
        return [self._some(slice(start, start + count)) for start in range(0, len(self.pixels), count)]

    def parts_of(self, places: NDArray[np.uint32], count: int) -> Iterator[Texels]:
        """Yield them in parts of at most so many, each of triangles whose places are near each other.

        Parameters
        ----------
        places : (m,) of the triangles of the mesh, along a curve through space.
        """
        if len(self.pixels) <= count:
            yield self
            return
        in_part = math.ceil(len(self.pixels) / math.ceil(len(self.pixels) / count))
        of_places = np.bincount(places[self.triangles], minlength=int(places.max()) + 1)
        part_of_place = np.maximum(np.cumsum(of_places) - 1, 0) // in_part
        # In two bytes each: there are many texels.
        part = part_of_place.astype(np.uint16)[places][self.triangles]
        for number in range(int(part_of_place[-1]) + 1):
            # A place with more than `count` is cut once more.
            yield from self._some(np.flatnonzero(part == number)).parts(count)

    def _some(self, rows: slice | NDArray[np.intp]) -> Texels:
        return Texels(self.pixels[rows], self.triangles[rows], self.shares[rows], self.width)


def texels_of(pages: Pages, page: int) -> Texels:
    """Return what lies under the texels of an image."""
    width, height = pages.sizes[page]
    return Texels(
        *_kernels.texels(pages.corners, pages.pages, page=page, width=width, height=height), width=width
    )
