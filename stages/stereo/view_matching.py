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
from scanloom.stages.scans.model.images import read_valid_pixels
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Scan, SkippedFrame
from scanloom.stages.stereo.codes import DEPTH_VIEW_WITHOUT_PARTNER
from scanloom.stages.stereo.coverage import CoverageCounts
from scanloom.stages.stereo.depth import PairMatcher
from scanloom.stages.stereo.foreground_masks import (
    ObjectOutline,
    compute_hull_entry,
    dilate_mask,
    mask_foreground,
)
from scanloom.stages.stereo.networks.network import Network
from scanloom.stages.stereo.opencv_matching import SearchRange
from scanloom.stages.stereo.params import SWEEP, DepthParams
from scanloom.stages.stereo.plane_sweep import sweep_view
from scanloom.stages.stereo.posed_views import PosedView
from scanloom.stages.stereo.view_consistency import merge_depth_maps
from scanloom.stages.stereo.view_images import ViewImage, convert_to_grey, read_view_color
from scanloom.stages.stereo.view_rectification import rectify_views, transfer_depth

# Cache size for images of views and their object masks, bytes.
_CACHE_BYTES = 1 << 28
# Pixel stride for the depth of the visual hull, which is smooth enough.
_HULL_STRIDE = 2


@dataclass(frozen=True, eq=False)
class ViewDepth:
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
    counts: CoverageCounts


def measure_view(
    scan: Scan,
    views: Sequence[PosedView],
    partner_candidates: Sequence[Sequence[int]],
    params: DepthParams,
    tolerance: float,
    outline: ObjectOutline,
    network: Network | None,
    read_image: Callable[[int], ViewImage],
    view_index: int,
) -> ViewDepth | SkippedFrame:
    """Compute the depth of one view from its partners.

    Parameters
    ----------
    partner_candidates : for each view, indices of its partner candidates, best first.
    tolerance : maximum relative difference of depth between agreeing pairs.
    outline : outline of the object.
    network : stereo network that replaces the matcher, or None.
    read_image : function from view index to the image, as returned by `make_image_reader`.
    view_index : index of the view.
    """
    name = scan.frames[view_index].name
    try:
        color = read_view_color(scan.frames[view_index])
    except InputError as error:
        return SkippedFrame(name, error.diagnostic.replace_location_fields(frame=None))
    if network is None and params.views == SWEEP:
        return _sweep_view(
            scan, views, partner_candidates[view_index], params, outline, read_image, view_index, color
        )
    depths: list[DepthImage] = []
    confidences: list[NDArray[np.uint8]] = []
    searches: list[SearchRange] = []
    for other in partner_candidates[view_index]:
        if len(depths) == params.partners:
            break
        pair = rectify_views(views[view_index], views[other])
        if pair is None:
            continue
        try:
            second = read_view_color(scan.frames[other])
        except InputError:
            continue  # reported when that view is measured
        rig, near, far = pair
        ranged = replace(params, min_depth=near, max_depth=far)
        stage = PairMatcher(rig, ranged, pair_count=len(views), network=network)
        # Views with little overlap have few matches, which is no fault of the network: warnings are dropped.
        with collecting(forward=False):
            found = stage.measure(*rig.apply(color, second))
        depth, confidence = transfer_depth(
            found.depth, found.confidence, rig, views[view_index], views[other]
        )
        depths.append(depth)
        confidences.append(confidence)
        searches.append(found.search)
    if not depths:
        return _skip_without_partners(name, bool(partner_candidates[view_index]))
    depth, confidence = merge_depth_maps(depths, confidences, tolerance)
    foreground, measurable = mask_foreground(
        scan.frames[view_index], color, outline, params.max_backdrop_contrast
    )
    depth[~measurable] = 0
    counts = CoverageCounts(
        total=depth.size,
        foreground=int(np.count_nonzero(foreground)),
        textureless=int(np.count_nonzero(foreground & ~measurable)),
        matched=int(np.count_nonzero(depth)),
        outlined=depth.size if outline.is_known else 0,
    )
    return ViewDepth(depth, confidence, searches[0], counts)


def make_image_reader(
    scan: Scan, views: Sequence[PosedView], outline: ObjectOutline
) -> Callable[[int], ViewImage]:
    """Return a cached reader of view images.

    The reader takes a view index and raises InputError if the image cannot be read. Recent images stay in
    memory, because views share partners.
    """
    largest = max(view.camera.width * view.camera.height for view in views)

    @lru_cache(maxsize=max(min(_CACHE_BYTES // (2 * largest), len(views)), 2))
    def read_image(place: int) -> ViewImage:
        frame = scan.frames[place]
        thing = dilate_mask(read_valid_pixels(frame)) if outline.silhouettes else None
        return ViewImage(views[place], convert_to_grey(read_view_color(frame)), thing)

    return read_image


def _sweep_view(
    scan: Scan,
    views: Sequence[PosedView],
    candidates: Sequence[int],
    params: DepthParams,
    outline: ObjectOutline,
    read_image: Callable[[int], ViewImage],
    view_index: int,
    color: ColorImage,
) -> ViewDepth | SkippedFrame:
    """Compute the depth of one view by a plane sweep."""
    others: list[ViewImage] = []
    for other in candidates:
        if len(others) == params.partners:
            break
        try:
            others.append(read_image(other))
        except InputError:
            continue  # reported when that view is measured
    if not others:
        return _skip_without_partners(scan.frames[view_index].name, bool(candidates))
    foreground, _ = mask_foreground(scan.frames[view_index], color, outline, params.max_backdrop_contrast)
    hull_depth = (
        compute_hull_entry(views[view_index], foreground, outline.hull_silhouettes, _HULL_STRIDE)
        if outline.hull_silhouettes
        else None
    )
    found = sweep_view(read_image(view_index), others, hull_depth)
    depth = np.where(foreground, found.depth, np.float32(0))
    counts = CoverageCounts(
        total=depth.size,
        foreground=int(np.count_nonzero(foreground)),
        matched=int(np.count_nonzero(depth)),
        outlined=depth.size if outline.is_known else 0,
    )
    distinct = np.rint(255 * found.distinctness).astype(np.uint8)
    return ViewDepth(depth, distinct, SearchRange.from_bounds(0, found.plane_count - 1), counts)


def _skip_without_partners(name: str, are_in_line: bool) -> SkippedFrame:
    place = "in front of it or behind it" if are_in_line else "too close, too far apart, or look elsewhere"
    return SkippedFrame(
        name,
        DEPTH_VIEW_WITHOUT_PARTNER.warning(
            "no other view sees the same surface at an angle of 1 to 35 degrees; the other views are {place}",
            place=place,
        ),
    )
