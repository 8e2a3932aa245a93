"""Filling of unmeasured object surface from the visual hull of silhouettes.

The visual hull (Laurentini 1994) is never behind the object, and touches it at the silhouettes. The distance
from the hull to measured depth is interpolated into unmeasured pixels (pull-push, Gortler et al., "The
lumigraph", 1996). Concavities are filled too far in front, but only where no view measured them.
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

# A view confirms or sees past a point if its depth is at most this ratio in front of the point.
_BEFORE = 0.02
# Maximum distance of measured depth behind the hull, relative to depth; larger distances are not
# extrapolated.
_BEHIND = 0.2
# Maximum number of pyramid levels for the interpolation.
_LEVELS = 10
# Maximum number of views, most similar in direction first, that filled depth is checked against.
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
    """Fill depth maps of all views from the visual hull.

    Parameters
    ----------
    checked : depth maps after the consistency check, in the order of the views.
    scan, views : frames and posed views.
    outline : silhouettes of the object.
    params : parameters of the depth stage.
    folder : folder for maps while not all of them are checked.
    progress : called with the number of checked maps.

    Returns
    -------
    Iterator over the filled maps in the order of the views.
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
    """Return indices of other views from the same side.

    Views are sorted by similarity of their direction.
    """
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
    """Compute depth on the visual hull for unmeasured object pixels.

    Parameters
    ----------
    depth : (h, w) float32 metres, as measured.
    shown : (h, w), pixels of the object.
    outlines : silhouettes of the hull.

    Returns
    -------
    (h, w) float32 metres; 0 at measured pixels, outside of the object, and where the hull is unbounded.
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
    """Remove depth that other views contradict or have measured.

    Parameters
    ----------
    depth : (h, w) float32 metres.
    most : minimum number of other views that measured the point, or see something behind it.
    """
    count = _kernels.not_before(
        depth,
        [(view.pixels_to(other), measured) for other, measured in others],
        share=1 - _BEFORE,
        wanted_threads=1,
    )
    return np.where(count < most, depth, np.float32(0))


def spread(values: Map, known: Mask) -> Map:
    """Interpolate known values (h, w) smoothly into unknown pixels (pull-push)."""
    import cv2

    weights = [known.astype(np.float32)]
    sums = [np.where(known, values, 0).astype(np.float32)]
    while len(sums) < _LEVELS and max(sums[-1].shape) > 1:
        weight, total = cv2.pyrDown(weights[-1]), cv2.pyrDown(sums[-1])
        # Saturates the weight at 1, as in pull-push.
        over = np.maximum(weight, 1)
        weights.append(np.asarray(weight / over, np.float32))
        sums.append(np.asarray(total / over, np.float32))
    coarse = sums[-1] / np.maximum(weights[-1], 1e-9)
    for total, weight in zip(sums[-2::-1], weights[-2::-1], strict=True):
        size = (total.shape[1], total.shape[0])
        below = cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR)
        coarse = total + (1 - np.minimum(weight, 1)) * below
    return np.asarray(coarse, np.float32)
