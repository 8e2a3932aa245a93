"""Conversion of scans with unknown scale to metres.

Poses that were estimated from photos alone have an arbitrary unit.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.scans.codes import SCALE_NOT_METRIC
from scanloom.stages.scans.model.scan import Frame, Pose, Scan, StereoRig
from scanloom.stages.scans.model.world import Scale
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.transforms.tag_scale import estimate_scale_from_tags

# Maximum relative correction of a metric scan without a warning.
_MAX_CORRECTION_RATIO = 0.1


def apply_scale(scan: Scan, options: ScanParams, folder: Path) -> Scan:
    """Scale a scan to metres if its scale is given or can be measured.

    All lengths are multiplied, including depth, so that depth and poses stay consistent. If depth is metric
    and the poses come from another file, only the poses are scaled. Without a scale, a scan that is not
    metric gets a warning. For photos without poses, the scale is stated, and applied to estimated poses.

    Raises
    ------
    InputError
        If the scale must be measured from tags, and this fails.
    """
    has_lengths = scan.has_poses or not scan.is_views
    if not has_lengths and options.tag_size is not None:
        # A run measures the tags after it estimated the poses.
        return replace(scan, is_metric=True)
    scale = _resolve_scale(scan, options, folder)
    if scale is None:
        if not scan.is_metric:
            emit(
                SCALE_NOT_METRIC.warning(
                    "this scan has no metric scale: its unit is treated as a metre, so lengths of all "
                    "results are in that unit",
                    remedy="scan.scale=METRES_PER_UNIT, scan.known_distance='MEASURED METRES' or "
                    "scan.tag_size=METRES converts to metres",
                )
            )
        return scan
    if not has_lengths:
        return replace(scan, is_metric=True, scale=scale)
    factor = scale.metres_per_unit
    if options.poses is not None and scan.is_metric and not scan.is_views:
        frames = [_scale_frame_pose(frame, factor) for frame in scan.frames]
        return replace(scan, frames=frames, scale=scale)
    is_stated = options.depth_scale is not None or options.poses is not None
    if scan.is_metric and not is_stated and abs(factor - 1) > _MAX_CORRECTION_RATIO:
        emit(
            SCALE_NOT_METRIC.warning(
                "layout {layout} is metric, but its lengths are multiplied by {factor:.4g}",
                layout=scan.layout,
                factor=factor,
            )
        )
    return replace(
        scan,
        frames=[_scale_frame(frame, factor) for frame in scan.frames],
        rig=None if scan.rig is None else _scale_rig(scan.rig, factor),
        bounding_box=None if scan.bounding_box is None else scan.bounding_box * factor,
        is_metric=True,
        scale=scale,
    )


def _resolve_scale(scan: Scan, options: ScanParams, folder: Path) -> Scale | None:
    stated = options.resolve_scale()
    if stated is not None:
        return Scale(stated, "given" if options.scale is not None else "a known distance")
    if options.tag_size is not None:
        return estimate_scale_from_tags(scan.frames, options.tag_size, options.tag_family, folder)
    return None


def _scale_frame_pose(frame: Frame, factor: float) -> Frame:
    pose = frame.world_from_camera
    return frame if pose is None else replace(frame, world_from_camera=_scale_pose(pose, factor))


def _scale_frame(frame: Frame, factor: float) -> Frame:
    color_from_depth, near_and_far, depth = frame.color_from_depth, frame.depth_range, frame.depth
    return replace(
        _scale_frame_pose(frame, factor),
        depth=depth * np.float32(factor) if isinstance(depth, np.ndarray) else depth,
        depth_scale=frame.depth_scale / factor,
        color_from_depth=None if color_from_depth is None else _scale_pose(color_from_depth, factor),
        depth_range=None if near_and_far is None else (near_and_far[0] * factor, near_and_far[1] * factor),
    )


def _scale_rig(rig: StereoRig, factor: float) -> StereoRig:
    return replace(rig, right_from_left=_scale_pose(rig.right_from_left, factor))


def _scale_pose(pose: Pose, factor: float) -> Pose:
    scaled: Pose = pose.copy()
    scaled[:3, 3] *= factor
    return scaled
