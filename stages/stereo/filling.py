"""Filling of depth maps with depth that no view measured."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.prefetch import read_ahead
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Frame, SkippedFrame
from scanloom.stages.stereo.depth_map import DepthMap
from scanloom.stages.stereo.view_images import color_of

# Confidence of filled depth, below every threshold for measured depth.
FILLED = 1


def filled_with(found: DepthMap, told: DepthImage) -> DepthMap:
    """Put valid depth of `told` into a map, marked as filled.

    Parameters
    ----------
    told : (h, w) float32 metres, 0 where no depth is filled.
    """
    filled = told > 0
    return replace(
        found,
        depth=np.where(filled, told, found.depth),
        confidence=np.where(filled, np.uint8(FILLED), found.confidence),
        filled=filled if found.filled is None else filled | found.filled,
    )


def filled_again(
    rest: Sequence[DepthMap | SkippedFrame],
    frames: Sequence[Frame],
    depths: Callable[[int, ColorImage], tuple[DepthImage, NDArray[np.uint8], DepthImage]],
    threads: int,
) -> Iterator[DepthMap | SkippedFrame]:
    """Restore the images of stored depth maps, and fill missing depth.

    Parameters
    ----------
    rest : depth map of each view without images, as returned by `without_images`.
    frames : frames of the views.
    depths : function from view index and colour image to measured depth, its confidence, and depth to fill
        in.
    threads : thread count.

    Returns
    -------
    Iterator over the depth maps in order.
    """

    def fill(at: int) -> DepthMap | SkippedFrame:
        found = rest[at]
        if isinstance(found, SkippedFrame):
            return found
        try:
            color = color_of(frames[at])
            depth, confidence, told = depths(at, color)
        except InputError as error:
            return SkippedFrame(frames[at].name, error.diagnostic.within(frame=None))
        return filled_with(_with_images(found, depth, confidence, color), told)

    yield from read_ahead(fill, range(len(rest)), threads=threads, ahead=threads + 2)


def without_images(found: DepthMap) -> DepthMap:
    """Remove the images of a depth map.

    They are stored in files meanwhile, to save memory.
    """
    none, colorless = np.zeros((0, 0), np.uint8), np.zeros((0, 0, 3), np.uint8)
    depthless = none.astype(np.float32)
    return replace(found, depth=depthless, confidence=none, disparity=depthless, color=colorless)


def _with_images(
    found: DepthMap, depth: DepthImage, confidence: NDArray[np.uint8], color: ColorImage
) -> DepthMap:
    """Restore the images of a depth map. The disparity of views is NaN."""
    nothing = np.full(depth.shape, np.nan, np.float32)
    return replace(found, depth=depth, confidence=confidence, disparity=nothing, color=color)
