"""Consistency of depth maps between views."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.scans.model.scan import DepthImage
from scanloom.stages.stereo.posed_views import PosedView

# A view occludes a point if its own depth is smaller than the point's by more than this ratio.
_OCCLUSION_RATIO = 0.025


def merge_depth_maps(
    depths: Sequence[DepthImage], confidences: Sequence[NDArray[np.uint8]], tolerance: float
) -> tuple[DepthImage, NDArray[np.uint8]]:
    """Merge depth maps of one view to a single map.

    Each pixel takes the measurement that most others agree with (the first one for ties). The result is the
    median of the agreeing measurements.

    Parameters
    ----------
    depths : one or more (h, w) float32 metres, 0 where missing.
    confidences : (h, w) uint8 each.
    tolerance : maximum relative difference of depth between agreeing measurements.

    Returns
    -------
    (h, w) float32 metres, and (h, w) uint8, the maximum confidence among the agreeing measurements.
    """
    stack = np.stack(depths)
    supporters = np.zeros(stack.shape, np.uint8)
    for k, one in enumerate(stack):
        supporters[k] = np.count_nonzero(_is_within_tolerance(stack, one, tolerance), axis=0)
    chosen = np.take_along_axis(stack, supporters.argmax(axis=0)[None], axis=0)[0]
    agree = _is_within_tolerance(stack, chosen, tolerance)
    # Sorting moves disagreeing values (inf) to the end, so that the median index depends on the count only.
    ordered = np.sort(np.where(agree, stack, np.inf), axis=0)
    last = np.maximum(np.count_nonzero(agree, axis=0) - 1, 0)
    low, high = (np.take_along_axis(ordered, at[None], axis=0)[0] for at in (last // 2, (last + 1) // 2))
    has_depth = chosen > 0
    depth = np.where(has_depth, (np.where(has_depth, low, 0) + np.where(has_depth, high, 0)) / 2, 0)
    confidence = np.where(agree, np.stack(confidences), np.uint8(0)).max(axis=0)
    return depth.astype(np.float32), confidence


@dataclass(frozen=True, eq=False)
class ViewSupport:
    """Number of other views per pixel that support its depth.

    All counts are (h, w) uint8, and 0 where depth is missing.

    Attributes
    ----------
    consistent : views with the same depth within the tolerance.
    nearly_consistent : views with the same depth within the wider tolerance.
    unoccluded : views whose depth does not occlude the point.
    with_depth : views with any depth at the point's projection.
    """

    consistent: NDArray[np.uint8]
    nearly_consistent: NDArray[np.uint8]
    unoccluded: NDArray[np.uint8]
    with_depth: NDArray[np.uint8]


def count_supporting_views(
    view: PosedView,
    depth: DepthImage,
    others: Iterable[tuple[PosedView, DepthImage]],
    tolerance: float,
    loose_tolerance: float,
    threads: int = 1,
) -> ViewSupport:
    """Count the views that support the depth of each pixel.

    Parameters
    ----------
    depth : (h, w) float32 metres of `view`, 0 where missing.
    others : other views and their depth maps.
    tolerance : maximum relative difference of depth for agreement.
    loose_tolerance : wider tolerance, for near agreement.
    threads : thread count.
    """
    maps = [(view.compute_projection_to(other), measured) for other, measured in others]
    counts = _kernels.count_supporting_views(
        depth,
        maps,
        tolerances=(tolerance, loose_tolerance),
        min_depth_ratio=1 - _OCCLUSION_RATIO,
        wanted_threads=threads,
    )
    return ViewSupport(*counts)


def _is_within_tolerance(depths: DepthImage, reference: DepthImage, tolerance: float) -> NDArray[np.bool_]:
    return np.asarray((depths > 0) & (np.abs(depths - reference) <= np.float32(tolerance) * reference))
