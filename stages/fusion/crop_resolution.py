"""Resolution of the crop from the parameters and from sampled frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.frames.posed_depth import DepthLimits, PosedDepth, read_posed_depth
from scanloom.stages.fusion.codes import FUSE_CROP_EMPTY, FUSE_PLANE_UNCERTAIN
from scanloom.stages.fusion.crop import Crop, crop_depth, mask_pixels_inside
from scanloom.stages.fusion.params import FuseParams, Point
from scanloom.stages.fusion.scene_extent import SceneExtent
from scanloom.stages.fusion.scene_statistics import DepthNoise
from scanloom.stages.fusion.support_plane import SupportPlane, find_support_plane
from scanloom.stages.scans.model.prefetch import map_ordered
from scanloom.stages.scans.model.scan import Frame

# Ratio of points left above the support plane below which a warning is emitted.
_MIN_POINT_RATIO = 0.01
# Default plane margin. Depth of the plane itself scatters up to about 3 standard deviations above it. The
# TSDF rounds edges next to the plane over about 1.5 voxels.
_MARGIN_DEVIATIONS, _MARGIN_VOXELS = 3.0, 1.5


@dataclass(frozen=True, eq=False, kw_only=True)
class ResolvedCrop:
    """Crop resolved to world coordinates.

    Attributes
    ----------
    crop : region to fuse.
    support_plane : support plane that is removed with everything below it; None if no plane is removed.
    views : sampled frames, uncropped, each with at least one point inside the crop.
    """

    crop: Crop
    support_plane: SupportPlane | None
    views: tuple[PosedDepth, ...]


def resolve_crop(
    frames: Sequence[Frame],
    sampled_views: Sequence[PosedDepth],
    scene: SceneExtent,
    noise: DepthNoise,
    params: FuseParams,
    limits: DepthLimits,
    threads: int,
) -> ResolvedCrop:
    """Resolve the crop, including the support plane if `remove_plane` is set.

    Emits a warning if a parameter has no effect or no support plane is found.

    Parameters
    ----------
    frames : all frames of the scan.
    sampled_views : frames sampled evenly from the scan.
    scene : extent and centre of the scan.
    noise : depth noise of the sampled frames.
    params, limits : parameters of the fusion, and limits of the depth to read.
    threads : thread count for reading.

    Raises
    ------
    UsageError
        If no frame has a point inside the box or the ball.
    """
    crop = Crop(box=params.box)
    if params.radius is not None:
        crop = replace(crop, center=params.center or scene.center_m, radius=params.radius)
    elif params.center is not None and not params.remove_plane:
        emit(
            USAGE_OPTIONS_CONFLICT.warning(
                "has no effect without radius or remove_plane", DiagnosticLocation(parameter="center")
            )
        )
    if params.plane_margin is not None and not params.remove_plane:
        emit(
            USAGE_OPTIONS_CONFLICT.warning(
                "has no effect without remove_plane", DiagnosticLocation(parameter="plane_margin")
            )
        )
    views = _select_views_inside(crop, frames, sampled_views, scene, limits, threads)
    kept = ResolvedCrop(crop=crop, support_plane=None, views=tuple(views))
    return _remove_support(kept, scene, noise, params) if params.remove_plane else kept


def _remove_support(
    resolved: ResolvedCrop, scene: SceneExtent, noise: DepthNoise, params: FuseParams
) -> ResolvedCrop:
    views = [crop_depth(view, resolved.crop) for view in resolved.views]
    depth = np.concatenate([view.surface.depth[view.surface.depth > 0] for view in views])
    center = np.array(_locate_object(params, resolved.crop, scene))
    plane = find_support_plane(views, center, noise.compute_deviation(float(np.median(depth))))
    if isinstance(plane, str):
        emit(
            FUSE_PLANE_UNCERTAIN.warning(
                "remove_plane: no plane is removed, because none was found under the object: {why}",
                remedy="give the position of the object with center, radius or box",
                why=plane,
            )
        )
        return resolved
    above = restrict_above_plane(resolved.crop, plane, params.plane_margin, 0.0)
    counts = [int(np.count_nonzero(mask_pixels_inside(view, above))) for view in views]
    ratio = sum(counts) / len(depth)
    if ratio == 0:
        raise UsageError(
            FUSE_CROP_EMPTY,
            "the crop is empty: none of {depth_count:,} sampled points is inside {above}.",
            depth_count=len(depth),
            above=above,
        )
    if ratio < _MIN_POINT_RATIO:
        emit(
            FUSE_PLANE_UNCERTAIN.warning(
                "remove_plane: only {share:.1%} of the points are more than {margin:.2g} m above the plane",
                remedy="if it is not the plane under the object, set center, radius or box to the object",
                share=ratio,
                margin=above.height - plane.offset_m,
            )
        )
    views_above = tuple(view for view, count in zip(resolved.views, counts, strict=True) if count)
    return ResolvedCrop(crop=above, support_plane=plane, views=views_above)


def restrict_above_plane(crop: Crop, support: SupportPlane, margin: float | None, voxel_size: float) -> Crop:
    """Restrict a crop to the half-space above the support plane.

    Parameters
    ----------
    margin : distance above the plane, metres; None derives it from the plane's spread and the voxel size.
    """
    if margin is None:
        margin = max(_MARGIN_DEVIATIONS * support.spread_m, _MARGIN_VOXELS * voxel_size)
    return replace(crop, normal=support.normal, height=support.offset_m + margin)


def _locate_object(params: FuseParams, crop: Crop, scene: SceneExtent) -> Point:
    """Return the position of the object on the support plane."""
    if params.center is not None:
        return params.center
    if crop.box is not None:
        x, y, z = ((low + high) / 2 for low, high in zip(crop.box[:3], crop.box[3:], strict=True))
        return x, y, z
    return scene.center_m


def _select_views_inside(
    crop: Crop,
    frames: Sequence[Frame],
    sampled_views: Sequence[PosedDepth],
    scene: SceneExtent,
    limits: DepthLimits,
    threads: int,
) -> list[PosedDepth]:
    """Return views with points inside the crop.

    Reads further frames if fewer than half of the sampled views have any.
    """
    views = [view for view in sampled_views if mask_pixels_inside(view, crop).any()]
    min_view_count = (len(sampled_views) + 1) // 2
    if len(views) >= min_view_count:
        return views

    def try_read(frame: Frame) -> PosedDepth | None:
        try:
            return read_posed_depth(frame, limits)
        except InputError:
            return None  # reported by the integration, which reads the frame again

    views, points = [], 0
    for view in map_ordered(try_read, _order_by_bisection(frames), threads=threads, max_pending=threads):
        if view is None:
            continue
        points += int(np.count_nonzero(view.surface.depth))
        if mask_pixels_inside(view, crop).any():
            views.append(view)
        if len(views) >= min_view_count:
            break
    if not views:
        raise UsageError(
            FUSE_CROP_EMPTY,
            (
                "the crop is empty: none of {points:,} points in {frames_count} frames is inside "
                "{crop}; most points are within {scene} m."
            ),
            points=points,
            frames_count=len(frames),
            crop=crop,
            scene=scene,
        )
    return views


def _order_by_bisection(frames: Sequence[Frame]) -> list[Frame]:
    """Order frames so that every prefix samples the sequence evenly (bisection order)."""
    halvings = range(len(frames).bit_length())
    return [frames[0]] + [
        frames[i] for k in reversed(halvings) for i in range(1 << k, len(frames), 1 << (k + 1))
    ]
