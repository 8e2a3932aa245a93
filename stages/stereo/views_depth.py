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
from scanloom.stages.progress import Progress, silent
from scanloom.stages.scans.codes import POSE_INCONSISTENT_WITH_IMAGES, SCAN_TOO_MANY_FRAMES_SKIPPED
from scanloom.stages.scans.model.depth_range import Range, range_of_points
from scanloom.stages.scans.model.images import read_seen
from scanloom.stages.scans.model.prefetch import read_ahead
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Frame, Pose, Scan, SkippedFrame
from scanloom.stages.scans.model.threads import threads_to_use
from scanloom.stages.stereo.agreement import agreeing_views
from scanloom.stages.stereo.by_network import completed, network_of
from scanloom.stages.stereo.codes import (
    DEPTH_IMAGES_SMALLER,
    DEPTH_POSES_MOVED,
    DEPTH_VIEW_UNCONFIRMED,
    DEPTH_VIEW_WITHOUT_PARTNER,
)
from scanloom.stages.stereo.coverage import Counts, report_coverage
from scanloom.stages.stereo.depth_map import DepthMap
from scanloom.stages.stereo.hull_fill import filled_in
from scanloom.stages.stereo.kept_maps import KeptMaps
from scanloom.stages.stereo.matching import SearchRange
from scanloom.stages.stereo.nearer_poses import nearer_poses
from scanloom.stages.stereo.params import OF_PAIRS, SWEEP, DepthParams
from scanloom.stages.stereo.partners import partners
from scanloom.stages.stereo.plane_fill import filled_on_planes
from scanloom.stages.stereo.posed_views import PosedView, posed_views
from scanloom.stages.stereo.recognised import Recognised, neighbours, recognised
from scanloom.stages.stereo.scene_depth import ranged_views, scene_box, stated_ranges
from scanloom.stages.stereo.shown import in_hull, outline_of
from scanloom.stages.stereo.turned_back import turned_back
from scanloom.stages.stereo.view_images import color_of, downscale, grey_of
from scanloom.stages.stereo.view_matching import images_of, measured_view
from scanloom.stages.stereo.views_confidence import views_confidence

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import DepthKeywords

RESULT_VERSION = 7

# Maximum difference of agreeing depth maps, in pixels of disparity.
_TOLERANCE_PX = 1.0
# Tolerance of near agreement, relative to the tolerance of agreement.
_NEARLY = 2.5
# Number of views each map is checked against, relative to the number of partners; the best partners first.
_CHECKED_ON = 2
# Minimum confidence of swept depth, of 255: right in four of five cases; for an object with known outline one
# of two, because there is no background behind it to be confused with.
_LEAST, _LEAST_OF_A_THING = 204, 128
# Keypoints per view. Keypoints of all views are in memory at once, 0.5 kB each.
_KEYPOINTS = 1000
# Median epipolar error in pixels above which poses are refined; larger errors make the matcher miss the right
# match.
_LARGEST_OFF_PX = 1.0


def views_depth(
    scan: Scan,
    params: DepthParams | None = None,
    progress: Progress = silent,
    **changes: Unpack[DepthKeywords],
) -> Iterator[tuple[Frame, DepthMap | SkippedFrame]]:
    """Compute depth for every view of a scan without stereo rig.

    Each view is matched with several partners at once by a plane sweep (see
    scanloom.stages.stereo.plane_sweep). With `views="pairs"`, or a stereo network, it is instead rectified
    and matched with each partner, and the depth maps are merged. Depth is kept where enough other views
    agree, and where the resulting confidence is high enough.

    Background without texture matches anything and gets no depth. It is detected from masks, else from a
    backdrop around the object in all views (see scanloom.stages.stereo.background), and for pairs also from
    missing texture. If masks cut one object out of all views, depth outside of its visual hull is dropped.

    Unmeasured surface of an object is filled from the visual hull (see scanloom.stages.stereo.hull_fill),
    unmeasured planar patches from planes (see scanloom.stages.stereo.plane_fill). Low coverage or much filled
    depth is reported after the last map.

    Images larger than `max_side` are downscaled first, and upside-down images are rotated (see
    scanloom.stages.stereo.turned); both are reported before the first map.

    The depth range comes from `min_depth` and `max_depth`, else from the scan: a box, which also crops depth,
    or a range for each frame. Otherwise it comes from feature matches, or from the intersection of the
    optical axes (see scanloom.stages.stereo.scene_depth). If feature matches contradict the poses, the poses
    are refined, with a warning (see scanloom.stages.stereo.nearer_poses).

    Parameters
    ----------
    scan : with colour and poses, without depth.
    params, changes : parameters of the depth stage, and changes to them by name. `partners`, `agreeing_views`
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
    total = Counts()
    for frame, result, counts in _results(scan, params, progress):
        total += counts
        yield frame, result
    report_coverage(total, params)


def _results(
    scan: Scan, params: DepthParams, progress: Progress
) -> Iterator[tuple[Frame, DepthMap | SkippedFrame, Counts]]:
    """Compute depth of the views, with pixel counts for the coverage report."""
    _require_enough(scan, params)
    network = network_of(params)
    frames = [downscale(frame, params.max_side) for frame in scan.frames]
    smaller = sum(one is not other for one, other in zip(frames, scan.frames, strict=True))
    scan = replace(scan, frames=frames)
    views = posed_views(scan)
    pairs = neighbours(views)
    if params.turn_back:
        scan = turned_back(scan, views, pairs, params)
    scan, views, seen = _recognised(scan, views, pairs, params)
    if smaller:
        emit(
            DEPTH_IMAGES_SMALLER.warning(
                "{count} images were downscaled to {max_side} px (depth.max_side)",
                count=smaller,
                max_side=params.max_side,
            )
        )
    ranges = [one or other for one, other in zip(stated_ranges(scan, views), seen, strict=True)]
    views = ranged_views(scan, views, ranges, params.min_depth, params.max_depth)
    chosen = [partners(views, at, _CHECKED_ON * params.partners) for at in range(len(views))]
    tolerance = params.agreement or _tolerance(views, chosen)
    box = scene_box(scan)
    outline = outline_of(scan, views, params.backdrop)
    farthest = max(view.far for view in views)
    threads = params.threads or threads_to_use()
    fills = params.on_hull and bool(outline.hull)
    of_pairs = network if network is not None and network.is_stereo else None
    sweeps = params.views == SWEEP and of_pairs is None
    if sweeps:
        params.require_default(OF_PAIRS, f"depth.views={SWEEP}")
    # Planes are not filled on objects, which are seldom flat and are filled from their hull.
    on_planes = params.on_planes and sweeps and network is None and not outline.is_known
    turns = 3 if fills or on_planes else 2
    total = turns * len(views)
    least = params.min_confidence
    if least is None:
        least = _LEAST_OF_A_THING if outline.is_known else _LEAST
    lost: dict[int, SkippedFrame] = {}
    searches: dict[int, SearchRange] = {}
    counts: dict[int, Counts] = {}
    with tempfile.TemporaryDirectory(prefix="scanloom-") as folder:
        kept = KeptMaps(Path(folder))
        images = images_of(scan, views, outline)
        measure = partial(measured_view, scan, views, chosen, params, tolerance, outline, of_pairs, images)
        first_turn = read_ahead(measure, range(len(views)), threads=threads, ahead=threads + 2)
        for at, result in enumerate(first_turn):
            if isinstance(result, SkippedFrame):
                lost[at] = result
                _require_share(list(lost.values()), len(views), params.max_skipped, scan)
            else:
                depth = in_hull(_inside(result.depth, views[at], box), views[at], outline.silhouettes)
                kept.put(at, depth, result.confidence)
                searches[at], counts[at] = result.search, result.counts
            progress(at + 1, total)

        def within(at: int, depth: DepthImage) -> DepthImage:
            shown = np.where(read_seen(scan.frames[at]), depth, np.float32(0))
            return in_hull(_inside(shown, views[at], box), views[at], outline.silhouettes)

        def check(at: int) -> DepthMap | SkippedFrame:
            if at in lost:
                return lost[at]
            depth = kept.depth(at)
            others = ((views[other], kept.depth(other)) for other in chosen[at] if other not in lost)
            try:
                color = color_of(scan.frames[at])
            except InputError as error:
                return SkippedFrame(scan.frames[at].name, error.diagnostic.within(frame=None))
            said = agreeing_views(views[at], depth, others, tolerance, _NEARLY * tolerance)
            trust = kept.confidence(at)
            dropped = (
                said.nearly if sweeps and outline.silhouettes else said.agreeing
            ) < params.agreeing_views
            if sweeps:
                trust = views_confidence(depth, trust, grey_of(color), said, outline.is_known)
                dropped |= trust < least
            depth[dropped] = 0
            counts[at] = replace(counts[at], kept=int(np.count_nonzero(depth)))
            found = _depth_map(scan.frames[at], views[at], color, depth, trust, searches[at], farthest)
            if isinstance(found, DepthMap) and network is not None and not network.is_stereo:
                with collecting() as diagnostics:
                    whole = completed(found, network, params)
                inside = within(at, whole.depth)
                filled = (inside > 0) & (found.depth == 0)
                found = replace(whole, depth=inside, filled=filled, diagnostics=tuple(diagnostics))
            return found

        skipped: list[SkippedFrame] = []
        last_turn = read_ahead(check, range(len(views)), threads=threads, ahead=threads + 2)

        def tell(done: int) -> None:
            progress(len(views) + done, total)

        if fills:
            last_turn = filled_in(last_turn, scan, views, outline, params, Path(folder), tell)
        elif on_planes:
            last_turn = filled_on_planes(last_turn, scan, views, chosen, within, params, Path(folder), tell)
        for at, checked in enumerate(last_turn):
            if isinstance(checked, SkippedFrame):
                skipped.append(checked)
                _require_share(skipped, len(views), params.max_skipped, scan)
                yield scan.frames[at], checked, counts.get(at, Counts())
            else:
                if checked.filled is not None and network is None:
                    told = int(np.count_nonzero(checked.filled))
                    of = counts[at]
                    counts[at] = replace(of, planar=told) if on_planes else replace(of, filled=told)
                yield _measured_frame(scan.frames[at], views[at], checked), checked, counts[at]
            progress((turns - 1) * len(views) + at + 1, total)


def _require_enough(scan: Scan, params: DepthParams) -> None:
    """Raise InputError if there are too few views for a check."""
    count, needed = len(scan.frames), max(params.agreeing_views + 1, 2)
    if count < needed:
        alone = "a single view has no depth" if count == 1 else f"{count} views are too few"
        raise InputError(
            DEPTH_VIEW_WITHOUT_PARTNER,
            "{alone}: each point must be measured in {needed} views.",
            scan.folder,
            remedy="Use more views" + (", or lower depth.agreeing_views." if count > 1 else "."),
            alone=alone,
            needed=needed,
        )


def _recognised(
    scan: Scan, views: list[PosedView], pairs: Sequence[tuple[int, int]], params: DepthParams
) -> tuple[Scan, list[PosedView], list[Range | None]]:
    """Match features between views, and refine inaccurate poses.

    Returns
    -------
    The scan and its views, with refined poses if necessary, and the depth range of the triangulated matches
    in each view (None without matches).
    """

    def read(frame: Frame) -> Keypoints | None:
        try:
            return detect_keypoints(grey_of(color_of(frame)), _KEYPOINTS)
        except InputError:
            return None  # reported when the view is measured

    threads = params.threads or threads_to_use()
    points = list(read_ahead(read, scan.frames, threads=threads, ahead=threads + 2))

    def compare(pair: tuple[int, int]) -> Recognised | None:
        here, there = (points[at] for at in pair)
        if here is None or there is None:
            return None
        return recognised(views[pair[0]], views[pair[1]], here, there)

    def compared() -> dict[tuple[int, int], Recognised]:
        every = read_ahead(compare, pairs, threads=threads, ahead=threads + 2)
        return {pair: found for pair, found in zip(pairs, every, strict=True) if found is not None}

    seen = compared()
    depths = [one for found in seen.values() for one in found.depths]
    if _usual_off(seen) > _LARGEST_OFF_PX and any(map(len, depths)):
        matched = {pair: found.pixels for pair, found in seen.items()}
        nearer = nearer_poses(views, matched, float(np.median(np.concatenate(depths))))
        if nearer is not None:
            scan, views = _with_poses(scan, views, nearer.poses)
            seen = compared()
            emit(
                DEPTH_POSES_MOVED.warning(
                    "the poses were refined from feature matches: the median epipolar error of held-out "
                    "matches is now {after:.1f} px, {before:.1f} px before",
                    after=nearer.after,
                    before=nearer.before,
                )
            )
    each: list[list[NDArray[np.float64]]] = [[np.zeros(0)] for _ in views]
    for pair, found in seen.items():
        for at, some in zip(pair, found.depths, strict=True):
            each[at].append(some)
    ranges = [range_of_points(np.concatenate(some)) for some in each]
    _report_misfit(_usual_off(seen), scan, params)
    return scan, views, ranges


def _usual_off(seen: Mapping[tuple[int, int], Recognised]) -> float:
    return float(np.median([found.off for found in seen.values()])) if seen else 0.0


def _with_poses(
    scan: Scan, views: Sequence[PosedView], poses: Sequence[Pose]
) -> tuple[Scan, list[PosedView]]:
    frames = [replace(frame, world_from_camera=pose) for frame, pose in zip(scan.frames, poses, strict=True)]
    moved = [replace(view, world_from_camera=pose) for view, pose in zip(views, poses, strict=True)]
    return replace(scan, frames=frames), moved


def _report_misfit(usual: float, scan: Scan, params: DepthParams) -> None:
    """Warn about poses that do not fit the feature matches.

    Raises
    ------
    InputError
        If the median error exceeds `max_pose_error`.
    """
    if usual <= _LARGEST_OFF_PX:
        return
    if usual > params.max_pose_error:
        raise InputError(
            POSE_INCONSISTENT_WITH_IMAGES,
            "feature matches between views have a median epipolar error of {off:.1f} px: poses or "
            "calibration do not fit the images.",
            scan.folder,
            remedy=(
                "Set scan.poses=FILE or scan.intrinsics=fx,fy,cx,cy. The maximum error is "
                "depth.max_pose_error, {max_pose_error:g} px."
            ),
            off=usual,
            max_pose_error=params.max_pose_error,
        )
    emit(
        POSE_INCONSISTENT_WITH_IMAGES.warning(
            "feature matches between views have a median epipolar error of {off:.1f} px: poses or "
            "calibration are inaccurate, and depth will have holes and errors",
            remedy="set others with scan.poses=FILE or scan.intrinsics=fx,fy,cx,cy",
            off=usual,
        )
    )


def _tolerance(views: Sequence[PosedView], chosen: Sequence[Sequence[int]]) -> float:
    """Return the relative depth difference of one pixel of disparity.

    It is the median over the views with their best partners.
    """
    shares = [
        view.middle / view.camera.fx / float(np.linalg.norm(views[best[0]].centre - view.centre))
        for view, best in zip(views, chosen, strict=True)
        if best
    ]
    return _TOLERANCE_PX * float(np.median(shares)) if shares else math.inf


def _inside(depth: DepthImage, view: PosedView, box: NDArray[np.float64] | None) -> DepthImage:
    """Remove depth outside of the scene box."""
    if box is None:
        return depth
    rows, columns = np.nonzero(depth)
    rays = view.rays(columns.astype(np.float64), rows.astype(np.float64))
    points = view.to_world(rays * depth[rows, columns, None])
    outside = ((points < box[0]) | (points > box[1])).any(axis=1)
    kept = np.array(depth)
    kept[rows[outside], columns[outside]] = 0
    return kept


def _depth_map(
    frame: Frame,
    view: PosedView,
    color: ColorImage,
    depth: DepthImage,
    confidence: NDArray[np.uint8],
    search: SearchRange,
    farthest: float,
) -> DepthMap | SkippedFrame:
    if not depth.any():
        why = DEPTH_VIEW_UNCONFIRMED.warning("its depth does not agree with other views")
        return SkippedFrame(frame.name, why)
    nothing = np.full(depth.shape, np.nan, np.float32)
    return DepthMap(depth, confidence, nothing, color, view.camera, np.eye(3), search, view.near, farthest)


def _measured_frame(frame: Frame, view: PosedView, result: DepthMap) -> Frame:
    # The image is undistorted now, and so must be its mask; texturing uses the mask to ignore the background.
    mask = None if frame.mask is None else read_seen(frame).astype(np.uint8) * 255
    return replace(
        frame, camera=view.camera, color=result.color, depth=result.depth, mask=mask, depth_range=None
    )


def _require_share(skipped: Sequence[SkippedFrame], total: int, share: float, scan: Scan) -> None:
    if len(skipped) > share * total:
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
            share=share,
            last_name=last.name,
            reason=last.reason,
        )
