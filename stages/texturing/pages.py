"""The images of a texture: the surface laid out in them, and what lies under their texels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages import _kernels
from stages.progress import Progress
from stages.surface.mesh import Mesh
from stages.surface.topology import areas

# Of an image, that charts fill in the mean; used to choose its size.
_FILLED = 0.62
_MIN_SIDE = 64
# Rows of an image are a multiple of this, so that it can be halved a few times.
_ROWS = 64


@dataclass(frozen=True, eq=False)
class Pages:
    """Where each triangle lies in which image.

    Attributes
    ----------
    corners : (m, 3, 2) float64, x and y in texels from the upper left corner of the image.
    pages : (m,) int32, the image of each triangle; -1 for those without area, which have none.
    charts : (m,) int32, likewise the chart.
    sizes : (width, height) of each image, texels.
    padding : texels around each chart that are its own, at least.
    texels_per_m : of each triangle.
    """

    corners: NDArray[np.float64]
    pages: NDArray[np.int32]
    charts: NDArray[np.int32]
    sizes: tuple[tuple[int, int], ...]
    padding: int
    texels_per_m: NDArray[np.float32]

    @property
    def uvs(self) -> NDArray[np.float64]:
        """Return texture coordinates (m, 3, 2); (0, 0) is the lower left corner of the image."""
        sizes = np.array([*self.sizes, (1, 1)], np.float64)[self.pages]
        return np.asarray(self.corners * (1, -1) / sizes[:, None] + (0, 1))


def laid_out(
    mesh: Mesh,
    texels_per_m: NDArray[np.float32],
    *,
    max_side: int,
    max_texels: float,
    padding: int,
    progress: Progress,
) -> Pages:
    """Lay a mesh out in as many images as it needs; the same mesh gives the same images.

    Parameters
    ----------
    texels_per_m : (m,) wanted for each triangle; less where all images had more than `max_texels`.
    max_side : texels, of an image.
    padding : texels around each chart that are its own, at least.
    """
    wanted = (
        float((areas(mesh.vertices, mesh.triangles) * texels_per_m.astype(np.float64) ** 2).sum()) / _FILLED
    )
    density = (texels_per_m * min(1.0, math.sqrt(max_texels / max(wanted, 1.0)))).astype(np.float32)
    side = _MIN_SIDE
    while side < max_side and side * side < min(wanted, max_texels):
        side *= 2
    found = _kernels.lay_out(
        mesh.vertices, mesh.triangles, density, side=side, padding=padding, progress=progress
    )
    sizes = tuple((side, min(-(-height // _ROWS) * _ROWS, side)) for height in found.heights)
    return Pages(found.corners, found.pages, found.charts, sizes, padding, density)


@dataclass(frozen=True, eq=False)
class Texels:
    """Texels of one image that show the surface, in the order of their triangles.

    Attributes
    ----------
    pixels : (n,) uint32, row × width + column.
    triangles : (n,) uint32.
    shares : (n, 3) float32, of the triangle's corners.
    """

    pixels: NDArray[np.uint32]
    triangles: NDArray[np.uint32]
    shares: NDArray[np.float32]


def texels_of(pages: Pages, page: int) -> Texels:
    """Return what lies under the texels of an image."""
    width, height = pages.sizes[page]
    return Texels(*_kernels.texels(pages.corners, pages.pages, page=page, width=width, height=height))
