"""Fusion parameters derived from sampled frames: voxel size, truncation, depth range, memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.posed_depth import (
    MAX_ANGLE_DEG,
    MAX_ANGLE_SINGLE_FRAME_DEG,
    DepthLimits,
    PosedDepth,
    read_posed_depth,
)
from scanloom.stages.fusion.codes import FUSE_FAR_DEPTH_LEFT_OUT
from scanloom.stages.fusion.crop import Crop, crop_depth, mask_pixels_inside
from scanloom.stages.fusion.crop_resolution import resolve_crop, restrict_above_plane
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.fusion.scene_extent import SceneExtent, compute_scene_extent
from scanloom.stages.fusion.scene_statistics import (
    DepthNoise,
    SceneStatistics,
    compute_scene_statistics,
    estimate_noise,
)
from scanloom.stages.fusion.support_plane import SupportPlane
from scanloom.stages.fusion.tsdf_volume import BLOCK_SIDE, DepthNoiseModel, find_touched_blocks
from scanloom.stages.scans.codes import SCAN_TOO_MANY_FRAMES_SKIPPED
from scanloom.stages.scans.model.prefetch import map_ordered
from scanloom.stages.scans.model.scan import Frame, Pose

# Number of sampled positions in the scan, with two neighbouring frames each. All sampled frames are in memory
# at once, so the limit in pixels reduces the count for large frames.
_SAMPLE_COUNT = 8
_MAX_SAMPLED_PIXELS = 8_000_000
# With a crop, depth up to this multiple of the fused range is read to carve free space in front of it.
_FREE_SPACE_FACTOR = 2.0
# Spacing of candidate volume origins, in blocks. Coarse, so that an added frame rarely moves the origin;
# still close enough to the cameras for float32.
_ORIGIN_SPACING_BLOCKS = 1024
# Pixel stride for the median depth. Noise below this ratio of the voxel size has no visible effect.
_PIXEL_STRIDE, _VISIBLE_NOISE_RATIO = 16, 1 / 6
# Ratio of depth pixels beyond the maximum depth above which a warning is emitted.
_MAX_FAR_RATIO = 0.05
# Maximum triangle count that a derived voxel size aims at; the volume needs about 200 bytes per triangle.
_MAX_TRIANGLES = 2_000_000


@dataclass(frozen=True, eq=False, kw_only=True)
class FusionPlan:
    """Parameters of a fusion with all derived values resolved.

    Attributes
    ----------
    voxel_size, truncation : metres; truncation along the surface normal.
    max_depth : metres; farther surface is not fused.
    limits : limits of the depth to read. Depth beyond `max_depth` or outside the crop only carves free space.
    noise : measured depth noise.
    origin : (3,) world coordinates of the volume origin, on the block grid.
    noise_model : noise model that weights depth in the volume; the weight is 1 at median depth.
    block_count : expected number of blocks.
    position_ratio : ratio of the camera positions of all frames to the sampled camera positions.
    triangle_count : expected number of triangles, a rough estimate.
    scene : extent of the scan before cropping.
    crop : region to fuse.
    crop_margin : metres; the volume extends this far outside the crop, so that it is complete at the
        boundary.
    support_plane : support plane that is removed with everything below it; None if no plane is removed.
    """

    voxel_size: float
    truncation: float
    max_depth: float
    limits: DepthLimits
    noise: DepthNoise
    origin: NDArray[np.float64]
    scene: SceneExtent
    crop: Crop
    crop_margin: float
    support_plane: SupportPlane | None
    noise_model: DepthNoiseModel
    block_count: int = 0
    position_ratio: float = 1.0
    triangle_count: int = 0

    def mask_fused_pixels(self, view: PosedDepth) -> NDArray[np.bool_]:
        """Return a mask (h, w) of the pixels that are fused."""
        near = view.surface.depth <= np.float32(self.max_depth)
        return np.asarray(near & mask_pixels_inside(view, self.crop, self.crop_margin))

    def to_local_pose(self, pose: Pose) -> Pose:
        """Return a pose relative to the volume origin.

        Coordinates relative to it are precise enough in float32.
        """
        moved = np.array(pose)
        moved[:3, 3] -= self.origin
        return moved


def make_plan(frames: Sequence[Frame], params: FuseParams, folder: Path | None, threads: int) -> FusionPlan:
    """Sample frames and derive the parameters that `params` leaves unset.

    Raises
    ------
    InputError
        If no sampled frame can be used.
    UsageError
        If the crop contains no points.
    """
    limits = make_depth_limits(params, is_single_frame=len(frames) == 1)
    pairs = sample_depth_frames(frames, limits, folder, threads)
    sampled_views = [view for view, _ in pairs]
    scene = compute_scene_extent(frames, sampled_views)
    noise = estimate_noise(pairs)
    # Noise is estimated from all sampled depth, the voxel size only from depth inside the crop.
    resolved = resolve_crop(frames, sampled_views, scene, noise, params, limits, threads)
    cropped_views = [crop_depth(view, resolved.crop) for view in resolved.views]
    statistics = compute_scene_statistics(cropped_views, noise)
    voxel_size = params.voxel_size or _round_up_two_digits(
        params.voxel_factor
        * max(
            2 * statistics.pixel_spacing,
            2 * noise.compute_deviation(statistics.median_depth),
            math.sqrt(2 * statistics.area / _MAX_TRIANGLES),
        )
    )
    truncation = params.truncation or max(
        3 * voxel_size,
        3 * noise.compute_deviation(statistics.median_depth),
        min(3 * noise.compute_deviation(statistics.far_depth), 5 * voxel_size),
    )
    # Unsampled frames may see farther than the sampled ones, hence the factor 1.5.
    max_depth = params.max_depth or min(noise.find_depth_limit(truncation / 3), 1.5 * statistics.max_depth)
    if params.max_depth is None:
        _report_far_depth(params, cropped_views, statistics, voxel_size=voxel_size, max_depth=max_depth)
    # Depth is quantised to 65535 steps; a limit far beyond the scene would make the steps coarse.
    max_depth = min(max_depth, 10 * statistics.max_depth)
    crop = resolved.crop
    if resolved.support_plane is not None:
        crop = restrict_above_plane(crop, resolved.support_plane, params.plane_margin, voxel_size)
    # Depth outside the crop and beyond `max_depth` still carves the free space around the object.
    max_read_depth = _FREE_SPACE_FACTOR * max_depth if crop and not params.max_depth else max_depth
    centers = np.stack([view.pose[:3, 3] for view in sampled_views])
    grid = _ORIGIN_SPACING_BLOCKS * BLOCK_SIDE * voxel_size
    plan = FusionPlan(
        voxel_size=voxel_size,
        truncation=truncation,
        max_depth=max_depth,
        limits=replace(limits, max_depth=max_read_depth),
        noise=noise,
        origin=np.rint(np.median(centers, axis=0) / grid) * grid,
        scene=scene,
        crop=crop,
        crop_margin=truncation + voxel_size,
        support_plane=resolved.support_plane,
        noise_model=_derive_noise_model(noise, sampled_views, voxel_size),
    )
    # About two triangles per voxel that the surface passes through.
    triangles = round(2 * statistics.area / voxel_size**2)
    return replace(
        plan,
        block_count=_estimate_block_count(resolved.views, plan, len(frames)),
        position_ratio=_compute_position_ratio(frames, centers, statistics.median_depth),
        triangle_count=triangles,
    )


def _report_far_depth(
    params: FuseParams,
    views: Sequence[PosedDepth],
    statistics: SceneStatistics,
    *,
    voxel_size: float,
    max_depth: float,
) -> None:
    """Warn if much of the depth is too far to be fused."""
    depth = np.concatenate([view.surface.depth[view.surface.depth > 0][::_PIXEL_STRIDE] for view in views])
    far_ratio = float(np.mean(depth > max_depth)) if len(depth) else 0.0
    if far_ratio <= _MAX_FAR_RATIO:
        return
    # Either parameter widens the truncation to 3 standard deviations at the 98 % depth quantile.
    truncation = 3 * statistics.noise.compute_deviation(statistics.far_depth)
    advice = (
        f"voxel_size={_round_up_two_digits(truncation / 5):g}"
        if params.truncation is None
        else f"truncation={_round_up_two_digits(truncation):g}"
    )
    emit(
        FUSE_FAR_DEPTH_LEFT_OUT.warning(
            "{share:.0%} of the depth lies beyond {max_depth:.2f} m and is ignored, because its noise is "
            "too high for voxels of {voxel_size:g} m.",
            remedy="fuse.{length} includes depth up to {far:.2f} m",
            share=far_ratio,
            max_depth=max_depth,
            voxel_size=voxel_size,
            length=advice,
            far=statistics.far_depth,
        )
    )


def _derive_noise_model(noise: DepthNoise, views: Sequence[PosedDepth], voxel_size: float) -> DepthNoiseModel:
    """Derive the depth weights from the noise.

    Weights are constant if voxels are too large to show the noise. Values are rounded to coarse steps, so
    that an added or skipped frame does not change the weights of all other frames.
    """
    depth = np.concatenate([view.surface.depth[view.surface.depth > 0][::_PIXEL_STRIDE] for view in views])
    median = 2 ** (round(2 * math.log2(float(np.median(depth)))) / 2)
    if noise.compute_deviation(median) < _VISIBLE_NOISE_RATIO * voxel_size:
        return DepthNoiseModel(_VISIBLE_NOISE_RATIO * voxel_size)
    deviation = 2 ** (round(2 * math.log2(noise.compute_deviation(median))) / 2)
    return DepthNoiseModel(
        deviation, median, round(4 * noise.quadratic * median**2 / noise.compute_deviation(median)) / 4
    )


def make_depth_limits(params: FuseParams, *, is_single_frame: bool = False) -> DepthLimits:
    """Return the limits of valid depth before the scene is known."""
    return DepthLimits(
        min_depth=params.min_depth,
        max_depth=params.max_depth or math.inf,
        max_jump=params.max_jump,
        max_angle=params.max_angle or (MAX_ANGLE_SINGLE_FRAME_DEG if is_single_frame else MAX_ANGLE_DEG),
    )


def sample_depth_frames(
    frames: Sequence[Frame], limits: DepthLimits, folder: Path | None, threads: int
) -> list[tuple[PosedDepth, PosedDepth | None]]:
    """Read frames sampled evenly from the scan, each with its successor.

    Unreadable frames are omitted.

    Returns
    -------
    Pairs of a view and its successor, None for an unreadable or absent successor.

    Raises
    ------
    InputError
        If no sampled frame can be read.
    """
    camera = frames[0].camera
    sample_count = min(max(_MAX_SAMPLED_PIXELS // (camera.width * camera.height), 2), _SAMPLE_COUNT)
    first_indices = np.unique(np.linspace(0, max(len(frames) - 2, 0), sample_count).astype(int))
    indices = sorted({i for i in (*first_indices, *(first_indices + 1)) if i < len(frames)})
    results_in_order = map_ordered(
        partial(_try_read, limits=limits), [frames[i] for i in indices], threads=threads, max_pending=threads
    )
    results = dict(zip(indices, results_in_order, strict=True))
    views = {i: result for i, result in results.items() if isinstance(result, PosedDepth)}
    if not views:
        raise InputError(
            SCAN_TOO_MANY_FRAMES_SKIPPED,
            "none of {results_count} sampled frames can be used. First error: {results}",
            folder,
            results_count=len(results),
            results=results[indices[0]],
        )
    pairs: list[tuple[PosedDepth, PosedDepth | None]] = [
        (views[i], views.get(i + 1)) for i in first_indices if i in views
    ]
    return pairs or [(view, None) for view in views.values()]


def _try_read(frame: Frame, limits: DepthLimits) -> PosedDepth | InputError:
    try:
        return read_posed_depth(frame, limits)
    except InputError as error:
        return error


def _estimate_block_count(views: Sequence[PosedDepth], plan: FusionPlan, frame_count: int) -> int:
    """Estimate the number of blocks that all frames touch.

    Uses the first-order jackknife (Burnham and Overton 1978): blocks touched by a single sampled view predict
    the number of blocks that only unsampled frames touch.
    """
    touched = [
        find_touched_blocks(
            view,
            plan.mask_fused_pixels(view),
            plan.to_local_pose(view.pose),
            voxel_size=plan.voxel_size,
            truncation=plan.truncation,
        )
        for view in views
    ]
    if not any(map(len, touched)):
        return 1
    _, times = np.unique(np.concatenate(touched), return_counts=True)
    unseen = 0 if frame_count == len(views) else int((times == 1).sum()) * (len(views) - 1) // len(views)
    # Capacity for one more frame, because Open3D reserves before it checks which blocks are new.
    return len(times) + unseen + max(map(len, touched))


def _compute_position_ratio(
    frames: Sequence[Frame], sampled_centers: NDArray[np.float64], cell_size: float
) -> float:
    """Return the ratio of camera positions of all frames to sampled ones.

    Positions are counted in grid cells of size `crop_margin`, metres. `sampled_centers` has the sampled
    positions (n, 3).
    """

    def count_cells(centers: NDArray[np.float64]) -> int:
        return len(np.unique(np.floor(centers / cell_size), axis=0))

    poses = [frame.world_from_camera for frame in frames if frame.world_from_camera is not None]
    centers = np.array([pose[:3, 3] for pose in poses], np.float64)
    return max(count_cells(centers[np.isfinite(centers).all(axis=1)]) / count_cells(sampled_centers), 1.0)


def _round_up_two_digits(length: float) -> float:
    """Round a length up to two significant digits."""
    unit = 10.0 ** (math.floor(math.log10(length)) - 1)
    return float(f"{math.ceil(length / unit - 1e-9) * unit:.2g}")
