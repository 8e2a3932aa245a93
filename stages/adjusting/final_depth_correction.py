"""Depth correction of a finished adjustment: its scale, its description, and the frames that get it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from scanloom.stages.adjusting.bundle_adjustment import BundleResult
from scanloom.stages.adjusting.cameras import Cameras
from scanloom.stages.adjusting.depth_calibration import DepthAgreement, estimate_pose_scale
from scanloom.stages.adjusting.view import AdjustmentView
from scanloom.stages.scans.model.depth_correction import DepthCorrection
from scanloom.stages.scans.model.scan import Frame


def may_fit_depth(frames: Sequence[Frame], depth: bool | None) -> bool | None:
    """Return False if no depth correction can be fitted, otherwise the parameter `depth`.

    None lets the bundle adjustment decide. A correction requires frames without one and a single depth
    camera.
    """
    with_depth = [frame for frame in frames if frame.depth is not None]
    is_plain = all(
        frame.depth_correction is None and frame.camera == with_depth[0].camera for frame in with_depth
    )
    return depth if is_plain else False


def finish_depth_correction(
    bundle_result: BundleResult, frame: Frame, given: Cameras | None
) -> tuple[Sequence[AdjustmentView], Cameras, DepthCorrection | None]:
    """Scale corrected depth and poses to the given poses.

    Parameters
    ----------
    frame : any frame with depth; all have the same depth camera.
    given : cameras at the given poses; None if these do not determine the scale.

    Returns
    -------
    Views, cameras, and the correction at the size of the stored depth maps; None if depth is not corrected.
    """
    views, cameras = bundle_result.views, bundle_result.cameras
    correction = views[0].depth_correction
    if correction is None:
        return views, cameras, None
    centres = cameras.poses[:, :3, 3]
    scale = None if given is None else estimate_pose_scale(given.poses[:, :3, 3], centres)
    if scale is not None:
        correction = correction.scale_depth(scale)
        middle = centres.mean(axis=0)
        poses, color_from_depth = cameras.poses.copy(), cameras.color_from_depth.copy()
        poses[:, :3, 3] = middle + scale * (centres - middle)
        if bundle_result.is_camera_adjusted:
            color_from_depth[:, :3, 3] *= scale
        cameras = replace(cameras, poses=poses, color_from_depth=color_from_depth)
        views = [replace(view, depth_correction=correction) for view in views]
    return views, cameras, replace(correction, width=frame.camera.width, height=frame.camera.height)


def describe_depth_correction(correction: DepthCorrection | None, agreement: DepthAgreement | None) -> str:
    """Format a clause about the depth correction; empty if no correction was fitted."""
    if agreement is None:
        return ""
    if correction is None:
        return "; depth left as given: a correction does not make frames agree clearly better"
    low, high = correction.compute_range_percent()
    return (
        f"; depth is corrected by {low:.1f} to {high:.1f} %, and overlapping frames agree to "
        f"{agreement.after_mm:.1f} mm instead of {agreement.before_mm:.1f} mm"
    )


def correct_depth(frame: Frame, correction: DepthCorrection) -> Frame:
    """Attach a depth correction to a frame with depth."""
    return frame if frame.depth is None else replace(frame, depth_correction=correction)
