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
from scanloom.stages.scans.model.threads import get_thread_count
from scanloom.stages.stereo.depth_filling import restore_and_fill, strip_images
from scanloom.stages.stereo.depth_map import DepthMap
from scanloom.stages.stereo.depth_map_store import DepthMapStore
from scanloom.stages.stereo.foreground_masks import (
    ObjectOutline,
    Silhouette,
    compute_hull_entry,
    mask_foreground,
)
from scanloom.stages.stereo.params import DepthParams
from scanloom.stages.stereo.posed_views import PosedView

Mask = NDArray[np.bool_]
Map = NDArray[np.float32]

# A view confirms or sees past a point if its depth is at most this ratio in front of the point.
_OCCLUSION_RATIO = 0.02
# Maximum distance of measured depth behind the hull, relative to depth; larger distances are not
# extrapolated.
_MAX_HULL_DISTANCE_RATIO = 0.2
# Maximum number of pyramid levels for the interpolation.
_MAX_PYRAMID_LEVELS = 10
# Maximum number of views, most similar in direction first, that filled depth is checked against.
_MAX_CHECKED_VIEWS = 24


def fill_from_hull(
    depth_maps: Iterator[DepthMap | SkippedFrame],
    scan: Scan,
    views: Sequence[PosedView],
    outline: ObjectOutline,
    params: DepthParams,
    folder: Path,
    progress: Callable[[int], object],
) -> Iterator[DepthMap | SkippedFrame]:
    """Fill depth maps of all views from the visual hull.

    Parameters
    ----------
    depth_maps : depth maps after the consistency check, in the order of the views.
    scan, views : frames and posed views.
    outline : silhouettes of the object.
    params : parameters of the depth stage.
    folder : folder for maps while not all of them are checked.
    progress : called with the number of checked maps.

    Returns
    -------
    Iterator over the filled maps in the order of the views.
    """
    maps = DepthMapStore(folder / "checked")
    rest: list[DepthMap | SkippedFrame] = []
    for at, one in enumerate(depth_maps):
        if isinstance(one, DepthMap):
            maps.store(at, one.depth, one.confidence)
        rest.append(strip_images(one) if isinstance(one, DepthMap) else one)
        progress(at + 1)
    measured = [at for at, one in enumerate(rest) if isinstance(one, DepthMap)]

    def compute_depths(at: int, color: ColorImage) -> tuple[DepthImage, NDArray[np.uint8], DepthImage]:
        seen, _ = mask_foreground(scan.frames[at], color, outline, params.max_backdrop_contrast)
        depth = maps.load_depth(at)
        told = compute_hull_depth(views[at], depth, seen, outline.hull_silhouettes)
        others = [
            (views[other], maps.load_depth(other)) for other in _find_similar_views(views, at, measured)
        ]
        told = remove_contradicted_depth(views[at], told, others, params.min_consistent_views + 1)
        return depth, maps.load_confidence(at), told

    yield from restore_and_fill(rest, scan.frames, compute_depths, params.threads or get_thread_count())


def _find_similar_views(views: Sequence[PosedView], at: int, candidates: Sequence[int]) -> list[int]:
    """Return indices of other views from the same side.

    Views are sorted by similarity of their direction.
    """
    way = views[at].world_from_camera[:3, 2]
    cosines = {
        other: float(views[other].world_from_camera[:3, 2] @ way) for other in candidates if other != at
    }
    order = sorted(cosines, key=lambda other: -cosines[other])
    return [other for other in order[:_MAX_CHECKED_VIEWS] if cosines[other] > 0]


def compute_hull_depth(
    view: PosedView,
    depth: DepthImage,
    object_mask: Mask,
    silhouettes: Sequence[Silhouette],
) -> DepthImage:
    """Compute depth on the visual hull for unmeasured object pixels.

    Parameters
    ----------
    depth : (h, w) float32 metres, as measured.
    object_mask : (h, w), pixels of the object.
    silhouettes : silhouettes of the hull.

    Returns
    -------
    (h, w) float32 metres; 0 at measured pixels, outside of the object, and where the hull is unbounded.
    """
    result = np.zeros_like(depth)
    rows, columns = (np.flatnonzero(object_mask.any(axis=axis)) for axis in (1, 0))
    if not (depth > 0).any() or not len(rows):
        return result
    front = compute_hull_entry(view, object_mask, silhouettes)
    window = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    bounded = (front > 0) & object_mask
    behind = np.divide(depth, front, out=np.ones_like(depth), where=bounded) - 1
    known = bounded & (depth > 0) & (behind <= _MAX_HULL_DISTANCE_RATIO)
    if not known.any():
        return result
    filled_depth = front[window] * (1 + np.maximum(interpolate_unknown(behind[window], known[window]), 0))
    result[window] = np.where(bounded[window] & (depth[window] == 0), filled_depth, 0)
    return result


def remove_contradicted_depth(
    view: PosedView, depth: DepthImage, others: Sequence[tuple[PosedView, DepthImage]], min_view_count: int
) -> DepthImage:
    """Remove depth at points that enough other views see unoccluded.

    A view sees a point unoccluded if it measured a surface at the point or behind it.

    Parameters
    ----------
    depth : (h, w) float32 metres.
    min_view_count : minimum number of such views for removal.
    """
    _, _, unoccluded, _ = _kernels.count_supporting_views(
        depth,
        [(view.compute_projection_to(other), measured) for other, measured in others],
        tolerances=(0.0, 0.0),
        min_depth_ratio=1 - _OCCLUSION_RATIO,
        wanted_threads=1,
    )
    return np.where(unoccluded < min_view_count, depth, np.float32(0))


def interpolate_unknown(values: Map, known: Mask) -> Map:
    """Interpolate known values (h, w) smoothly into unknown pixels (pull-push)."""
    import cv2

    weights = [known.astype(np.float32)]
    sums = [np.where(known, values, 0).astype(np.float32)]
    while len(sums) < _MAX_PYRAMID_LEVELS and max(sums[-1].shape) > 1:
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
