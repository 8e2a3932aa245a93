"""Derive the scale of a fusion from some of its frames: voxel size, truncation, depth range, memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError
from stages.fusion.params import FuseParams
from stages.fusion.posed_depth import DepthLimits, PosedDepth, read_posed_depth
from stages.fusion.survey import Noise, survey
from stages.fusion.voxels import BLOCK, Layer, block_keys, layers
from stages.scans.prefetch import read_ahead
from stages.scans.scan import Frame, Pose

# How many places of the scan are looked at, two neighbouring frames at each; fewer when frames are large,
# since all of them are held at once.
_PLACES = 8
_PIXELS = 8_000_000
# A derived voxel size aims at no more than this; about 200 bytes of volume for each.
_TRIANGLES = 2_000_000


@dataclass(frozen=True, eq=False, kw_only=True)
class Plan:
    """The parameters of a fusion with nothing left to derive.

    Attributes
    ----------
    voxel_size, truncation : metres; truncation along the surface's normal.
    limits : of the depth to use.
    noise : as measured; see Noise.
    origin : (3,) world coordinates of the volume's own origin, on its grid of blocks.
    blocks : how many blocks of voxels are expected.
    triangles : how many triangles are expected, roughly.
    """

    voxel_size: float
    truncation: float
    limits: DepthLimits
    noise: Noise
    origin: NDArray[np.float64]
    blocks: int = 0
    triangles: int = 0

    def layers(self, view: PosedDepth) -> list[Layer]:
        """Split a view's depth map for the volume."""
        return layers(
            view, voxel_size=self.voxel_size, truncation=self.truncation, max_depth=self.limits.max_depth
        )

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
    """
    limits = limits_of(params)
    pairs = look(frames, limits, where, threads)
    found = survey(pairs)
    noise = found.noise
    voxel_size = params.voxel_size or _two_digits(
        params.voxel_factor
        * max(2 * found.spacing, 2 * noise.at(found.median), math.sqrt(2 * found.area / _TRIANGLES))
    )
    truncation = params.truncation or max(
        3 * voxel_size, 3 * noise.at(found.median), min(3 * noise.at(found.far), 5 * voxel_size)
    )
    # Another frame may see farther than those looked at, hence the half more.
    max_depth = params.max_depth or min(noise.reach(truncation / 3), 1.5 * found.farthest)
    # Depth is kept in 65535 steps, which a limit far beyond the scene would make coarse.
    max_depth = min(max_depth, 10 * found.farthest)
    centers = np.stack([view.pose[:3, 3] for view, _ in pairs])
    block = BLOCK * voxel_size
    plan = Plan(
        voxel_size=voxel_size,
        truncation=truncation,
        limits=replace(limits, max_depth=max_depth),
        noise=noise,
        origin=np.rint(np.median(centers, axis=0) / block) * block,
    )
    views = [view for view, _ in pairs]
    # Two triangles for each voxel that the surface passes through.
    triangles = round(2 * found.area / voxel_size**2)
    return replace(plan, blocks=_expected_blocks(views, plan, len(frames)), triangles=triangles)


def limits_of(params: FuseParams) -> DepthLimits:
    """Return what depth is taken at all, before the scene is known."""
    return DepthLimits(
        min_depth=params.min_depth,
        max_depth=params.max_depth or math.inf,
        max_jump=params.max_jump,
        max_angle=params.max_angle,
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
            f"none of the {len(results)} frames looked at can be used. The first: {results[wanted[0]]}", where
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
    touched = []
    for view in views:
        parts = plan.layers(view)
        if parts:
            touched.append(block_keys(parts, plan.voxel_size, plan.local(view.pose)))
    if not touched:
        return 1
    _, times = np.unique(np.concatenate(touched), return_counts=True)
    unseen = 0 if frames == len(views) else int((times == 1).sum()) * (len(views) - 1) // len(views)
    # Room for one frame more, since Open3D asks for room before it looks which blocks are new.
    return len(times) + unseen + max(map(len, touched))


def _two_digits(length: float) -> float:
    """Round up to two digits: a length that people can say."""
    unit = 10.0 ** (math.floor(math.log10(length)) - 1)
    return float(f"{math.ceil(length / unit - 1e-9) * unit:.2g}")
