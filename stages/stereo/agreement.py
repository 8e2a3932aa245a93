"""Depth maps of many views against each other: what several measured alike is kept, the rest is dropped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.scans.model.scan import DepthImage
from scanloom.stages.stereo.posed_views import PosedView

# What another view measured is before a place if it is nearer by this share of depth.
_BEFORE = 0.025


def merged(
    depths: Sequence[DepthImage], confidences: Sequence[NDArray[np.uint8]], tolerance: float
) -> tuple[DepthImage, NDArray[np.uint8]]:
    """Return one depth map of several of the same view.

    At each pixel the measurement that most others agree with stands (the first of equal ones), as the
    median of those that agree.

    Parameters
    ----------
    depths : one or more (h, w) float32 metres, 0 where there is none.
    confidences : (h, w) uint8 each.
    tolerance : share of depth by which measurements that agree may differ.

    Returns
    -------
    (h, w) float32 metres, and the highest confidence among those that agree.
    """
    stack = np.stack(depths)
    supporters = np.zeros(stack.shape, np.uint8)
    for k, one in enumerate(stack):
        supporters[k] = np.count_nonzero(_alike(stack, one, tolerance), axis=0)
    chosen = np.take_along_axis(stack, supporters.argmax(axis=0)[None], axis=0)[0]
    agree = _alike(stack, chosen, tolerance)
    # Sorted with what disagrees at the end, the median of the others is in their middle.
    ordered = np.sort(np.where(agree, stack, np.inf), axis=0)
    last = np.maximum(np.count_nonzero(agree, axis=0) - 1, 0)
    low, high = (np.take_along_axis(ordered, at[None], axis=0)[0] for at in (last // 2, (last + 1) // 2))
    any_at_all = chosen > 0
    depth = np.where(any_at_all, (np.where(any_at_all, low, 0) + np.where(any_at_all, high, 0)) / 2, 0)
    trust = np.where(agree, np.stack(confidences), np.uint8(0)).max(axis=0)
    return depth.astype(np.float32), trust


@dataclass(frozen=True, eq=False)
class Said:
    """What other views say of each pixel's place, counts of views, (h, w) uint8; 0 where there is no depth.

    Attributes
    ----------
    agreeing, nearly : measured the same depth there, and nearly the same.
    open : measured nothing before it, so that they may see it.
    looking : have any depth there.
    """

    agreeing: NDArray[np.uint8]
    nearly: NDArray[np.uint8]
    open: NDArray[np.uint8]
    looking: NDArray[np.uint8]


def agreeing_views(
    view: PosedView,
    depth: DepthImage,
    others: Iterable[tuple[PosedView, DepthImage]],
    tolerance: float,
    looser: float,
    threads: int = 1,
) -> Said:
    """Ask other views for each pixel's place.

    Parameters
    ----------
    depth : (h, w) float32 metres of `view`, 0 where there is none.
    others : views and their own depth maps.
    tolerance : share of depth by which a map that agrees may differ from what it should have there.
    looser : the same, of one that nearly agrees.
    """
    maps = [(view.pixels_to(other), measured) for other, measured in others]
    same, nearly = _kernels.agreeing(depth, maps, tolerances=(tolerance, looser), wanted_threads=threads)
    unhidden, looking = (
        _kernels.not_before(depth, maps, share=share, wanted_threads=threads) for share in (1 - _BEFORE, 0.0)
    )
    return Said(same, nearly, unhidden, looking)


def _alike(depths: DepthImage, reference: DepthImage, tolerance: float) -> NDArray[np.bool_]:
    return np.asarray((depths > 0) & (np.abs(depths - reference) <= np.float32(tolerance) * reference))
