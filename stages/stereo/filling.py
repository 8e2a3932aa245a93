"""Depth that no view measured: put into a map and marked there, whatever tells it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stages.scans.scan import ColorImage, DepthImage
from stages.stereo.depth_map import DepthMap

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


def without_images(found: DepthMap) -> DepthMap:
    """Return what a map says beside its images, while these are kept in files."""
    none, colorless = np.zeros((0, 0), np.uint8), np.zeros((0, 0, 3), np.uint8)
    depthless = none.astype(np.float32)
    return replace(found, depth=depthless, confidence=none, disparity=depthless, color=colorless)


def with_images(
    found: DepthMap, depth: DepthImage, confidence: NDArray[np.uint8], color: ColorImage
) -> DepthMap:
    """Return a map of a view with its images again; of views no disparity is kept."""
    nothing = np.full(depth.shape, np.nan, np.float32)
    return replace(found, depth=depth, confidence=confidence, disparity=nothing, color=color)
