"""Depth of one view from its partners.

The methods are a plane sweep with all partners at once, and pairwise matching.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_seen
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Scan, SkippedFrame
from scanloom.stages.stereo.agreement import merged
from scanloom.stages.stereo.codes import DEPTH_VIEW_WITHOUT_PARTNER
from scanloom.stages.stereo.coverage import Counts
from scanloom.stages.stereo.depth import PairStage
from scanloom.stages.stereo.matching import SearchRange
from scanloom.stages.stereo.networks.network import Network
from scanloom.stages.stereo.params import SWEEP, DepthParams
from scanloom.stages.stereo.plane_sweep import plane_sweep
from scanloom.stages.stereo.posed_views import PosedView
from scanloom.stages.stereo.shown import Outline, grown, hull_front, shown
from scanloom.stages.stereo.view_images import Seen, color_of, grey_of
from scanloom.stages.stereo.view_pair import depth_in_view, rectified_views

# Cache size for images of views and their object masks, bytes.
_KEPT_BYTES = 1 << 28
# Pixel stride for the depth of the visual hull, which is smooth enough.
_FRONT_EVERY = 2


@dataclass(frozen=True, eq=False)
class Measured:
    """Depth of a view from its partners, before the consistency check.

    Attributes
    ----------
    depth : (h, w) float32 metres, 0 where missing.
    confidence : (h, w) uint8.
    search : search range in disparities or planes.
    counts : pixel counts of the view.
    """

    depth: DepthImage
    confidence: NDArray[np.uint8]
    search: SearchRange
    counts: Counts


def measured_view(
    scan: Scan,
    views: Sequence[PosedView],
    chosen: Sequence[Sequence[int]],
    params: DepthParams,
    tolerance: float,
    outline: Outline,
    network: Network | None,
    images: Callable[[int], Seen],
    at: int,
) -> Measured | SkippedFrame:
    """Compute the depth of one view from its partners.

    Parameters
    ----------
    chosen : for each view, indices of its partner candidates, best first.
    tolerance : maximum relative difference of depth between agreeing pairs.
    outline : outline of the object.
    network : stereo network that replaces the matcher, or None.
    images : function from view index to the image, as returned by `images_of`.
    at : index of the view.
    """
    name = scan.frames[at].name
    try:
        color = color_of(scan.frames[at])
    except InputError as error:
        return SkippedFrame(name, error.diagnostic.within(frame=None))
    if network is None and params.views == SWEEP:
        return _swept(scan, views, chosen[at], params, outline, images, at, color)
    depths: list[DepthImage] = []
    confidences: list[NDArray[np.uint8]] = []
    searches: list[SearchRange] = []
    for other in chosen[at]:
        if len(depths) == params.partners:
            break
        pair = rectified_views(views[at], views[other])
        if pair is None:
            continue
        try:
            second = color_of(scan.frames[other])
        except InputError:
            continue  # reported when that view is measured
        rig, near, far = pair
        ranged = replace(params, min_depth=near, max_depth=far)
        stage = PairStage(rig, ranged, pairs=len(views), network=network)
        # Views with little overlap have few matches, which is no fault of the network: warnings are dropped.
        with collecting(forward=False):
            found = stage.measure(*rig.apply(color, second))
        depth, trust = depth_in_view(found.depth, found.confidence, rig, views[at], views[other])
        depths.append(depth)
        confidences.append(trust)
        searches.append(found.search)
    if not depths:
        return _without_partners(name, bool(chosen[at]))
    depth, trust = merged(depths, confidences, tolerance)
    seen, measured = shown(scan.frames[at], color, outline, params.backdrop)
    depth[~measured] = 0
    counts = Counts(
        all=depth.size,
        shown=int(np.count_nonzero(seen)),
        plain=int(np.count_nonzero(seen & ~measured)),
        matched=int(np.count_nonzero(depth)),
        outlined=depth.size if outline.is_known else 0,
    )
    return Measured(depth, trust, searches[0], counts)


def images_of(scan: Scan, views: Sequence[PosedView], outline: Outline) -> Callable[[int], Seen]:
    """Return a cached reader of view images.

    The reader takes a view index and raises InputError if the image cannot be read. Recent images stay in
    memory, because views share partners.
    """
    largest = max(view.camera.width * view.camera.height for view in views)

    @lru_cache(maxsize=max(min(_KEPT_BYTES // (2 * largest), len(views)), 2))
    def image(place: int) -> Seen:
        frame = scan.frames[place]
        thing = grown(read_seen(frame)) if outline.silhouettes else None
        return Seen(views[place], grey_of(color_of(frame)), thing)

    return image


def _swept(
    scan: Scan,
    views: Sequence[PosedView],
    partners_of: Sequence[int],
    params: DepthParams,
    outline: Outline,
    images: Callable[[int], Seen],
    at: int,
    color: ColorImage,
) -> Measured | SkippedFrame:
    """Compute the depth of one view by a plane sweep."""
    others: list[Seen] = []
    for other in partners_of:
        if len(others) == params.partners:
            break
        try:
            others.append(images(other))
        except InputError:
            continue  # reported when that view is measured
    if not others:
        return _without_partners(scan.frames[at].name, bool(partners_of))
    measured, _ = shown(scan.frames[at], color, outline, params.backdrop)
    front = hull_front(views[at], measured, outline.hull, _FRONT_EVERY) if outline.hull else None
    found = plane_sweep(images(at), others, front)
    depth = np.where(measured, found.depth, np.float32(0))
    counts = Counts(
        all=depth.size,
        shown=int(np.count_nonzero(measured)),
        matched=int(np.count_nonzero(depth)),
        outlined=depth.size if outline.is_known else 0,
    )
    distinct = np.rint(255 * found.distinct).astype(np.uint8)
    return Measured(depth, distinct, SearchRange.covering(0, found.planes - 1), counts)


def _without_partners(name: str, are_before: bool) -> SkippedFrame:
    place = "in front of it or behind it" if are_before else "too close, too far apart, or look elsewhere"
    return SkippedFrame(
        name,
        DEPTH_VIEW_WITHOUT_PARTNER.warning(
            "no other view sees the same surface at an angle of 1 to 35 degrees; the other views are {place}",
            place=place,
        ),
    )
