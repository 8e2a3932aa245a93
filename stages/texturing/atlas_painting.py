"""Painting of an atlas with the colours of an original surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.texturing.atlas_layout import AtlasLayout, PageTexels, rasterize_texels
from scanloom.stages.texturing.color_lookup import ColorLookup
from scanloom.stages.texturing.gap_filling import fill_gaps_smoothly
from scanloom.stages.texturing.texel_samples import INSIDE_CHART, MESH_BOUNDARY, classify_sides, sample_texels

# Maximum colour change beyond the border of a chart, in levels. Charts often end at edges of the shape, where
# colours change abruptly; the change must not bleed into the chart.
_MAX_BORDER_STEP_LEVELS = 24.0
# Samples per batch, at about 400 bytes each: bounds memory.
_BATCH_SAMPLES = 1 << 19


@dataclass(frozen=True, eq=False)
class PaintedPages:
    """Painted images of an atlas.

    Attributes
    ----------
    images : (h, w, 3) uint8 each, with filled gaps.
    coverage : ratio of the texels that show the surface.
    turned_ratio : ratio of samples whose nearest source point faced away and was replaced.
    """

    images: list[NDArray[np.uint8]]
    coverage: float
    turned_ratio: float


def paint_pages(
    mesh: Mesh,
    pages: AtlasLayout,
    samples: int,
    color_lookup: ColorLookup,
    *,
    continues_beyond: bool = False,
    threads: int | None = None,
    progress: Progress = ignore_progress,
) -> PaintedPages:
    """Paint each texel with the mean colour of the original under it.

    The result does not depend on the number of threads.

    Parameters
    ----------
    samples : samples along each side of a texel.
    color_lookup : colour lookup on the original.
    continues_beyond : the mesh is a part of a larger surface, so colours are continued beyond its boundary.
        If False,
        the colour of the boundary is repeated there.
    threads : number of threads; by default all that help.
    progress : called with the number of finished rows of the images and their total.
    """
    sides = classify_sides(mesh, pages)
    texel_size = pages.compute_mean_texel_size(mesh)

    def compute_means(width: int, part: PageTexels) -> tuple[NDArray[np.float32], int]:
        triangles, weights = sample_texels(mesh, pages, part, width, samples, texel_size)
        colors, turned = color_lookup(triangles, weights)
        crossed = np.where(weights < 0, sides[triangles], INSIDE_CHART).max(axis=1)
        (outside,) = np.nonzero(crossed > INSIDE_CHART)
        inside = weights[outside].clip(0)
        border_colors, _ = color_lookup(triangles[outside], inside / inside.sum(axis=1, keepdims=True))
        max_step = np.where(
            (crossed[outside] == MESH_BOUNDARY) & (not continues_beyond), 0.0, _MAX_BORDER_STEP_LEVELS
        )[:, None]
        colors[outside] = border_colors + (colors[outside] - border_colors).clip(-max_step, max_step)
        return colors.reshape(len(part.pixels), -1, 3).mean(axis=1).astype(np.float32), turned

    rows = sum(height for _, height in pages.sizes)
    texels = sum(width * height for width, height in pages.sizes)
    done = filled = turned = 0
    images = []
    threads = threads or get_worker_count()
    for number, (width, height) in enumerate(pages.sizes):
        found = rasterize_texels(pages, number)
        parts = found.split(_BATCH_SAMPLES // samples**2)
        paint = partial(compute_means, width)
        done_texels = 0
        image = np.zeros((height * width, 3), np.float32)
        results = (
            map(paint, parts)
            if threads == 1
            else map_ordered(paint, parts, threads=threads, max_pending=threads + 1)
        )
        for part, (colors, turned_in_batch) in zip(parts, results, strict=True):
            image[part.pixels] = colors
            turned += turned_in_batch
            # Progress in rows is estimated from the ratio of finished texels.
            done_texels += len(part.pixels)
            progress(done + height * done_texels // len(found.pixels), rows)
        shows = np.zeros(height * width, bool)
        shows[found.pixels] = True
        filled += len(found.pixels)
        images.append(
            fill_gaps_smoothly(image.reshape(height, width, 3), shows.reshape(height, width), pages.padding)
        )
        done += height
    return PaintedPages(images, filled / texels, turned / max(filled * samples**2, 1))
