"""Fusion of the depth map of a view with the maps of other views.

Merrell et al., "Real-time visibility-based fusion of depth maps", 2007. Each pixel takes the depth that most
confidence agrees with, of its own and those of the other views. Errors of a single view are replaced: next to
a near object, textureless background often has the depth of the object in some views only.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.scans.model.scan import DepthImage
from scanloom.stages.stereo.posed_views import PosedView

Counts = NDArray[np.uint8]
Sums = NDArray[np.uint16]


@dataclass(frozen=True, eq=False)
class FusedDepth:
    """Fused depth of a view with its evidence.

    Sums are of confidences, 255 for certain depth.

    Attributes
    ----------
    depth : (h, w) float32 metres, 0 where missing.
    confirming : sum over other views with the same depth at the projected point.
    contradicting : sum over other views that see past the projected point.
    nearly_consistent : number of the confirming views.
    consistent : number of the confirming views within the narrow tolerance.
    """

    depth: DepthImage
    confirming: Sums
    contradicting: Sums
    nearly_consistent: Counts
    consistent: Counts


def fuse_views(
    view: PosedView,
    depth: DepthImage,
    confidence: Counts,
    others: Iterable[tuple[PosedView, DepthImage, Counts]],
    tolerance: float,
    loose_tolerance: float,
    threads: int = 1,
) -> FusedDepth:
    """Fuse the depth map of a view with the maps of other views.

    Parameters
    ----------
    depth : (h, w) float32 metres, 0 where missing.
    confidence : (h, w) uint8, 255 times the probability that depth is right.
    others : other views with their depth and confidence.
    tolerance : maximum relative difference of averaged depths.
    loose_tolerance : wider tolerance, for agreement.
    threads : thread count; results do not depend on it.
    """
    maps = [
        (view.compute_projection_to(other), other.compute_projection_to(view), measured, trust)
        for other, measured, trust in others
    ]
    fused, (confirming, contradicting), (nearly, consistent) = _kernels.fuse_depth_maps(
        depth, confidence, maps, tolerances=(tolerance, loose_tolerance), wanted_threads=threads
    )
    return FusedDepth(fused, confirming, contradicting, nearly, consistent)
