"""What a fusion keeps of a scan, from what is asked for and what some frames show."""

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

# A plane that leaves less than this share of the points is told.
_NEARLY_NOTHING = 0.01
# Depth counts as that of the plane up to this many times its spread above it, and a surface beside it is
# rounded within so many voxels.
_SPREADS, _VOXELS = 3.0, 1.5


@dataclass(frozen=True, eq=False, kw_only=True)
class Kept:
    """What is kept.

    Attributes
    ----------
    crop : the places that are.
    support : the plane that is left out, with what is below it.
    views : some frames, whole, of which each shows some of what is kept.
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
    """Find out what is kept, above a plane if that is asked for; what cannot be done is emitted.

    Parameters
    ----------
    looked_at : frames at even places of the scan.
    scene : where they lie.
    noise : of their depth.

    Raises
    ------
    UsageError
        If nothing that any frame shows is in the box or the ball.
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
                "remove_plane: nothing is removed, no plane under the thing is found: {why}",
                remedy="center, box or radius say where the thing is",
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
            "nothing is left to fuse: of {depth_count:,} points looked at 0 are inside {above}.",
            depth_count=len(depth),
            above=above,
        )
    if share < _NEARLY_NOTHING:
        emit(
            FUSE_PLANE_UNCERTAIN.warning(
                "remove_plane: only {share:.1%} of the points are more than {margin:.2g} m above the plane",
                remedy="if it is not the one under the thing, say where that is by center, box or radius",
                share=share,
                margin=above.height - found.offset_m,
            )
        )
    shows = tuple(view for view, count in zip(kept.views, counts, strict=True) if count)
    return Kept(crop=above, support=found, views=shows)


def above_plane(crop: Crop, support: Support, margin: float | None, voxel_size: float) -> Crop:
    """Return what of a crop is farther above a plane than a margin, if need be derived from both, metres."""
    if margin is None:
        margin = max(_SPREADS * support.spread_m, _VOXELS * voxel_size)
    return replace(crop, normal=support.normal, height=support.offset_m + margin)


def _thing(params: FuseParams, crop: Crop, scene: Scene) -> Point:
    """Return where the thing is that stands on the plane."""
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
    """Return views that show what is kept; more frames are looked at where too few of those that were do."""
    views = [view for view in looked_at if shown(view, crop).any()]
    enough = (len(looked_at) + 1) // 2
    if len(views) >= enough:
        return views

    def attempt(frame: Frame) -> PosedDepth | None:
        try:
            return read_posed_depth(frame, limits)
        except InputError:
            return None  # fusion tells of it

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
                "nothing is left to fuse: of {points:,} points in {frames_count} frames 0 "
                "are inside {crop}; most lie within {scene} m."
            ),
            points=points,
            frames_count=len(frames),
            crop=crop,
            scene=scene,
        )
    return views


def _spread(frames: Sequence[Frame]) -> list[Frame]:
    """Return the frames in an order whose every beginning is spread evenly over all of them."""
    halvings = range(len(frames).bit_length())
    return [frames[0]] + [
        frames[i] for k in reversed(halvings) for i in range(1 << k, len(frames), 1 << (k + 1))
    ]
