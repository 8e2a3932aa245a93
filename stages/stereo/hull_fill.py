"""Where a thing was not measured, but its silhouettes tell where it ends: depth on their hull.

The hull of silhouettes (Laurentini, 1994) is never behind the thing, and touches it where any of the views
sees its rim. Between measured depth the thing is about as far behind the hull as it is around; that distance
is spread into what was not measured (by pulling and pushing, Gortler et al., "The lumigraph", 1996). What is
hollow stays as the hull has it only where no view measured it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Scan, SkippedFrame
from scanloom.stages.scans.model.threads import threads_to_use
from scanloom.stages.stereo.depth_map import DepthMap
from scanloom.stages.stereo.filling import filled_again, without_images
from scanloom.stages.stereo.kept_maps import KeptMaps
from scanloom.stages.stereo.params import DepthParams
from scanloom.stages.stereo.posed_views import PosedView
from scanloom.stages.stereo.shown import Outline, Silhouette, hull_front, shown

Mask = NDArray[np.bool_]
Map = NDArray[np.float32]

# What other views measured up to this share of depth before a place is behind it, or the place itself.
_BEFORE = 0.02
# Measured depth that is spread lies at most this share of depth behind the hull: farther, that is no guide.
_BEHIND = 0.2
# Levels of the pyramid in which it is spread.
_LEVELS = 10
# So many other views, those that look the most alike, are asked what they measured.
_ASKED = 24


def filled_in(
    checked: Iterator[DepthMap | SkippedFrame],
    scan: Scan,
    views: Sequence[PosedView],
    outline: Outline,
    params: DepthParams,
    folder: Path,
    progress: Callable[[int], object],
) -> Iterator[DepthMap | SkippedFrame]:
    """Give maps of all views, in their order, the depth of the hull where no view measured any.

    Parameters
    ----------
    folder : where maps are kept until all of them are there.
    progress : called with the number of those that are.
    """
    maps = KeptMaps(folder / "checked")
    rest: list[DepthMap | SkippedFrame] = []
    for at, one in enumerate(checked):
        if isinstance(one, DepthMap):
            maps.put(at, one.depth, one.confidence)
        rest.append(without_images(one) if isinstance(one, DepthMap) else one)
        progress(at + 1)
    measured = [at for at, one in enumerate(rest) if isinstance(one, DepthMap)]

    def depths(at: int, color: ColorImage) -> tuple[DepthImage, NDArray[np.uint8], DepthImage]:
        seen, _ = shown(scan.frames[at], color, outline, params.backdrop)
        depth = maps.depth(at)
        told = on_hull(views[at], depth, seen, outline.hull)
        others = [(views[other], maps.depth(other)) for other in _alike(views, at, measured)]
        told = unmeasured(views[at], told, others, params.agreeing_views + 1)
        return depth, maps.confidence(at), told

    yield from filled_again(rest, scan.frames, depths, params.threads or threads_to_use())


def _alike(views: Sequence[PosedView], at: int, among: Sequence[int]) -> list[int]:
    """Return the places of other views that look from the same side, those that look the most alike first."""
    way = views[at].world_from_camera[:3, 2]
    cosines = {other: float(views[other].world_from_camera[:3, 2] @ way) for other in among if other != at}
    order = sorted(cosines, key=lambda other: -cosines[other])
    return [other for other in order[:_ASKED] if cosines[other] > 0]


def on_hull(
    view: PosedView,
    depth: DepthImage,
    shown: Mask,
    outlines: Sequence[Silhouette],
) -> DepthImage:
    """Return depth (h, w) at pixels that show the thing and have none; 0 elsewhere, and where none bounds it.

    Parameters
    ----------
    depth : (h, w) float32 metres, as measured.
    shown : (h, w), what shows the thing.
    """
    nothing = np.zeros_like(depth)
    rows, columns = (np.flatnonzero(shown.any(axis=axis)) for axis in (1, 0))
    if not (depth > 0).any() or not len(rows):
        return nothing
    front = hull_front(view, shown, outlines)
    part = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    bounded = (front > 0) & shown
    behind = np.divide(depth, front, out=np.ones_like(depth), where=bounded) - 1
    known = bounded & (depth > 0) & (behind <= _BEHIND)
    if not known.any():
        return nothing
    told = front[part] * (1 + np.maximum(spread(behind[part], known[part]), 0))
    nothing[part] = np.where(bounded[part] & (depth[part] == 0), told, 0)
    return nothing


def unmeasured(
    view: PosedView, depth: DepthImage, others: Sequence[tuple[PosedView, DepthImage]], most: int
) -> DepthImage:
    """Return depth (h, w) without what at least `most` other views measured, or see something behind."""
    count = _kernels.not_before(
        depth,
        [(view.pixels_to(other), measured) for other, measured in others],
        share=1 - _BEFORE,
        wanted_threads=1,
    )
    return np.where(count < most, depth, np.float32(0))


def spread(values: Map, known: Mask) -> Map:
    """Return values (h, w) of which some are known, and the others go smoothly from one to the next."""
    import cv2

    weights = [known.astype(np.float32)]
    sums = [np.where(known, values, 0).astype(np.float32)]
    while len(sums) < _LEVELS and max(sums[-1].shape) > 1:
        weight, total = cv2.pyrDown(weights[-1]), cv2.pyrDown(sums[-1])
        # What is known well enough counts once.
        over = np.maximum(weight, 1)
        weights.append(np.asarray(weight / over, np.float32))
        sums.append(np.asarray(total / over, np.float32))
    coarse = sums[-1] / np.maximum(weights[-1], 1e-9)
    for total, weight in zip(sums[-2::-1], weights[-2::-1], strict=True):
        size = (total.shape[1], total.shape[0])
        below = cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR)
        coarse = total + (1 - np.minimum(weight, 1)) * below
    return np.asarray(coarse, np.float32)
