"""Multi-view depth of posed single views, with a consistency check between views."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.features import Keypoints, detect_keypoints
from scanloom.stages.params import resolve
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.scans.codes import POSE_INCONSISTENT_WITH_IMAGES, SCAN_TOO_MANY_FRAMES_SKIPPED
from scanloom.stages.scans.model.depth_range import DepthRange, estimate_depth_range
from scanloom.stages.scans.model.images import read_valid_pixels
from scanloom.stages.scans.model.prefetch import map_ordered
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Frame, Pose, Scan, SkippedFrame
from scanloom.stages.scans.model.threads import get_thread_count
from scanloom.stages.stereo.codes import (
    DEPTH_IMAGES_SMALLER,
    DEPTH_POSES_MOVED,
    DEPTH_VIEW_UNCONFIRMED,
    DEPTH_VIEW_WITHOUT_PARTNER,
)
from scanloom.stages.stereo.coverage import CoverageCounts, report_coverage
from scanloom.stages.stereo.depth_map import DepthMap
from scanloom.stages.stereo.depth_map_store import DepthMapStore
from scanloom.stages.stereo.depth_ranges import assign_depth_ranges, read_stated_ranges, widen_scene_box
from scanloom.stages.stereo.foreground_masks import crop_to_hull, detect_outline, mask_foreground
from scanloom.stages.stereo.network_depth import fill_missing_depth, load_network
from scanloom.stages.stereo.opencv_matching import SearchRange
from scanloom.stages.stereo.params import PAIR_PARAMETERS, SWEEP, DepthParams
from scanloom.stages.stereo.partner_selection import select_partners
from scanloom.stages.stereo.plane_filling import fill_from_planes
from scanloom.stages.stereo.pose_refinement import refine_poses
from scanloom.stages.stereo.posed_views import PosedView, create_posed_views
from scanloom.stages.stereo.sweep_confidence import compute_fused_confidence, compute_sweep_confidence
from scanloom.stages.stereo.triangulation import VerifiedMatches, find_overlapping_pairs, match_views
from scanloom.stages.stereo.upside_down_correction import rotate_upside_down
from scanloom.stages.stereo.view_consistency import ViewSupport, count_supporting_views
from scanloom.stages.stereo.view_fusion import fuse_views
from scanloom.stages.stereo.view_images import convert_to_grey, downscale, read_view_color
from scanloom.stages.stereo.view_matching import make_image_reader, measure_view
from scanloom.stages.stereo.visual_hull_filling import fill_from_hull

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import DepthKeywords

RESULT_VERSION = 9

# Maximum difference of agreeing depth maps, in pixels of disparity.
_TOLERANCE_PX = 1.0
# Tolerance of near agreement, relative to the tolerance of agreement.
_LOOSE_TOLERANCE_FACTOR = 2.5
# Minimum ratio of fused depth that a view measured itself. Other views give it no depth otherwise.
_MIN_OWN_RATIO = 0.75
# Number of views each map is checked against, relative to the number of partners; the best partners first.
_CHECKED_VIEWS_FACTOR = 2
# Minimum confidence of swept depth, of 255: right in four of five cases; for an object with known outline one
# of two, because there is no background behind it to be confused with.
_MIN_CONFIDENCE, _MIN_OBJECT_CONFIDENCE = 204, 128
# Keypoints per view. Keypoints of all views are in memory at once, 0.5 kB each.
_MAX_KEYPOINTS = 1000
# Median epipolar error in pixels above which poses are refined; larger errors make the matcher miss the right
# match.
_MAX_EPIPOLAR_ERROR_PX = 1.0


def views_depth(
    scan: Scan,
    params: DepthParams | None = None,
    progress: Progress = ignore_progress,
    **changes: Unpack[DepthKeywords],
) -> Iterator[tuple[Frame, DepthMap | SkippedFrame]]:
    """Compute depth for every view of a scan without stereo rig.

    Each view is matched with several partners at once by a plane sweep (see
    scanloom.stages.stereo.plane_sweep). With `views="pairs"`, or a stereo network, it is instead rectified
    and matched with each partner, and the depth maps are merged. Swept depth is fused with the maps of other
    views (see scanloom.stages.stereo.view_fusion). Depth is kept where enough other views agree, and where
    the resulting confidence is high enough.

    Background without texture matches anything and gets no depth. It is detected from masks, else from a
    backdrop around the object in all views (see scanloom.stages.stereo.background), and for pairs also from
    missing texture. If masks cut one object out of all views, depth outside of its visual hull is dropped.

    Unmeasured surface of an object is filled from the visual hull (see
    scanloom.stages.stereo.visual_hull_filling), unmeasured planar patches from planes (see
    scanloom.stages.stereo.plane_filling). Low coverage or much filled depth is reported after the last map.

    Images larger than `max_side` are downscaled first, and upside-down images are rotated (see
    scanloom.stages.stereo.upside_down_detection); both are reported before the first map.

    The depth range comes from `min_depth` and `max_depth`, else from the scan: a box, which also crops depth,
    or a range for each frame. Otherwise it comes from feature matches, or from the intersection of the
    optical axes (see scanloom.stages.stereo.depth_ranges). If feature matches contradict the poses, the poses
    are refined, with a warning (see scanloom.stages.stereo.pose_refinement).

    Parameters
    ----------
    scan : with colour and poses, without depth.
    params, changes : parameters of the depth stage, and changes to them by name. `select_partners`,
        `count_supporting_views`
        and `agreement` apply to single views only.
    progress : called after each view of each pass.

    Returns
    -------
    Iterator over frames and depth maps in order. Frames have depth, an undistorted camera, and the given or
    refined pose. In the maps, `disparity` is NaN, because it differs between partners; `max_depth` is the
    maximum of all views; `search` is the range of disparities with the best partner, or of planes;
    `confidence` of pairs does not include the consistency check.

    Raises
    ------
    InputError
        If a view has no pose, the depth range is unknown, poses do not fit the images, or too many views
        cannot be used.
    """
    params = resolve(DepthParams, params, changes)
    total = CoverageCounts()
    for frame, result, counts in _measure_views(scan, params, progress):
        total += counts
        yield frame, result
    report_coverage(total, params)


def _measure_views(
    scan: Scan, params: DepthParams, progress: Progress
) -> Iterator[tuple[Frame, DepthMap | SkippedFrame, CoverageCounts]]:
    """Compute depth of the views, with pixel counts for the coverage report."""
    _check_view_count(scan, params)
    network = load_network(params)
    frames = [downscale(frame, params.max_side) for frame in scan.frames]
    downscaled_count = sum(one is not other for one, other in zip(frames, scan.frames, strict=True))
    scan = replace(scan, frames=frames)
    views = create_posed_views(scan)
    pairs = find_overlapping_pairs(views)
    if params.fix_upside_down:
        scan = rotate_upside_down(scan, views, pairs, params)
    scan, views, seen = _match_and_refine_poses(scan, views, pairs, params)
    if downscaled_count:
        emit(
            DEPTH_IMAGES_SMALLER.warning(
                "{count} images were downscaled to {max_side} px (depth.max_side)",
                count=downscaled_count,
                max_side=params.max_side,
            )
        )
    ranges = [one or other for one, other in zip(read_stated_ranges(scan, views), seen, strict=True)]
    views = assign_depth_ranges(scan, views, ranges, params.min_depth, params.max_depth)
    checked_views = [
        select_partners(views, at, _CHECKED_VIEWS_FACTOR * params.partners) for at in range(len(views))
    ]
    tolerance = params.consistency_tolerance or _derive_tolerance(views, checked_views)
    loose_tolerance = _LOOSE_TOLERANCE_FACTOR * tolerance
    box = widen_scene_box(scan)
    outline = detect_outline(scan, views, params.max_backdrop_contrast)
    max_depth = max(view.far for view in views)
    threads = params.threads or get_thread_count()
    fills_hull = params.fill_from_visual_hull and bool(outline.hull_silhouettes)
    stereo_network = network if network is not None and network.is_stereo else None
    sweeps = params.views == SWEEP and stereo_network is None
    if sweeps:
        params.require_default(PAIR_PARAMETERS, f"depth.views={SWEEP}")
    # Planes are not filled on objects, which are seldom flat and are filled from their hull.
    fills_planes = params.fill_from_planes and sweeps and network is None and not outline.is_known
    pass_count = 2 + sweeps + (fills_hull or fills_planes)
    total = pass_count * len(views)
    min_confidence = params.min_confidence
    if min_confidence is None:
        min_confidence = _MIN_OBJECT_CONFIDENCE if outline.is_known else _MIN_CONFIDENCE
    skipped_views: dict[int, SkippedFrame] = {}
    searches: dict[int, SearchRange] = {}
    counts: dict[int, CoverageCounts] = {}
    with tempfile.TemporaryDirectory(prefix="scanloom-") as folder:
        kept, rated = DepthMapStore(Path(folder)), DepthMapStore(Path(folder) / "rated")
        images = make_image_reader(scan, views, outline)
        measure = partial(
            measure_view, scan, views, checked_views, params, tolerance, outline, stereo_network, images
        )
        measured_views = map_ordered(measure, range(len(views)), threads=threads, max_pending=threads + 2)
        for at, result in enumerate(measured_views):
            if isinstance(result, SkippedFrame):
                skipped_views[at] = result
                _check_skipped_ratio(list(skipped_views.values()), len(views), params.max_skipped_ratio, scan)
            else:
                depth = crop_to_hull(
                    _crop_to_box(result.depth, views[at], box), views[at], outline.silhouettes
                )
                kept.store(at, depth, result.confidence)
                searches[at], counts[at] = result.search, result.counts
            progress(at + 1, total)

        def crop_depth(at: int, depth: DepthImage) -> DepthImage:
            shown = np.where(read_valid_pixels(scan.frames[at]), depth, np.float32(0))
            return crop_to_hull(_crop_to_box(shown, views[at], box), views[at], outline.silhouettes)

        def load_others(at: int) -> Iterator[tuple[PosedView, int]]:
            return ((views[other], other) for other in checked_views[at] if other not in skipped_views)

        def count_support(at: int, depth: DepthImage) -> ViewSupport:
            others = ((view, kept.load_depth(other)) for view, other in load_others(at))
            return count_supporting_views(views[at], depth, others, tolerance, loose_tolerance)

        def rate_view(at: int) -> SkippedFrame | None:
            if at in skipped_views:
                return skipped_views[at]
            depth = kept.load_depth(at)
            try:
                grey = convert_to_grey(read_view_color(scan.frames[at]))
            except InputError as error:
                return _skip_unreadable(scan.frames[at], error)
            trust = compute_sweep_confidence(
                depth, kept.load_confidence(at), grey, count_support(at, depth), outline.is_known
            )
            rated.store(at, depth, trust)
            return None

        def check_view(at: int) -> DepthMap | SkippedFrame:
            if at in skipped_views:
                return skipped_views[at]
            try:
                color = read_view_color(scan.frames[at])
            except InputError as error:
                return _skip_unreadable(scan.frames[at], error)
            if sweeps:
                others = (
                    (view, rated.load_depth(other), rated.load_confidence(other))
                    for view, other in load_others(at)
                )
                fused = fuse_views(
                    views[at],
                    rated.load_depth(at),
                    rated.load_confidence(at),
                    others,
                    tolerance,
                    loose_tolerance,
                )
                foreground, _ = mask_foreground(scan.frames[at], color, outline, params.max_backdrop_contrast)
                depth = crop_depth(at, np.where(foreground, fused.depth, np.float32(0)))
                trust = compute_fused_confidence(fused, convert_to_grey(color), outline.is_known)
                agreeing = fused.nearly_consistent if outline.silhouettes else fused.consistent
                dropped = (agreeing < params.min_consistent_views) | (trust < min_confidence)
                dropped |= _mask_foreign_depth(rated.load_depth(at), depth, ~dropped, loose_tolerance)
            else:
                depth, trust = kept.load_depth(at), kept.load_confidence(at)
                dropped = count_support(at, depth).consistent < params.min_consistent_views
            depth[dropped] = 0
            counts[at] = replace(counts[at], consistent=int(np.count_nonzero(depth)))
            found = _make_depth_map(scan.frames[at], views[at], color, depth, trust, searches[at], max_depth)
            if isinstance(found, DepthMap) and network is not None and not network.is_stereo:
                with collecting() as diagnostics:
                    whole = fill_missing_depth(found, network, params)
                inside = crop_depth(at, whole.depth)
                filled = (inside > 0) & (found.depth == 0)
                found = replace(whole, depth=inside, filled=filled, diagnostics=tuple(diagnostics))
            return found

        if sweeps:
            rates = map_ordered(rate_view, range(len(views)), threads=threads, max_pending=threads + 2)
            for at, unread in enumerate(rates):
                if unread is not None:
                    skipped_views[at] = unread
                progress(len(views) + at + 1, total)
        skipped: list[SkippedFrame] = []
        checked_maps = map_ordered(check_view, range(len(views)), threads=threads, max_pending=threads + 2)

        def report_progress(done: int) -> None:
            progress((pass_count - 2) * len(views) + done, total)

        if fills_hull:
            checked_maps = fill_from_hull(
                checked_maps, scan, views, outline, params, Path(folder), report_progress
            )
        elif fills_planes:
            checked_maps = fill_from_planes(
                checked_maps, scan, views, checked_views, crop_depth, params, Path(folder), report_progress
            )
        for at, checked in enumerate(checked_maps):
            if isinstance(checked, SkippedFrame):
                skipped.append(checked)
                _check_skipped_ratio(skipped, len(views), params.max_skipped_ratio, scan)
                yield scan.frames[at], checked, counts.get(at, CoverageCounts())
            else:
                if checked.filled is not None and network is None:
                    filled_count = int(np.count_nonzero(checked.filled))
                    view_counts = counts[at]
                    counts[at] = (
                        replace(view_counts, plane_filled=filled_count)
                        if fills_planes
                        else replace(view_counts, hull_filled=filled_count)
                    )
                yield _make_measured_frame(scan.frames[at], views[at], checked), checked, counts[at]
            progress((pass_count - 1) * len(views) + at + 1, total)


def _check_view_count(scan: Scan, params: DepthParams) -> None:
    """Raise InputError if there are too few views for a check."""
    count, needed = len(scan.frames), max(params.min_consistent_views + 1, 2)
    if count < needed:
        alone = "a single view has no depth" if count == 1 else f"{count} views are too few"
        raise InputError(
            DEPTH_VIEW_WITHOUT_PARTNER,
            "{alone}: each point must be measured in {needed} views.",
            scan.folder,
            remedy="Use more views" + (", or lower depth.min_consistent_views." if count > 1 else "."),
            alone=alone,
            needed=needed,
        )


def _match_and_refine_poses(
    scan: Scan, views: list[PosedView], pairs: Sequence[tuple[int, int]], params: DepthParams
) -> tuple[Scan, list[PosedView], list[DepthRange | None]]:
    """Match features between views, and refine inaccurate poses.

    Returns
    -------
    The scan and its views, with refined poses if necessary, and the depth range of the triangulated matches
    in each view (None without matches).
    """

    def detect_frame_keypoints(frame: Frame) -> Keypoints | None:
        try:
            return detect_keypoints(convert_to_grey(read_view_color(frame)), _MAX_KEYPOINTS)
        except InputError:
            return None  # reported when the view is measured

    threads = params.threads or get_thread_count()
    points = list(map_ordered(detect_frame_keypoints, scan.frames, threads=threads, max_pending=threads + 2))

    def compare_pair(pair: tuple[int, int]) -> VerifiedMatches | None:
        here, there = (points[at] for at in pair)
        if here is None or there is None:
            return None
        return match_views(views[pair[0]], views[pair[1]], here, there)

    def compare_all_pairs() -> dict[tuple[int, int], VerifiedMatches]:
        every = map_ordered(compare_pair, pairs, threads=threads, max_pending=threads + 2)
        return {pair: found for pair, found in zip(pairs, every, strict=True) if found is not None}

    seen = compare_all_pairs()
    depths = [one for found in seen.values() for one in found.depths]
    if _compute_median_error(seen) > _MAX_EPIPOLAR_ERROR_PX and any(map(len, depths)):
        matched = {pair: found.pixels for pair, found in seen.items()}
        nearer = refine_poses(views, matched, float(np.median(np.concatenate(depths))))
        if nearer is not None:
            scan, views = _replace_poses(scan, views, nearer.poses)
            seen = compare_all_pairs()
            emit(
                DEPTH_POSES_MOVED.warning(
                    "the poses were refined from feature matches: the median epipolar error of held-out "
                    "matches is now {after:.1f} px, {before:.1f} px before",
                    after=nearer.error_after,
                    before=nearer.error_before,
                )
            )
    each: list[list[NDArray[np.float64]]] = [[np.zeros(0)] for _ in views]
    for pair, found in seen.items():
        for at, some in zip(pair, found.depths, strict=True):
            each[at].append(some)
    ranges = [estimate_depth_range(np.concatenate(some)) for some in each]
    _report_misfit(_compute_median_error(seen), scan, params)
    return scan, views, ranges


def _compute_median_error(seen: Mapping[tuple[int, int], VerifiedMatches]) -> float:
    return float(np.median([found.epipolar_error for found in seen.values()])) if seen else 0.0


def _replace_poses(
    scan: Scan, views: Sequence[PosedView], poses: Sequence[Pose]
) -> tuple[Scan, list[PosedView]]:
    frames = [replace(frame, world_from_camera=pose) for frame, pose in zip(scan.frames, poses, strict=True)]
    moved = [replace(view, world_from_camera=pose) for view, pose in zip(views, poses, strict=True)]
    return replace(scan, frames=frames), moved


def _report_misfit(median_error: float, scan: Scan, params: DepthParams) -> None:
    """Warn about poses that do not fit the feature matches.

    Raises
    ------
    InputError
        If the median error exceeds `max_pose_error`.
    """
    if median_error <= _MAX_EPIPOLAR_ERROR_PX:
        return
    if median_error > params.max_pose_error:
        raise InputError(
            POSE_INCONSISTENT_WITH_IMAGES,
            "feature matches between views have a median epipolar error of {off:.1f} px: poses or "
            "calibration do not fit the images.",
            scan.folder,
            remedy=(
                "Set scan.poses=FILE or scan.intrinsics=fx,fy,cx,cy. The maximum error is "
                "depth.max_pose_error, {max_pose_error:g} px."
            ),
            off=median_error,
            max_pose_error=params.max_pose_error,
        )
    emit(
        POSE_INCONSISTENT_WITH_IMAGES.warning(
            "feature matches between views have a median epipolar error of {off:.1f} px: poses or "
            "calibration are inaccurate, and depth will have holes and errors",
            remedy="set others with scan.poses=FILE or scan.intrinsics=fx,fy,cx,cy",
            off=median_error,
        )
    )


def _derive_tolerance(views: Sequence[PosedView], partner_candidates: Sequence[Sequence[int]]) -> float:
    """Return the relative depth difference of one pixel of disparity.

    It is the median over the views with their best partners.
    """
    shares = [
        view.middle_depth / view.camera.fx / float(np.linalg.norm(views[best[0]].centre - view.centre))
        for view, best in zip(views, partner_candidates, strict=True)
        if best
    ]
    return _TOLERANCE_PX * float(np.median(shares)) if shares else math.inf


def _mask_foreign_depth(
    own: DepthImage, fused: DepthImage, trusted: NDArray[np.bool_], tolerance: float
) -> NDArray[np.bool_]:
    """Mask fused depth of other views in a view with little depth of its own.

    Such an image shows something else, for example because it is upside down.
    """
    agrees = np.abs(own - fused) <= np.float32(tolerance) * fused
    trusted = trusted & (fused > 0)
    if np.count_nonzero(agrees & trusted) >= _MIN_OWN_RATIO * np.count_nonzero(trusted):
        return np.zeros(own.shape, bool)
    return np.asarray(~agrees)


def _crop_to_box(depth: DepthImage, view: PosedView, box: NDArray[np.float64] | None) -> DepthImage:
    """Remove depth outside of the scene box."""
    if box is None:
        return depth
    rows, columns = np.nonzero(depth)
    rays = view.compute_rays(columns.astype(np.float64), rows.astype(np.float64))
    points = view.to_world(rays * depth[rows, columns, None])
    outside = ((points < box[0]) | (points > box[1])).any(axis=1)
    kept = np.array(depth)
    kept[rows[outside], columns[outside]] = 0
    return kept


def _skip_unreadable(frame: Frame, error: InputError) -> SkippedFrame:
    return SkippedFrame(frame.name, error.diagnostic.replace_location_fields(frame=None))


def _make_depth_map(
    frame: Frame,
    view: PosedView,
    color: ColorImage,
    depth: DepthImage,
    confidence: NDArray[np.uint8],
    search: SearchRange,
    max_depth: float,
) -> DepthMap | SkippedFrame:
    if not depth.any():
        why = DEPTH_VIEW_UNCONFIRMED.warning("its depth does not agree with other views")
        return SkippedFrame(frame.name, why)
    nothing = np.full(depth.shape, np.nan, np.float32)
    return DepthMap(depth, confidence, nothing, color, view.camera, np.eye(3), search, view.near, max_depth)


def _make_measured_frame(frame: Frame, view: PosedView, result: DepthMap) -> Frame:
    # The image is undistorted now, and so must be its mask; texturing uses the mask to ignore the background.
    mask = None if frame.mask is None else read_valid_pixels(frame).astype(np.uint8) * 255
    return replace(
        frame, camera=view.camera, color=result.color, depth=result.depth, mask=mask, depth_range=None
    )


def _check_skipped_ratio(skipped: Sequence[SkippedFrame], total: int, max_ratio: float, scan: Scan) -> None:
    if len(skipped) > max_ratio * total:
        last = skipped[-1]
        raise InputError(
            SCAN_TOO_MANY_FRAMES_SKIPPED,
            (
                "{skipped_count} of the scan's {total} views cannot be used; max_skipped allows a ratio "
                "of {share:g}. Last unusable view, {last_name}: {reason}"
            ),
            scan.folder,
            skipped_count=len(skipped),
            total=total,
            share=max_ratio,
            last_name=last.name,
            reason=last.reason,
        )
