"""Integration of frames into a TSDF volume.

Frames are read and filtered in threads, a few ahead of the integration, which is sequential.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._open3d import open3d
from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID, USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.frames.matching_color import read_matching_color
from scanloom.stages.frames.posed_depth import PosedDepth, read_posed_depth
from scanloom.stages.fusion.codes import FUSE_DEVICE_MISSING, FUSE_NO_SURFACE
from scanloom.stages.fusion.crop import Crop
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.fusion.plan import Plan, make_plan
from scanloom.stages.fusion.relief import evened_alone
from scanloom.stages.fusion.upsampling import upsampled_alone, upsampled_frame
from scanloom.stages.fusion.voxels import Box, Field, Keys, Volume, touched_blocks
from scanloom.stages.progress import Progress
from scanloom.stages.scans.codes import POSE_MISSING, SCAN_TOO_MANY_FRAMES_SKIPPED
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.scans.model.scan import ColorImage, Frame, Pose, Scan, SkippedFrame


@dataclass(frozen=True, eq=False)
class Work:
    """Frames and resolved parameters of a fusion.

    Attributes
    ----------
    frames : all frames of the scan, with denoised or upsampled depth if there is a single frame.
    params, plan : parameters as given, and the plan with every derived value.
    color : whether voxels store colour.
    factor : upsampling factor of the depth maps; 1 if they are not upsampled.
    threads : thread count for reading and integration.
    where : folder of the scan, for messages.
    """

    frames: list[Frame]
    params: FuseParams
    plan: Plan
    color: bool
    factor: int
    threads: int
    where: Path | None


@dataclass(frozen=True)
class Tally:
    """Pixel counts of one frame.

    Attributes
    ----------
    pixels : all pixels.
    valid : pixels with valid depth.
    used : pixels that are fused.
    """

    pixels: int
    valid: int
    used: int


Outcome: TypeAlias = Tally | SkippedFrame


@dataclass(frozen=True, eq=False)
class Prepared:
    """Frame ready for integration.

    Attributes
    ----------
    view : filtered depth and pose.
    used : number of pixels that are fused.
    parts : volume-specific input, as returned by `Field.prepared`: touched blocks or depth layers.
    color : (h, w, 3) uint8 at the size of the depth map; None without colour.
    """

    view: PosedDepth
    used: int
    parts: Any
    color: ColorImage | None


def begun(scan: Scan | Iterable[Frame], params: FuseParams) -> Work:
    """Sample some frames and derive the parameters left unset.

    Raises
    ------
    InputError
        If there are no frames, or no frame has a pose or a depth map.
    UsageError
        If the crop contains no points.
    """
    frames = list(scan.frames if isinstance(scan, Scan) else scan)
    where = scan.folder if isinstance(scan, Scan) else None
    _require_usable(frames, where)
    measured = evened_alone(frames, params.max_jump)
    frames = list(upsampled_alone(measured, params))
    is_larger = params.upsample == "guided" or frames[0] is not measured[0]
    threads = workers()
    return Work(
        frames,
        params,
        make_plan(frames, params, where, threads),
        color=params.color and any(frame.color is not None for frame in frames),
        factor=params.upsample_factor if is_larger else 1,
        threads=threads,
        where=where,
    )


def own_volume(work: Work, within: Box | None = None) -> Volume:
    """Create an empty TSDF volume.

    Parameters
    ----------
    within : limits the volume to a box of blocks; None for no limit.
    """
    return Volume(
        work.plan.voxel_size,
        work.plan.truncation,
        work.plan.weighing,
        color=work.color,
        max_bytes=work.params.memory * 1e6,
        threads=work.threads,
        within=within,
    )


def add_frames(work: Work, volume: Field, frames: Sequence[Frame], progress: Progress) -> list[Outcome]:
    """Integrate frames into a volume in the given order.

    Returns
    -------
    One outcome per frame: its pixel counts, or the reason why the frame was skipped.

    Raises
    ------
    InputError
        If more than `max_bad_share` of all frames cannot be used.
    StageError
        If the volume exceeds its memory limit.
    """

    def add(_number: int, item: Prepared) -> None:
        # Frames without touched blocks add nothing.
        volume.integrate(item.view, item.parts, work.plan.local(item.view.pose), item.color)

    return _each(work, frames, volume.prepared, add, progress, color=work.color)


def look_through(work: Work, seen: Callable[[int, Keys], object], progress: Progress) -> list[Outcome]:
    """Find the blocks that each frame touches, without reading colour images.

    Parameters
    ----------
    seen : called with the index of each frame and the keys of its blocks, in order.

    Returns
    -------
    One outcome per frame, as `add_frames`.

    Raises
    ------
    InputError
        If more than `max_bad_share` of the frames cannot be used.
    """
    plan = work.plan

    def touched(view: PosedDepth, here: NDArray[np.bool_], pose: Pose) -> Keys:
        return touched_blocks(view, here, pose, voxel_size=plan.voxel_size, truncation=plan.truncation)

    def look(number: int, item: Prepared) -> None:
        seen(number, item.parts)

    return _each(work, work.frames, touched, look, progress, color=False)


def _each(
    work: Work,
    frames: Sequence[Frame],
    parts_of: Callable[[PosedDepth, NDArray[np.bool_], Pose], Any],
    take: Callable[[int, Prepared], object],
    progress: Progress,
    *,
    color: bool,
) -> list[Outcome]:
    plan, params = work.plan, work.params

    def prepare(frame: Frame) -> Prepared | SkippedFrame:
        try:
            larger = upsampled_frame(frame, params) if params.upsample == "guided" else frame
            view = read_posed_depth(larger, plan.limits)
            here = plan.fused(view)
            image = read_matching_color(larger, view.surface.depth) if color and here.any() else None
        except InputError as error:
            return SkippedFrame(frame.name, error.diagnostic.within(frame=None))
        used = int(np.count_nonzero(here))
        return Prepared(view, used, parts_of(view, here, plan.local(view.pose)), image)

    outcomes: list[Outcome] = []
    ahead = work.threads + 2
    for number, item in enumerate(read_ahead(prepare, frames, threads=work.threads, ahead=ahead)):
        if isinstance(item, SkippedFrame):
            outcomes.append(item)
            require_share(work, outcomes)
        else:
            take(number, item)
            outcomes.append(Tally(item.view.surface.depth.size, item.view.valid, item.used))
        progress(number + 1, len(frames))
    return outcomes


def facts_of(
    work: Work, outcomes: Sequence[Outcome], min_weight: int, volume_bytes: int, device: str
) -> dict[str, Any]:
    """Return the fields of `Facts` as keyword arguments. `outcomes` has one entry per frame of the scan."""
    plan = work.plan
    read = [one for one in outcomes if isinstance(one, Tally)]
    pixels, valid, used = (sum(getattr(one, name) for one in read) for name in ("pixels", "valid", "used"))
    return {
        "voxel_size": plan.voxel_size,
        "truncation": plan.truncation,
        "max_depth": plan.max_depth,
        "min_weight": min_weight,
        "noise": plan.noise,
        "frames": sum(one.used > 0 for one in read),
        "skipped": tuple(one for one in outcomes if isinstance(one, SkippedFrame)),
        "pixels_valid": valid / pixels,
        "pixels_used": used / pixels,
        "volume_bytes": volume_bytes,
        "device": device,
        "crop": plan.crop,
        "support": plan.support,
        "outside": sum(one.used == 0 for one in read),
        "upsampled": work.factor,
    }


def least_weight(typical: float, frames: Sequence[Frame]) -> int:
    """Derive the minimum observation count from the median observation count.

    The result is half the median of the voxels near the surface, within 1 to 3 frames.
    """
    least = int(np.clip(round(typical / 2), 1, 3))
    # Few frames observe each side of a masked turntable object. All frames observe the plate below it, which
    # dominates the median.
    is_masked = all(frame.mask is not None for frame in frames)
    return min(least, max(len(frames) // 4, 1)) if is_masked else least


def nothing_fused(work: Work, outcomes: Sequence[Outcome], min_weight: int) -> InputError:
    """Build the error for a fusion whose mesh has no triangles."""
    used = [one.used for one in outcomes if isinstance(one, Tally) and one.used]
    return InputError(
        FUSE_NO_SURFACE,
        (
            "the mesh is empty: no voxel of {voxel_size:g} m was observed by at least {min_weight} of "
            "{used_count} frames{inside}."
        ),
        work.where,
        remedy="Check the poses and the depth scale, or lower min_weight.",
        used_count=len(used),
        voxel_size=work.plan.voxel_size,
        min_weight=min_weight,
        inside=inside(work.plan.crop, sum(used)),
    )


def inside(crop: Crop, points: int) -> str:
    """Describe the crop for a message; empty without a crop."""
    return f" inside {crop} ({points:,} depth points there)" if crop else ""


def device_of(params: FuseParams) -> str:
    """Resolve the device parameter to "CPU:0" or "CUDA:0".

    Raises
    ------
    UsageError
        If CUDA is requested with the own backend, or Open3D finds no CUDA device.
    """
    wanted = params.device
    if params.backend == "own":
        if wanted == "cuda":
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "is 'cuda', but backend 'own' runs on the CPU only",
                Where(parameter="device"),
                remedy="set backend to open3d or auto.",
            )
        return "CPU:0"
    if wanted != "cpu" and open3d().core.cuda.is_available():
        return "CUDA:0"
    if wanted == "cuda":
        raise UsageError(
            FUSE_DEVICE_MISSING,
            "is 'cuda', but Open3D finds no CUDA device",
            Where(parameter="device"),
            remedy="set it to cpu or auto.",
        )
    return "CPU:0"


def _require_usable(frames: Sequence[Frame], where: Path | None) -> None:
    if not frames:
        raise InputError(USAGE_ARGUMENT_INVALID, "there are no frames to fuse.", where)
    if all(frame.world_from_camera is None for frame in frames):
        raise InputError(
            POSE_MISSING,
            (
                "none of the {frames_count} frames has a camera pose (world_from_camera), which "
                "fusion requires."
            ),
            where,
            frames_count=len(frames),
        )
    if all(frame.depth is None for frame in frames):
        raise InputError(
            FUSE_NO_SURFACE,
            "none of the {frames_count} frames has a depth map",
            where,
            remedy="compute depth from stereo pairs first.",
            frames_count=len(frames),
        )


def require_share(work: Work, outcomes: Sequence[Outcome]) -> None:
    """Raise InputError if the ratio of skipped frames exceeds `max_bad_share`."""
    skipped = [one for one in outcomes if isinstance(one, SkippedFrame)]
    count, share = len(work.frames), work.params.max_bad_share
    if len(skipped) > share * count:
        raise InputError(
            SCAN_TOO_MANY_FRAMES_SKIPPED,
            (
                "{skipped_count} of {count} frames cannot be used; max_bad_share allows "
                "{share:.0%}. First unusable frame, {first}: {reason}"
            ),
            work.where,
            skipped_count=len(skipped),
            count=count,
            share=share,
            first=skipped[0].name,
            reason=skipped[0].reason,
        )
