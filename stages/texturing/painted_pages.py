"""Painting of an atlas with the colours of an original surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.progress import Progress, silent
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.texturing.facing import FacingColors
from scanloom.stages.texturing.filling import filled_up
from scanloom.stages.texturing.pages import Pages, Texels, texels_of
from scanloom.stages.texturing.texel_samples import END, WITHIN, borders, samples_under

# Maximum colour change beyond the border of a chart, in levels. Charts often end at edges of the shape, where
# colours change abruptly; the change must not bleed into the chart.
_MOST_STEP = 24.0
# Samples per batch, at about 400 bytes each: bounds memory.
_SAMPLES_AT_ONCE = 1 << 19


@dataclass(frozen=True, eq=False)
class PaintedPages:
    """Painted images of an atlas.

    Attributes
    ----------
    images : (h, w, 3) uint8 each, with filled gaps.
    coverage : ratio of the texels that show the surface.
    turned : ratio of samples whose nearest source point faced away and was replaced.
    """

    images: list[NDArray[np.uint8]]
    coverage: float
    turned: float


def painted_pages(
    mesh: Mesh,
    pages: Pages,
    samples: int,
    colors_of: FacingColors,
    *,
    goes_on: bool = False,
    threads: int | None = None,
    progress: Progress = silent,
) -> PaintedPages:
    """Paint each texel with the mean colour of the original under it.

    The result does not depend on the number of threads.

    Parameters
    ----------
    samples : samples along each side of a texel.
    colors_of : colour lookup on the original.
    goes_on : the mesh is a part of a larger surface, so colours are continued beyond its boundary. If False,
        the colour of the boundary is repeated there.
    threads : number of threads; by default all that help.
    progress : called with the number of finished rows of the images and their total.
    """
    sides = borders(mesh, pages)
    texel_size = pages.texel_size(mesh)

    def means(width: int, part: Texels) -> tuple[NDArray[np.float32], int]:
        triangles, weights = samples_under(mesh, pages, part, width, samples, texel_size)
        colors, turned = colors_of(triangles, weights)
        crossed = np.where(weights < 0, sides[triangles], WITHIN).max(axis=1)
        (beyond,) = np.nonzero(crossed > WITHIN)
        inside = weights[beyond].clip(0)
        last, _ = colors_of(triangles[beyond], inside / inside.sum(axis=1, keepdims=True))
        most = np.where((crossed[beyond] == END) & (not goes_on), 0.0, _MOST_STEP)[:, None]
        colors[beyond] = last + (colors[beyond] - last).clip(-most, most)
        return colors.reshape(len(part.pixels), -1, 3).mean(axis=1).astype(np.float32), turned

    rows = sum(height for _, height in pages.sizes)
    texels = sum(width * height for width, height in pages.sizes)
    done = filled = turned = 0
    images = []
    threads = threads or workers()
    for number, (width, height) in enumerate(pages.sizes):
        found = texels_of(pages, number)
        parts = found.parts(_SAMPLES_AT_ONCE // samples**2)
        paint = partial(means, width)
        ready = 0
        image = np.zeros((height * width, 3), np.float32)
        results = (
            map(paint, parts)
            if threads == 1
            else read_ahead(paint, parts, threads=threads, ahead=threads + 1)
        )
        for part, (colors, away) in zip(parts, results, strict=True):
            image[part.pixels] = colors
            turned += away
            # Progress in rows is estimated from the ratio of finished texels.
            ready += len(part.pixels)
            progress(done + height * ready // len(found.pixels), rows)
        shows = np.zeros(height * width, bool)
        shows[found.pixels] = True
        filled += len(found.pixels)
        images.append(filled_up(image.reshape(height, width, 3), shows.reshape(height, width), pages.padding))
        done += height
    return PaintedPages(images, filled / texels, turned / max(filled * samples**2, 1))
