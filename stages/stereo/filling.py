"""Depth that no view measured: put into a map and marked there, whatever tells it."""

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

# Confidence of such depth: less than any that is measured needs.
FILLED = 1


def filled_with(found: DepthMap, told: DepthImage) -> DepthMap:
    """Return a map with depth told, (h, w) metres and 0 for none, in place of its own, and marked."""
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
    """Give maps of views their images again, which were kept in files, and depth that is told.

    Parameters
    ----------
    rest : what `without_images` left, of each view.
    depths : from a view's place and its colour to its own depth, its confidence, and depth told.
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
    """Return what a map says beside its images, while these are kept in files."""
    none, colorless = np.zeros((0, 0), np.uint8), np.zeros((0, 0, 3), np.uint8)
    depthless = none.astype(np.float32)
    return replace(found, depth=depthless, confidence=none, disparity=depthless, color=colorless)


def _with_images(
    found: DepthMap, depth: DepthImage, confidence: NDArray[np.uint8], color: ColorImage
) -> DepthMap:
    """Return a map of a view with its images again; of views no disparity is kept."""
    nothing = np.full(depth.shape, np.nan, np.float32)
    return replace(found, depth=depth, confidence=confidence, disparity=nothing, color=color)
