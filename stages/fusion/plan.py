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
    MAX_ANGLE,
    MAX_ANGLE_ALONE,
    DepthLimits,
    PosedDepth,
    read_posed_depth,
)
from scanloom.stages.fusion.codes import FUSE_FAR_DEPTH_LEFT_OUT
from scanloom.stages.fusion.crop import Crop, cropped, shown
from scanloom.stages.fusion.cropping import above_plane, what_is_kept
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.fusion.scene import Scene, scene_of
from scanloom.stages.fusion.support import Support
from scanloom.stages.fusion.survey import Noise, Survey, measured_noise, survey
from scanloom.stages.fusion.voxels import BLOCK, Weighing, touched_blocks
from scanloom.stages.scans.codes import SCAN_TOO_MANY_FRAMES_SKIPPED
from scanloom.stages.scans.model.prefetch import read_ahead
from scanloom.stages.scans.model.scan import Frame, Pose

# Number of sampled positions in the scan, with two neighbouring frames each. All sampled frames are in memory
# at once, so the limit in pixels reduces the count for large frames.
_PLACES = 8
_PIXELS = 8_000_000
# With a crop, depth up to this multiple of the fused range is read to carve free space in front of it.
_FREE = 2.0
# Spacing of candidate volume origins, in blocks. Coarse, so that an added frame rarely moves the origin;
# still close enough to the cameras for float32.
_ORIGINS = 1024
# Pixel stride for the median depth. Noise below this ratio of the voxel size has no visible effect.
_EVERY, _SHOWN = 16, 1 / 6
# Ratio of depth pixels beyond the maximum depth above which a warning is emitted.
_BEYOND = 0.05
# Maximum triangle count that a derived voxel size aims at; the volume needs about 200 bytes per triangle.
_TRIANGLES = 2_000_000


@dataclass(frozen=True, eq=False, kw_only=True)
class Plan:
    """Parameters of a fusion with all derived values resolved.

    Attributes
    ----------
    voxel_size, truncation : metres; truncation along the surface normal.
    max_depth : metres; farther surface is not fused.
    limits : limits of the depth to read. Depth beyond `max_depth` or outside the crop only carves free space.
    noise : measured depth noise.
    origin : (3,) world coordinates of the volume origin, on the block grid.
    weighing : noise model that weights depth in the volume; the weight is 1 at median depth.
    blocks : expected number of blocks.
    spread : ratio of the camera positions of all frames to the sampled camera positions.
    triangles : expected number of triangles, a rough estimate.
    scene : extent of the scan before cropping.
    crop : region to fuse.
    reach : metres; the volume extends this far outside the crop, so that it is complete at the boundary.
    support : support plane that is removed with everything below it; None if no plane is removed.
    """

    voxel_size: float
    truncation: float
    max_depth: float
    limits: DepthLimits
    noise: Noise
    origin: NDArray[np.float64]
    scene: Scene
    crop: Crop
    reach: float
    support: Support | None
    weighing: Weighing
    blocks: int = 0
    spread: float = 1.0
    triangles: int = 0

    def fused(self, view: PosedDepth) -> NDArray[np.bool_]:
        """Return a mask (h, w) of the pixels that are fused."""
        near = view.surface.depth <= np.float32(self.max_depth)
        return np.asarray(near & shown(view, self.crop, self.reach))

    def local(self, pose: Pose) -> Pose:
        """Return a pose relative to the volume origin.

        Coordinates relative to it are precise enough in float32.
        """
        moved = np.array(pose)
        moved[:3, 3] -= self.origin
        return moved


def make_plan(frames: Sequence[Frame], params: FuseParams, where: Path | None, threads: int) -> Plan:
    """Sample frames and derive the parameters that `params` leaves unset.

    Raises
    ------
    InputError
        If no sampled frame can be used.
    UsageError
        If the crop contains no points.
    """
    limits = limits_of(params, alone=len(frames) == 1)
    pairs = look(frames, limits, where, threads)
    looked_at = [view for view, _ in pairs]
    scene = scene_of(frames, looked_at)
    noise = measured_noise(pairs)
    # Noise is estimated from all sampled depth, the voxel size only from depth inside the crop.
    kept = what_is_kept(frames, looked_at, scene, noise, params, limits, threads)
    wanted = [cropped(view, kept.crop) for view in kept.views]
    found = survey(wanted, noise)
    voxel_size = params.voxel_size or _two_digits(
        params.voxel_factor
        * max(2 * found.spacing, 2 * noise.at(found.median), math.sqrt(2 * found.area / _TRIANGLES))
    )
    truncation = params.truncation or max(
        3 * voxel_size,
        3 * noise.at(found.median),
        min(3 * noise.at(found.far), 5 * voxel_size),
    )
    # Unsampled frames may see farther than the sampled ones, hence the factor 1.5.
    max_depth = params.max_depth or min(noise.reach(truncation / 3), 1.5 * found.farthest)
    if params.max_depth is None:
        _report_far_depth(params, wanted, found, voxel_size=voxel_size, max_depth=max_depth)
    # Depth is quantised to 65535 steps; a limit far beyond the scene would make the steps coarse.
    max_depth = min(max_depth, 10 * found.farthest)
    crop = kept.crop
    if kept.support is not None:
        crop = above_plane(crop, kept.support, params.plane_margin, voxel_size)
    # Depth outside the crop and beyond `max_depth` still carves the free space around the object.
    read_to = _FREE * max_depth if crop and not params.max_depth else max_depth
    centers = np.stack([view.pose[:3, 3] for view in looked_at])
    grid = _ORIGINS * BLOCK * voxel_size
    plan = Plan(
        voxel_size=voxel_size,
        truncation=truncation,
        max_depth=max_depth,
        limits=replace(limits, max_depth=read_to),
        noise=noise,
        origin=np.rint(np.median(centers, axis=0) / grid) * grid,
        scene=scene,
        crop=crop,
        reach=truncation + voxel_size,
        support=kept.support,
        weighing=_weighing(noise, looked_at, voxel_size),
    )
    # About two triangles per voxel that the surface passes through.
    triangles = round(2 * found.area / voxel_size**2)
    return replace(
        plan,
        blocks=_expected_blocks(kept.views, plan, len(frames)),
        spread=_spread(frames, centers, found.median),
        triangles=triangles,
    )


def _report_far_depth(
    params: FuseParams, views: Sequence[PosedDepth], found: Survey, *, voxel_size: float, max_depth: float
) -> None:
    """Warn if much of the depth is too far to be fused."""
    depth = np.concatenate([view.surface.depth[view.surface.depth > 0][::_EVERY] for view in views])
    share = float(np.mean(depth > max_depth)) if len(depth) else 0.0
    if share <= _BEYOND:
        return
    # Either parameter widens the truncation to 3 standard deviations at the 98 % depth quantile.
    truncation = 3 * found.noise.at(found.far)
    length = (
        f"voxel_size={_two_digits(truncation / 5):g}"
        if params.truncation is None
        else f"truncation={_two_digits(truncation):g}"
    )
    emit(
        FUSE_FAR_DEPTH_LEFT_OUT.warning(
            "{share:.0%} of the depth lies beyond {max_depth:.2f} m and is ignored, because its noise is "
            "too high for voxels of {voxel_size:g} m.",
            remedy="fuse.{length} includes depth up to {far:.2f} m",
            share=share,
            max_depth=max_depth,
            voxel_size=voxel_size,
            length=length,
            far=found.far,
        )
    )


def _weighing(noise: Noise, views: Sequence[PosedDepth], voxel_size: float) -> Weighing:
    """Derive the depth weights from the noise.

    Weights are constant if voxels are too large to show the noise. Values are rounded to coarse steps, so
    that an added or skipped frame does not change the weights of all other frames.
    """
    depth = np.concatenate([view.surface.depth[view.surface.depth > 0][::_EVERY] for view in views])
    median = 2 ** (round(2 * math.log2(float(np.median(depth)))) / 2)
    if noise.at(median) < _SHOWN * voxel_size:
        return Weighing(_SHOWN * voxel_size)
    deviation = 2 ** (round(2 * math.log2(noise.at(median))) / 2)
    return Weighing(deviation, median, round(4 * noise.quadratic * median**2 / noise.at(median)) / 4)


def limits_of(params: FuseParams, *, alone: bool = False) -> DepthLimits:
    """Return the limits of valid depth before the scene is known."""
    return DepthLimits(
        min_depth=params.min_depth,
        max_depth=params.max_depth or math.inf,
        max_jump=params.max_jump,
        max_angle=params.max_angle or (MAX_ANGLE_ALONE if alone else MAX_ANGLE),
    )


def look(
    frames: Sequence[Frame], limits: DepthLimits, where: Path | None, threads: int
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
    places = min(max(_PIXELS // (camera.width * camera.height), 2), _PLACES)
    first = np.unique(np.linspace(0, max(len(frames) - 2, 0), places).astype(int))
    wanted = sorted({i for i in (*first, *(first + 1)) if i < len(frames)})
    attempts = read_ahead(
        partial(_attempt, limits=limits), [frames[i] for i in wanted], threads=threads, ahead=threads
    )
    results = dict(zip(wanted, attempts, strict=True))
    views = {i: result for i, result in results.items() if isinstance(result, PosedDepth)}
    if not views:
        raise InputError(
            SCAN_TOO_MANY_FRAMES_SKIPPED,
            "none of {results_count} sampled frames can be used. First error: {results}",
            where,
            results_count=len(results),
            results=results[wanted[0]],
        )
    pairs: list[tuple[PosedDepth, PosedDepth | None]] = [
        (views[i], views.get(i + 1)) for i in first if i in views
    ]
    return pairs or [(view, None) for view in views.values()]


def _attempt(frame: Frame, limits: DepthLimits) -> PosedDepth | InputError:
    try:
        return read_posed_depth(frame, limits)
    except InputError as error:
        return error


def _expected_blocks(views: Sequence[PosedDepth], plan: Plan, frames: int) -> int:
    """Estimate the number of blocks that all frames touch.

    Uses the first-order jackknife (Burnham and Overton 1978): blocks touched by a single sampled view predict
    the number of blocks that only unsampled frames touch.
    """
    touched = [
        touched_blocks(
            view,
            plan.fused(view),
            plan.local(view.pose),
            voxel_size=plan.voxel_size,
            truncation=plan.truncation,
        )
        for view in views
    ]
    if not any(map(len, touched)):
        return 1
    _, times = np.unique(np.concatenate(touched), return_counts=True)
    unseen = 0 if frames == len(views) else int((times == 1).sum()) * (len(views) - 1) // len(views)
    # Capacity for one more frame, because Open3D reserves before it checks which blocks are new.
    return len(times) + unseen + max(map(len, touched))


def _spread(frames: Sequence[Frame], looked_at: NDArray[np.float64], reach: float) -> float:
    """Return the ratio of camera positions of all frames to sampled ones.

    Positions are counted in grid cells of size `reach`, metres. `looked_at` has the sampled positions (n, 3).
    """

    def places(centers: NDArray[np.float64]) -> int:
        return len(np.unique(np.floor(centers / reach), axis=0))

    poses = [frame.world_from_camera for frame in frames if frame.world_from_camera is not None]
    centers = np.array([pose[:3, 3] for pose in poses], np.float64)
    return max(places(centers[np.isfinite(centers).all(axis=1)]) / places(looked_at), 1.0)


def _two_digits(length: float) -> float:
    """Round a length up to two significant digits."""
    unit = 10.0 ** (math.floor(math.log10(length)) - 1)
    return float(f"{math.ceil(length / unit - 1e-9) * unit:.2g}")
