"""Resolution of the crop from the parameters and from sampled frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.frames.posed_depth import DepthLimits, PosedDepth, read_posed_depth
from scanloom.stages.fusion.codes import FUSE_CROP_EMPTY, FUSE_PLANE_UNCERTAIN
from scanloom.stages.fusion.crop import Crop, cropped, shown
from scanloom.stages.fusion.params import FuseParams, Point
from scanloom.stages.fusion.scene import Scene
from scanloom.stages.fusion.support import Support, find_support
from scanloom.stages.fusion.survey import Noise
from scanloom.stages.scans.model.prefetch import read_ahead
from scanloom.stages.scans.model.scan import Frame

# Ratio of points left above the support plane below which a warning is emitted.
_NEARLY_NOTHING = 0.01
# Default plane margin. Depth of the plane itself scatters up to about 3 standard deviations above it. The
# TSDF rounds edges next to the plane over about 1.5 voxels.
_SPREADS, _VOXELS = 3.0, 1.5


@dataclass(frozen=True, eq=False, kw_only=True)
class Kept:
    """Crop resolved to world coordinates.

    Attributes
    ----------
    crop : region to fuse.
    support : support plane that is removed with everything below it; None if no plane is removed.
    views : sampled frames, uncropped, each with at least one point inside the crop.
    """

    crop: Crop
    support: Support | None
    views: tuple[PosedDepth, ...]


def what_is_kept(
    frames: Sequence[Frame],
    looked_at: Sequence[PosedDepth],
    scene: Scene,
    noise: Noise,
    params: FuseParams,
    limits: DepthLimits,
    threads: int,
) -> Kept:
    """Resolve the crop, including the support plane if `remove_plane` is set.

    Emits a warning if a parameter has no effect or no support plane is found.

    Parameters
    ----------
    frames : all frames of the scan.
    looked_at : frames sampled evenly from the scan.
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
                "has no effect without radius or remove_plane", Where(parameter="center")
            )
        )
    if params.plane_margin is not None and not params.remove_plane:
        emit(
            USAGE_OPTIONS_CONFLICT.warning(
                "has no effect without remove_plane", Where(parameter="plane_margin")
            )
        )
    views = _that_show(crop, frames, looked_at, scene, limits, threads)
    kept = Kept(crop=crop, support=None, views=tuple(views))
    return _without_support(kept, scene, noise, params) if params.remove_plane else kept


def _without_support(kept: Kept, scene: Scene, noise: Noise, params: FuseParams) -> Kept:
    views = [cropped(view, kept.crop) for view in kept.views]
    depth = np.concatenate([view.surface.depth[view.surface.depth > 0] for view in views])
    center = np.array(_thing(params, kept.crop, scene))
    found = find_support(views, center, noise.at(float(np.median(depth))))
    if isinstance(found, str):
        emit(
            FUSE_PLANE_UNCERTAIN.warning(
                "remove_plane: no plane is removed, because none was found under the object: {why}",
                remedy="give the position of the object with center, radius or box",
                why=found,
            )
        )
        return kept
    above = above_plane(kept.crop, found, params.plane_margin, 0.0)
    counts = [int(np.count_nonzero(shown(view, above))) for view in views]
    share = sum(counts) / len(depth)
    if share == 0:
        raise UsageError(
            FUSE_CROP_EMPTY,
            "the crop is empty: none of {depth_count:,} sampled points is inside {above}.",
            depth_count=len(depth),
            above=above,
        )
    if share < _NEARLY_NOTHING:
        emit(
            FUSE_PLANE_UNCERTAIN.warning(
                "remove_plane: only {share:.1%} of the points are more than {margin:.2g} m above the plane",
                remedy="if it is not the plane under the object, set center, radius or box to the object",
                share=share,
                margin=above.height - found.offset_m,
            )
        )
    shows = tuple(view for view, count in zip(kept.views, counts, strict=True) if count)
    return Kept(crop=above, support=found, views=shows)


def above_plane(crop: Crop, support: Support, margin: float | None, voxel_size: float) -> Crop:
    """Restrict a crop to the half-space above the support plane.

    Parameters
    ----------
    margin : distance above the plane, metres; None derives it from the plane's spread and the voxel size.
    """
    if margin is None:
        margin = max(_SPREADS * support.spread_m, _VOXELS * voxel_size)
    return replace(crop, normal=support.normal, height=support.offset_m + margin)


def _thing(params: FuseParams, crop: Crop, scene: Scene) -> Point:
    """Return the position of the object on the support plane."""
    if params.center is not None:
        return params.center
    if crop.box is not None:
        x, y, z = ((low + high) / 2 for low, high in zip(crop.box[:3], crop.box[3:], strict=True))
        return x, y, z
    return scene.center_m


def _that_show(
    crop: Crop,
    frames: Sequence[Frame],
    looked_at: Sequence[PosedDepth],
    scene: Scene,
    limits: DepthLimits,
    threads: int,
) -> list[PosedDepth]:
    """Return views with points inside the crop.

    Reads further frames if fewer than half of the sampled views have any.
    """
    views = [view for view in looked_at if shown(view, crop).any()]
    enough = (len(looked_at) + 1) // 2
    if len(views) >= enough:
        return views

    def attempt(frame: Frame) -> PosedDepth | None:
        try:
            return read_posed_depth(frame, limits)
        except InputError:
            return None  # reported by the integration, which reads the frame again

    views, points = [], 0
    for view in read_ahead(attempt, _spread(frames), threads=threads, ahead=threads):
        if view is None:
            continue
        points += int(np.count_nonzero(view.surface.depth))
        if shown(view, crop).any():
            views.append(view)
        if len(views) >= enough:
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


def _spread(frames: Sequence[Frame]) -> list[Frame]:
    """Order frames so that every prefix samples the sequence evenly (bisection order)."""
    halvings = range(len(frames).bit_length())
    return [frames[0]] + [
        frames[i] for k in reversed(halvings) for i in range(1 << k, len(frames), 1 << (k + 1))
    ]
