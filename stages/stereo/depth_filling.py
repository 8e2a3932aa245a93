"""Filling of depth maps with depth that no view measured."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.prefetch import map_ordered
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Frame, SkippedFrame
from scanloom.stages.stereo.depth_map import DepthMap
from scanloom.stages.stereo.view_images import read_view_color

# Confidence of filled depth, below every threshold for measured depth.
FILLED_CONFIDENCE = 1


def fill_depth(depth_map: DepthMap, filled_depth: DepthImage) -> DepthMap:
    """Put valid depth of `filled_depth` into a map, marked as filled.

    Parameters
    ----------
    filled_depth : (h, w) float32 metres, 0 where no depth is filled.
    """
    filled = filled_depth > 0
    return replace(
        depth_map,
        depth=np.where(filled, filled_depth, depth_map.depth),
        confidence=np.where(filled, np.uint8(FILLED_CONFIDENCE), depth_map.confidence),
        filled=filled if depth_map.filled is None else filled | depth_map.filled,
    )


def restore_and_fill(
    depth_maps: Sequence[DepthMap | SkippedFrame],
    frames: Sequence[Frame],
    compute_depths: Callable[[int, ColorImage], tuple[DepthImage, NDArray[np.uint8], DepthImage]],
    threads: int,
) -> Iterator[DepthMap | SkippedFrame]:
    """Restore the images of stored depth maps, and fill missing depth.

    Parameters
    ----------
    depth_maps : depth map of each view without images, as returned by `strip_images`.
    frames : frames of the views.
    compute_depths : function from view index and colour image to measured depth, its confidence, and depth to
        fill
        in.
    threads : thread count.

    Returns
    -------
    Iterator over the depth maps in order.
    """

    def fill_view(at: int) -> DepthMap | SkippedFrame:
        found = depth_maps[at]
        if isinstance(found, SkippedFrame):
            return found
        try:
            color = read_view_color(frames[at])
            depth, confidence, told = compute_depths(at, color)
        except InputError as error:
            return SkippedFrame(frames[at].name, error.diagnostic.replace_location_fields(frame=None))
        return fill_depth(_restore_images(found, depth, confidence, color), told)

    yield from map_ordered(fill_view, range(len(depth_maps)), threads=threads, max_pending=threads + 2)


def strip_images(depth_map: DepthMap) -> DepthMap:
    """Remove the images of a depth map.

    They are stored in files meanwhile, to save memory.
    """
    none, colorless = np.zeros((0, 0), np.uint8), np.zeros((0, 0, 3), np.uint8)
    depthless = none.astype(np.float32)
    return replace(depth_map, depth=depthless, confidence=none, disparity=depthless, color=colorless)


def _restore_images(
    depth_map: DepthMap, depth: DepthImage, confidence: NDArray[np.uint8], color: ColorImage
) -> DepthMap:
    """Restore the images of a depth map. The disparity of views is NaN."""
    nothing = np.full(depth.shape, np.nan, np.float32)
    return replace(depth_map, depth=depth, confidence=confidence, disparity=nothing, color=color)
