"""The images of a mesh that is laid out, with the colours of an original."""

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

# Levels that what lies beyond the border of a chart may differ from what it shows: a step of colour along an
# edge, where charts like to end, must not show before it.
_MOST_STEP = 24.0
# Bounds the memory, at some 400 bytes each.
_SAMPLES_AT_ONCE = 1 << 19


@dataclass(frozen=True, eq=False)
class PaintedPages:
    """Images full to their edges; the shares of them that charts have, and of samples that faced away."""

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
    """Give each texel the mean of what the original shows under it; the same on any number of threads.

    Parameters
    ----------
    samples : along each side of a texel.
    goes_on : whether the mesh is a piece of a surface that goes on where the piece ends; else there is
        nothing beyond its end.
    threads : all that are worth having if not given.
    progress : told of rows of the images.
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
            # As many rows as texels, of all that show the surface.
            ready += len(part.pixels)
            progress(done + height * ready // len(found.pixels), rows)
        shows = np.zeros(height * width, bool)
        shows[found.pixels] = True
        filled += len(found.pixels)
        images.append(filled_up(image.reshape(height, width, 3), shows.reshape(height, width), pages.padding))
        done += height
    return PaintedPages(images, filled / texels, turned / max(filled * samples**2, 1))
