"""Depth stage for stereo pairs: metric depth with confidence per pixel."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.params import resolve
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING, SCAN_TOO_MANY_FRAMES_SKIPPED
from scanloom.stages.scans.model import images
from scanloom.stages.scans.model.prefetch import map_ordered
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Frame, Scan, SkippedFrame, StereoRig
from scanloom.stages.scans.model.threads import get_thread_count
from scanloom.stages.stereo.codes import DEPTH_ALREADY_MEASURED, DEPTH_RANGE_EMPTY
from scanloom.stages.stereo.depth_map import DepthMap
from scanloom.stages.stereo.disparity import compute_volume_bytes, stereo_disparity
from scanloom.stages.stereo.disparity_confidence import compute_confidence
from scanloom.stages.stereo.network_depth import (
    compute_network_disparity,
    fill_missing_depth,
    load_network,
    report_agreement,
)
from scanloom.stages.stereo.networks.network import Network
from scanloom.stages.stereo.opencv_matching import (
    LARGEST_DISPARITY,
    SUBPIXELS,
    Disparity16,
    OpenCVMatcher,
    SearchRange,
    approximate_left_right_residual,
    compute_left_right_residual,
    mask_matched_pixels,
    mask_textured_pixels,
    narrow_search_range,
)
from scanloom.stages.stereo.pair_checks import check_pair, check_rows
from scanloom.stages.stereo.params import AUTO, FAST, MIN_SEVERAL_PAIRS, DepthParams, SgbmParams
from scanloom.stages.stereo.rectify import RectifiedRig, rectify_rig
from scanloom.stages.stereo.subpixel_refinement import refine_disparity

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import DepthKeywords

__all__ = ["RESULT_VERSION", "DepthMap", "DepthParams", "PairMatcher", "depth", "depth_scan"]

RESULT_VERSION = 4

_Image = NDArray[np.uint8]

# Maximum disparity relative to the image width if the minimum depth is unknown.
_MAX_DISPARITY_RATIO = 0.25
# Default minimum confidence and uniqueness (%), for one or two pairs and for more. With more pairs, fusion
# rejects outliers, so that less certain matches, such as grass and foliage, are useful.
_SINGLE_PAIR_DEFAULTS = (128, 20)
_SEVERAL_PAIRS_DEFAULTS = (16, 5)
# The same minimum confidence for the census matcher, whose confidence is a probability.
_SINGLE_PAIR_MIN_CONFIDENCE, _SEVERAL_PAIRS_MIN_CONFIDENCE = 204, 128


def depth(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    rig: StereoRig,
    params: DepthParams | None = None,
    **changes: Unpack[DepthKeywords],
) -> DepthMap:
    """Compute depth from one calibrated pair.

    The pair is rectified if necessary, matched semi-globally, and checked left against right. Every pixel
    gets a confidence. Pixels below `min_confidence`, or with a depth error above `max_relative_depth_error`,
    have no depth.

    Parameters
    ----------
    left, right : (h, w, 3) RGB or (h, w) grey uint8, of the calibrated size.
    rig : calibration; `rig.rectify_pair` states that rows already correspond.
    params, changes : parameters, and changes to them by name.

    Raises
    ------
    InputError
        If images and calibration do not match, or left and right are swapped.
    UsageError
        If a parameter is out of range.
    StageError
        If the matcher runs out of memory.

    References
    ----------
    Hirschmüller 2008 (semi-global matching); Min et al. 2014 (the optional smoothing).
    """
    params = resolve(DepthParams, params, changes)
    network = load_network(params)
    stage = PairMatcher(
        rectify_rig(rig), params, pair_count=1, calibrated_disparities=rig.disparity_count, network=network
    )
    with collecting() as diagnostics:
        pair = stage.rectify_pair(left, right)
        stage.check_rows(*pair)
        measured = stage.measure(*pair)
    return replace(measured, diagnostics=tuple(diagnostics))


def depth_scan(
    scan: Scan,
    params: DepthParams | None = None,
    progress: Progress = ignore_progress,
    **changes: Unpack[DepthKeywords],
) -> Iterator[tuple[Frame, DepthMap | SkippedFrame]]:
    """Compute depth for every stereo pair of a scan.

    Frames are matched in parallel, a few ahead of the caller, and returned in order. Results do not depend on
    the number of threads.

    Returns
    -------
    Iterator over frames and depth maps. A measured frame has depth instead of a right image, and camera and
    pose of the rectified left image. A skipped frame is unchanged and comes with the reason.

    Raises
    ------
    InputError
        If the scan has no pairs, left and right are swapped, or more than `max_skipped_ratio` of the frames
        cannot be used.
    """
    params = resolve(DepthParams, params, changes)
    if scan.rig is None:
        raise InputError(
            DEPTH_ALREADY_MEASURED,
            "the scan has no stereo pairs, so there is nothing to match.",
            scan.folder,
        )
    stage = PairMatcher(
        rectify_rig(scan.rig),
        params,
        pair_count=len(scan.frames),
        calibrated_disparities=scan.rig.disparity_count,
        network=load_network(params),
    )
    _report_first_pair(stage, scan)
    threads = params.threads or get_thread_count()
    total = len(scan.frames)
    skipped = 0
    results = map_ordered(
        partial(_measure_frame, stage), scan.frames, threads=threads, max_pending=threads + 2
    )
    for done, (frame, result) in enumerate(results, 1):
        if isinstance(result, SkippedFrame):
            skipped += 1
            if skipped > params.max_skipped_ratio * total:
                raise InputError(
                    SCAN_TOO_MANY_FRAMES_SKIPPED,
                    (
                        "{skipped} of the scan's {total} pairs cannot be used; max_skipped allows a ratio "
                        "of {max_skipped:g}. Last unusable pair, {last}: {reason}"
                    ),
                    scan.folder,
                    skipped=skipped,
                    total=total,
                    max_skipped=params.max_skipped_ratio,
                    last=frame.name,
                    reason=result.reason,
                )
        progress(done, total)
        yield frame, result


def _report_first_pair(stage: PairMatcher, scan: Scan) -> None:
    """Check the first readable pair for swapped images and misaligned rows.

    One pair suffices, because all pairs share the calibration.
    """
    for frame in scan.frames:
        try:
            pair = _read_pair(stage, frame)
        except InputError:
            continue  # reported when the frame is measured
        try:
            stage.check_rows(*pair)
        except InputError as error:
            raise error.replace_location(scan.folder) from error
        return


def _read_pair(stage: PairMatcher, frame: Frame) -> tuple[NDArray[Any], NDArray[Any]]:
    left, right = images.read_color(frame), images.read_right(frame)
    if left is None or right is None:
        raise InputError(
            FRAME_IMAGE_MISSING,
            "the {side} image is missing.",
            DiagnosticLocation(frame=frame.name),
            side="left" if left is None else "right",
        )
    files = [source if isinstance(source, Path) else None for source in (frame.color, frame.right)]
    return stage.rectify_pair(left, right, (files[0], files[1]))


def _measure_frame(stage: PairMatcher, frame: Frame) -> tuple[Frame, DepthMap | SkippedFrame]:
    try:
        pair = _read_pair(stage, frame)
    except InputError as error:
        return frame, SkippedFrame(frame.name, error.diagnostic.replace_location_fields(frame=None))
    with collecting() as diagnostics:
        result = stage.measure(*pair)
    result = replace(result, diagnostics=tuple(diagnostics))
    world_from_camera, up = frame.world_from_camera, frame.up
    if world_from_camera is not None:
        left_from_rectified = np.eye(4)
        left_from_rectified[:3, :3] = result.rectified_from_left.T
        world_from_camera = world_from_camera @ left_from_rectified
    measured = replace(
        frame,
        camera=result.camera,
        color=result.color,
        right=None,
        depth=result.depth,
        world_from_camera=world_from_camera,
        up=None if up is None else result.rectified_from_left @ up,
    )
    return measured, result


class PairMatcher:
    """Matching setup shared by all pairs of a rig.

    It holds the search range, the matcher and the depth limit.

    Parameters
    ----------
    rig : rectified rig.
    params : parameters of the depth stage.
    pairs : number of pairs in the scan; from three on, lower confidence is accepted.
    stated : number of disparities stated by the calibration, or None.
    network : network of `model`. A stereo network replaces the matcher, a monocular network fills missing
        depth.
    """

    def __init__(
        self,
        rig: RectifiedRig,
        params: DepthParams,
        pair_count: int,
        calibrated_disparities: int | None = None,
        network: Network | None = None,
    ) -> None:
        self.params = params
        self.network = network
        self.uses_network = network is not None and network.is_stereo
        defaults = _SEVERAL_PAIRS_DEFAULTS if pair_count >= MIN_SEVERAL_PAIRS else _SINGLE_PAIR_DEFAULTS
        given = params.min_confidence, params.sgbm.uniqueness
        min_confidence, uniqueness = (d if g is None else g for d, g in zip(defaults, given, strict=True))
        # A stereo network does not use the search range; disparities outside the image width are rejected
        # afterwards.
        self.search = _derive_search_range(
            rig, params, calibrated_disparities, 1.0 if self.uses_network else _MAX_DISPARITY_RATIO
        )
        volume = compute_volume_bytes(rig.left.width, rig.left.height, self.search.count)
        self.uses_census = not self.uses_network and params.uses_census(pair_count, volume)
        if self.uses_census and params.min_confidence is None:
            min_confidence = (
                _SEVERAL_PAIRS_MIN_CONFIDENCE
                if pair_count >= MIN_SEVERAL_PAIRS
                else _SINGLE_PAIR_MIN_CONFIDENCE
            )
        # Several pairs are matched in parallel instead, one per core.
        self.threads = 1 if pair_count > 1 else params.threads
        # A confidence of 0 means no measurement.
        self.min_confidence = max(min_confidence, 1)
        self.rig = rig
        # The census matcher uses the fast matcher only to narrow the search range.
        self.matcher = OpenCVMatcher(
            FAST if self.uses_census or params.matcher == AUTO else params.matcher,
            params.sgbm.block_size,
            *params.sgbm.penalties,
            params.sgbm.prefilter_cap,
            uniqueness,
        )
        self.narrows_search = (
            not self.uses_network
            and params.min_depth is None
            and params.disparities is None
            and calibrated_disparities is None
        )
        self.max_depth = _compute_max_depth(rig, params)

    def rectify_pair(
        self,
        left: NDArray[np.uint8],
        right: NDArray[np.uint8],
        files: tuple[Path | None, Path | None] = (None, None),
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """Validate a pair against the calibration, and rectify it."""
        check_pair(left, right, self.rig.left, files)
        return self.rig.apply(left, right)

    def check_rows(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> None:
        """Warn if rows of a rectified pair differ; see `scanloom.stages.stereo.pair_checks`."""
        check_rows(_to_grey(left), _to_grey(right), self.rig.principal_offset)

    def measure(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> DepthMap:
        """Compute depth of a rectified pair."""
        pair = _to_grey(left), _to_grey(right)
        search = narrow_search_range(*pair, self.search, self.matcher) if self.narrows_search else self.search
        if self.network is not None and self.uses_network:
            disparity, confidence_map = compute_network_disparity(
                self.network, left, right, self.rig, search, self.params
            )
            report_agreement(self.network, confidence_map)
        elif self.uses_census:
            disparity, confidence_map = self._match_with_census(left, right, pair, search)
        else:
            disparity, confidence_map = self._match_with_opencv(left, pair, search)
        min_depth = self.params.min_depth or 0.0
        if self.params.refine and not self.params.sgbm.smooth:
            disparity = refine_disparity(*pair, disparity, confidence_map >= self.min_confidence)
        measured = DepthMap(
            self._convert_to_depth(disparity, confidence_map),
            confidence_map,
            disparity,
            _to_rgb(left),
            self.rig.left,
            self.rig.rectified_from_left,
            search,
            max(self.rig.focal_baseline / (search.end - 1 + self.rig.principal_offset), min_depth),
            self.max_depth,
        )
        if self.network is None or self.uses_network:
            return measured
        return fill_missing_depth(measured, self.network, self.params)

    def _match_with_census(
        self, left: _Image, right: _Image, pair: tuple[_Image, _Image], search: SearchRange
    ) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Match a pair with the census matcher.

        Returns
        -------
        Disparity, (h, w) float32 px, NaN where missing, and confidence, (h, w) uint8.
        """
        found = stereo_disparity(
            left, right, search.end - 1, min_disparity=search.lowest, min_confidence=0, threads=self.threads
        )
        trust = np.rint(255 * found.confidence).astype(np.uint8)
        trust[~mask_textured_pixels(pair[0], self.params.min_texture)] = 0
        return found.disparity, trust

    def _match_with_opencv(
        self, left: _Image, pair: tuple[_Image, _Image], search: SearchRange
    ) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Match a pair with an OpenCV matcher; returns as `_match_with_census`."""
        first = self.matcher.match_left(*pair, search)
        if self.params.sgbm.left_right == "match":
            residual = compute_left_right_residual(first, self.matcher.match_right(*pair, search), search)
        else:
            residual = approximate_left_right_residual(first, search, self.params.left_right_tolerance)
        matched = mask_matched_pixels(
            first,
            residual,
            search,
            tolerance=self.params.left_right_tolerance,
            speckle_size=self.params.speckle_size,
            speckle_range=self.params.speckle_range,
        )
        matched &= mask_textured_pixels(pair[0], self.params.min_texture)
        trust = compute_confidence(first, residual, matched, search)
        if self.params.sgbm.smooth:
            second = self.matcher.match_right(*pair, search)
            first = _smooth_disparity(first, second, _to_rgb(left), self.params.sgbm)
        none = first < SUBPIXELS * search.lowest
        return np.where(none, np.float32(np.nan), first * np.float32(1 / SUBPIXELS)), trust

    def _convert_to_depth(
        self, disparity: NDArray[np.float32], confidence_map: NDArray[np.uint8]
    ) -> DepthImage:
        """Convert disparity to depth.

        Depth is z = f·b / (d + cx_right − cx_left), and 0 where the confidence is too low or z is out of
        range.
        """
        parallel = disparity + np.float32(self.rig.principal_offset)
        used = (confidence_map >= self.min_confidence) & (parallel > 0)
        z = np.divide(np.float32(self.rig.focal_baseline), parallel, out=np.zeros_like(parallel), where=used)
        z[(z < (self.params.min_depth or 0)) | (z > self.max_depth)] = 0
        return np.asarray(z, np.float32)


def _smooth_disparity(
    left: Disparity16, right: Disparity16, guide: ColorImage, sgbm: SgbmParams
) -> Disparity16:
    """Smooth the left disparity, guided by the edges of the left image.

    This is the weighted least squares filter of ximgproc (Min et al., "Fast global image smoothing based on
    weighted least squares", 2014). The result is dense: pixels that fail the filter's left–right check are
    interpolated from their surroundings, not measured.
    """
    import cv2

    wls = cv2.ximgproc.createDisparityWLSFilterGeneric(True)
    wls.setLambda(sgbm.smooth_lambda)
    wls.setSigmaColor(sgbm.smooth_sigma)
    wls.setDepthDiscontinuityRadius((sgbm.block_size + 1) // 2)
    return np.asarray(wls.filter(left, guide, disparity_map_right=right), np.int16)


def _compute_max_depth(rig: RectifiedRig, params: DepthParams) -> float:
    """Return the maximum depth.

    It is the depth at which σ_z = z²/(f·b)·σ_d reaches the allowed ratio of z, or `max_depth` if smaller.
    """
    bound = params.max_relative_depth_error * rig.focal_baseline / params.disparity_sigma
    return min(bound, params.max_depth) if params.max_depth is not None else bound


def _derive_search_range(
    rig: RectifiedRig, params: DepthParams, calibrated_disparities: int | None, max_width_ratio: float
) -> SearchRange:
    """Derive the disparity search range from the depth range.

    Parameters
    ----------
    calibrated_disparities : number of disparities stated by the calibration, from 0; None if not stated.
    max_width_ratio : maximum disparity relative to the image width, if the minimum depth is unknown.

    Raises
    ------
    UsageError
        If `max_depth` is smaller than the minimum depth that can be matched.
    """
    width, offset = rig.left.width, rig.principal_offset
    # Rays are parallel at disparity −offset (infinite depth).
    parallel = 0.0 if params.max_depth is None else rig.focal_baseline / params.max_depth
    lowest = math.floor(parallel - offset)
    if params.disparities is not None:
        highest = lowest + params.disparities - 1.0
    elif params.min_depth is not None:
        highest = rig.focal_baseline / params.min_depth - offset
    elif calibrated_disparities is not None:
        lowest = max(lowest, 0)
        highest = calibrated_disparities - 1.0
    else:
        highest = max(lowest, 0) + width * max_width_ratio
    # At a disparity of the image width, the images do not overlap.
    limit = min(width - 1, LARGEST_DISPARITY)
    if lowest > limit or highest < lowest:
        raise UsageError(
            DEPTH_RANGE_EMPTY,
            "is {max_depth:g} m, but the rig measures depth from {focal_baseline:.3g} m only",
            DiagnosticLocation(parameter="max_depth"),
            remedy="increase it.",
            max_depth=params.max_depth,
            focal_baseline=rig.focal_baseline / (min(highest, limit) + offset),
        )
    return SearchRange.from_bounds(lowest, min(highest, limit))


def _to_grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    import cv2

    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)


def _to_rgb(image: NDArray[np.uint8]) -> ColorImage:
    import cv2

    return image if image.ndim == 3 else np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2RGB), np.uint8)
