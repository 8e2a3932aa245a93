"""Completion of existing depth maps with a monocular network."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.frames.aligned_color import read_color_aligned_to_depth
from scanloom.stages.params import resolve
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING, SCAN_TOO_MANY_FRAMES_SKIPPED
from scanloom.stages.scans.model.images import read_color, read_depth, read_valid_pixels
from scanloom.stages.scans.model.prefetch import map_ordered
from scanloom.stages.scans.model.scan import Frame, Scan, SkippedFrame, to_pinhole
from scanloom.stages.scans.model.threads import get_thread_count
from scanloom.stages.stereo.codes import DEPTH_FAR_LEFT_OUT, DEPTH_NETWORK_NO_EFFECT
from scanloom.stages.stereo.depth_map import DepthMap
from scanloom.stages.stereo.network_depth import fill_missing_depth, load_network
from scanloom.stages.stereo.networks.network import Network
from scanloom.stages.stereo.opencv_matching import SearchRange
from scanloom.stages.stereo.params import DepthParams

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import DepthKeywords

RESULT_VERSION = 1

# Depth files have 16-bit steps: 1 mm, or the scan's own unit if it is finer.
_MAX_DEPTH_VALUE = np.iinfo(np.uint16).max
_MIN_DEPTH_SCALE = 1000


def completed_scan(
    scan: Scan,
    params: DepthParams | None = None,
    progress: Progress = ignore_progress,
    **changes: Unpack[DepthKeywords],
) -> Iterator[tuple[Frame, DepthMap | SkippedFrame]]:
    """Fill missing depth of a scan with a monocular network.

    Measured depth is unchanged and has a confidence of 255; filled depth has 1. Frames keep their photos,
    poses and cameras, without lens distortion.

    Parameters
    ----------
    scan : with depth and colour.
    params, changes : parameters of the depth stage; `model` is required.
    progress : called after each frame.

    Returns
    -------
    Iterator over the frames in order, each with its depth map or the reason why it was skipped.

    Raises
    ------
    InputError
        If the network cannot be run, or more than `max_skipped_ratio` of the frames cannot be used.
    UsageError
        If no network is given, or it is a stereo network.
    """
    params = resolve(DepthParams, params, changes)
    network = load_network(params)
    if network is None or network.is_stereo:
        what = "" if network is None else f"; {network.file.name} is a stereo network"
        raise UsageError(
            DEPTH_NETWORK_NO_EFFECT,
            "the scan already has depth, which only a monocular network (depth.model) can fill{what}.",
            what=what,
        )
    finest = max([_MIN_DEPTH_SCALE, *(frame.depth_scale for frame in scan.frames)])
    farthest = params.max_depth or _MAX_DEPTH_VALUE / finest
    threads = params.threads or get_thread_count()
    results = map_ordered(
        partial(_complete_frame, network, params, farthest),
        scan.frames,
        threads=threads,
        max_pending=threads + 2,
    )
    skipped = 0
    for done, (frame, result) in enumerate(results, 1):
        if isinstance(result, SkippedFrame):
            skipped += 1
            if skipped > params.max_skipped_ratio * len(scan.frames):
                raise InputError(
                    SCAN_TOO_MANY_FRAMES_SKIPPED,
                    (
                        "{skipped} of the scan's {frames_count} frames cannot be used; max_skipped allows "
                        "a ratio of {max_skipped:g}. Last unusable frame, {last}: {reason}"
                    ),
                    scan.folder,
                    skipped=skipped,
                    frames_count=len(scan.frames),
                    max_skipped=params.max_skipped_ratio,
                    last=frame.name,
                    reason=result.reason,
                )
        progress(done, len(scan.frames))
        yield frame, result


def _complete_frame(
    network: Network, params: DepthParams, max_depth: float, frame: Frame
) -> tuple[Frame, DepthMap | SkippedFrame]:
    try:
        depth, photo = read_depth(frame), read_color(frame)
        if depth is None or photo is None:
            missing = "depth map" if depth is None else "photo"
            why = FRAME_IMAGE_MISSING.warning("the {missing} is missing", missing=missing)
            return frame, SkippedFrame(frame.name, why)
        color = read_color_aligned_to_depth(frame, depth)
        seen = read_valid_pixels(frame) if frame.mask is not None else None
    except InputError as error:
        return frame, SkippedFrame(frame.name, error.diagnostic.replace_location_fields(frame=None))
    too_far = depth > max_depth
    measured = DepthMap(
        np.where(too_far, np.float32(0), depth),
        np.where((depth > 0) & ~too_far, np.uint8(255), np.uint8(0)),
        np.full(depth.shape, np.nan, np.float32),
        color,
        to_pinhole(frame.camera),
        np.eye(3),
        SearchRange(0, 0),
        params.min_depth or 0.0,
        max_depth,
    )
    with collecting() as diagnostics:
        if too_far.any():
            emit(
                DEPTH_FAR_LEFT_OUT.warning(
                    "depth beyond {farthest:.4g} m is dropped (depth.max_depth)", farthest=max_depth
                )
            )
        whole = fill_missing_depth(measured, network, params)
    whole = replace(whole, diagnostics=tuple(diagnostics))
    mask = None
    if seen is not None:
        # Masked pixels are not filled.
        inside = np.where(seen, whole.depth, np.float32(0))
        whole = replace(whole, depth=inside, filled=(inside > 0) & (measured.depth == 0))
        mask = 255 * seen.astype(np.uint8)
    kept = replace(
        frame,
        camera=whole.camera,
        color=photo,
        color_camera=None if frame.color_camera is None else to_pinhole(frame.color_camera),
        depth=whole.depth,
        confidence=None,
        min_confidence=0,
        mask=mask,
        shutter_turn=None,
        depth_correction=None,
    )
    return kept, whole
