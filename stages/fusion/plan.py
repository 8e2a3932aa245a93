"""Derive the scale of a fusion from some of its frames: voxel size, truncation, depth range, memory."""

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

# How many places of the scan are looked at, two neighbouring frames at each; fewer when frames are large,
# since all of them are held at once.
_PLACES = 8
_PIXELS = 8_000_000
# With a crop, depth tells of the space before it up to so many times as far as it is fused.
_FREE = 2.0
# Blocks from one place that may be a volume's origin to the next: far enough that a frame more hardly ever
# moves it, near enough for float32.
_ORIGINS = 1024
# Of so many pixels one tells the median depth. Noise that is a smaller share of voxels than this does not
# show.
_EVERY, _SHOWN = 16, 1 / 6
# The share of the depth that may be too far to be fused without a word.
_BEYOND = 0.05
# A derived voxel size aims at no more than this; about 200 bytes of volume for each.
_TRIANGLES = 2_000_000


@dataclass(frozen=True, eq=False, kw_only=True)
class Plan:
    """The parameters of a fusion with nothing left to derive.

    Attributes
    ----------
    voxel_size, truncation : metres; truncation along the surface's normal.
    max_depth : metres; farther surface is not fused.
    limits : of the depth to read; what is farther than `max_depth`, and outside of a crop, tells of the space
        before it alone.
    noise : as measured; see Noise.
    origin : (3,) world coordinates of the volume's own origin, on its grid of blocks.
    weighing : of depth in the volume; at median depth it weighs 1.
    blocks : how many blocks of voxels are expected.
    spread : how many times as far as the frames looked at all frames may be spread.
    triangles : how many triangles are expected, roughly.
    scene : where the scan lies, before anything is left out of it.
    crop : what is fused of it.
    reach : metres; the field is made up to so far outside, so that it is whole at the border.
    support : the plane that is left out, with what is below it.
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
        """Return which pixels (h, w) of a view show surface that is to be in the volume."""
        near = view.surface.depth <= np.float32(self.max_depth)
        return np.asarray(near & shown(view, self.crop, self.reach))

    def local(self, pose: Pose) -> Pose:
        """Return a pose relative to the origin, so that float32 is exact enough wherever the world's is."""
        moved = np.array(pose)
        moved[:3, 3] -= self.origin
        return moved


def make_plan(frames: Sequence[Frame], params: FuseParams, where: Path | None, threads: int) -> Plan:
    """Look at some frames, and derive what `params` leaves open.

    Raises
    ------
    InputError
        If none of the frames looked at can be used.
    UsageError
        If nothing is inside of what is to be fused.
    """
    limits = limits_of(params, alone=len(frames) == 1)
    pairs = look(frames, limits, where, threads)
    looked_at = [view for view, _ in pairs]
    scene = scene_of(frames, looked_at)
    noise = measured_noise(pairs)
    # How exact depth is, all tells that is seen; how large voxels are, what is kept.
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
    # Another frame may see farther than those looked at, hence the half more.
    max_depth = params.max_depth or min(noise.reach(truncation / 3), 1.5 * found.farthest)
    if params.max_depth is None:
        _report_far_depth(params, wanted, found, voxel_size=voxel_size, max_depth=max_depth)
    # Depth is kept in 65535 steps, which a limit far beyond the scene would make coarse.
    max_depth = min(max_depth, 10 * found.farthest)
    crop = kept.crop
    if kept.support is not None:
        crop = above_plane(crop, kept.support, params.plane_margin, voxel_size)
    # What is left out, and too far to be fused, still tells that beside the thing there is nothing.
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
    # Two triangles for each voxel that the surface passes through.
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
    """Warn of depth that is too far to be fused."""
    depth = np.concatenate([view.surface.depth[view.surface.depth > 0][::_EVERY] for view in views])
    share = float(np.mean(depth > max_depth)) if len(depth) else 0.0
    if share <= _BEYOND:
        return
    # Either makes the field as wide as the noise of all but the farthest depth wants it.
    truncation = 3 * found.noise.at(found.far)
    length = (
        f"voxel_size={_two_digits(truncation / 5):g}"
        if params.truncation is None
        else f"truncation={_two_digits(truncation):g}"
    )
    emit(
        FUSE_FAR_DEPTH_LEFT_OUT.warning(
            "{share:.0%} of the depth is beyond {max_depth:.2f} m and not fused: its noise there is more "
            "than voxels of {voxel_size:g} m can take.",
            remedy="fuse.{length} takes in what is up to {far:.2f} m away",
            share=share,
            max_depth=max_depth,
            voxel_size=voxel_size,
            length=length,
            far=found.far,
        )
    )


def _weighing(noise: Noise, views: Sequence[PosedDepth], voxel_size: float) -> Weighing:
    """Weigh by the noise where voxels are small enough to show it.

    In few steps, so that a frame more, or one that cannot be used, leaves the weights of all others as they
    were.
    """
    depth = np.concatenate([view.surface.depth[view.surface.depth > 0][::_EVERY] for view in views])
    median = 2 ** (round(2 * math.log2(float(np.median(depth)))) / 2)
    if noise.at(median) < _SHOWN * voxel_size:
        return Weighing(_SHOWN * voxel_size)
    deviation = 2 ** (round(2 * math.log2(noise.at(median))) / 2)
    return Weighing(deviation, median, round(4 * noise.quadratic * median**2 / noise.at(median)) / 4)


def limits_of(params: FuseParams, *, alone: bool = False) -> DepthLimits:
    """Return what depth is taken at all, before the scene is known."""
    return DepthLimits(
        min_depth=params.min_depth,
        max_depth=params.max_depth or math.inf,
        max_jump=params.max_jump,
        max_angle=params.max_angle or (MAX_ANGLE_ALONE if alone else MAX_ANGLE),
    )


def look(
    frames: Sequence[Frame], limits: DepthLimits, where: Path | None, threads: int
) -> list[tuple[PosedDepth, PosedDepth | None]]:
    """Read frames at even places, each with the one after it; those that cannot be read are left out.

    Raises
    ------
    InputError
        If none of them can be read.
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
            "none of the {results_count} frames looked at can be used. The first: {results}",
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
    """Estimate how many blocks all frames touch from those that some touch.

    The first-order jackknife (Burnham and Overton 1978): what only one view of the sample saw tells how much
    more the unseen frames will bring.
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
    # Room for one frame more, since Open3D asks for room before it looks which blocks are new.
    return len(times) + unseen + max(map(len, touched))


def _spread(frames: Sequence[Frame], looked_at: NDArray[np.float64], reach: float) -> float:
    """Return how many times as many places all cameras stood at as those that were looked at (n, 3)."""

    def places(centers: NDArray[np.float64]) -> int:
        return len(np.unique(np.floor(centers / reach), axis=0))

    poses = [frame.world_from_camera for frame in frames if frame.world_from_camera is not None]
    centers = np.array([pose[:3, 3] for pose in poses], np.float64)
    return max(places(centers[np.isfinite(centers).all(axis=1)]) / places(looked_at), 1.0)


def _two_digits(length: float) -> float:
    """Round up to two digits: a length that people can say."""
    unit = 10.0 ** (math.floor(math.log10(length)) - 1)
    return float(f"{math.ceil(length / unit - 1e-9) * unit:.2g}")
