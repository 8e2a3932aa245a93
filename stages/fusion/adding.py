"""Frames added to a field one after the other, read and filtered in threads a few ahead."""

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
    """What is to be fused, and how.

    Attributes
    ----------
    frames : all of them.
    params, plan : as given, and with nothing left to derive.
    color : whether voxels have a colour.
    factor : how many times as wide the depth maps are made first.
    threads : to read and compute with.
    where : the scan's folder, for messages.
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
    """Of a frame, how many pixels there are, have a depth, and show what is fused."""

    pixels: int
    valid: int
    used: int


# What became of a frame.
Outcome: TypeAlias = Tally | SkippedFrame


@dataclass(frozen=True, eq=False)
class Prepared:
    """A frame ready to be added: how many pixels are used, the field's own of it, and its colours."""

    view: PosedDepth
    used: int
    parts: Any
    color: ColorImage | None


def begun(scan: Scan | Iterable[Frame], params: FuseParams) -> Work:
    """Look at some frames, and derive what is left open.

    Raises
    ------
    InputError
        If there is nothing to fuse.
    UsageError
        If nothing is inside of what is to be fused.
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
    """Return a field of our own, without any frames; of the blocks in a box alone, if there is one."""
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
    """Add frames to a field, in their order; return what became of each.

    Raises
    ------
    InputError
        If more than `max_bad_share` of all frames cannot be used.
    StageError
        If the field outgrows its memory.
    """

    def add(_number: int, item: Prepared) -> None:
        # Without parts, nothing is added.
        volume.integrate(item.view, item.parts, work.plan.local(item.view.pose), item.color)

    return _each(work, frames, volume.prepared, add, progress, color=work.color)


def look_through(work: Work, seen: Callable[[int, Keys], object], progress: Progress) -> list[Outcome]:
    """Call `seen` with the number of each frame and the blocks it touches; colours are not read.

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
    """Return the fields of `Facts`; the outcomes are those of all frames."""
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
    """Return how many frames must have seen a surface, from how many saw the median voxel."""
    least = int(np.clip(round(typical / 2), 1, 3))
    # A masked thing is seen from all around, each side by a few frames, and the plate below it by all.
    is_masked = all(frame.mask is not None for frame in frames)
    return min(least, max(len(frames) // 4, 1)) if is_masked else least


def nothing_fused(work: Work, outcomes: Sequence[Outcome], min_weight: int) -> InputError:
    """Return the error of a fusion that nothing came out of."""
    used = [one.used for one in outcomes if isinstance(one, Tally) and one.used]
    return InputError(
        FUSE_NO_SURFACE,
        (
            "no surface came out of {used_count} frames at voxels of {voxel_size:g} m: "
            "none was seen by {min_weight} of them{inside}."
        ),
        work.where,
        remedy="Check poses and depth scale, or lower min_weight.",
        used_count=len(used),
        voxel_size=work.plan.voxel_size,
        min_weight=min_weight,
        inside=inside(work.plan.crop, sum(used)),
    )


def inside(crop: Crop, points: int) -> str:
    """Return words for what of a scan is fused; none for all of it."""
    return f" inside {crop}, from {points:,} points there" if crop else ""


def device_of(params: FuseParams) -> str:
    """Return "CPU:0" or "CUDA:0".

    Raises
    ------
    UsageError
        If a CUDA device is asked for and not there, or of no use.
    """
    wanted = params.device
    if params.backend == "own":
        if wanted == "cuda":
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "is 'cuda', which backend 'own' knows nothing of",
                Where(parameter="device"),
                remedy="choose open3d or auto.",
            )
        return "CPU:0"
    if wanted != "cpu" and open3d().core.cuda.is_available():
        return "CUDA:0"
    if wanted == "cuda":
        raise UsageError(
            FUSE_DEVICE_MISSING,
            "is 'cuda', but Open3D finds no CUDA device",
            Where(parameter="device"),
            remedy="choose cpu or auto.",
        )
    return "CPU:0"


def _require_usable(frames: Sequence[Frame], where: Path | None) -> None:
    if not frames:
        raise InputError(USAGE_ARGUMENT_INVALID, "there are no frames to fuse.", where)
    if all(frame.world_from_camera is None for frame in frames):
        raise InputError(
            POSE_MISSING,
            (
                "none of the {frames_count} frames has a camera pose; fusion needs the pose "
                "of each (world_from_camera)."
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
    """Raise InputError if too many of the frames cannot be used."""
    skipped = [one for one in outcomes if isinstance(one, SkippedFrame)]
    count, share = len(work.frames), work.params.max_bad_share
    if len(skipped) > share * count:
        raise InputError(
            SCAN_TOO_MANY_FRAMES_SKIPPED,
            (
                "{skipped_count} of {count} frames cannot be used; at most {share:.0%} may "
                "be bad (max_bad_share). The first, frame {first}: {reason}"
            ),
            work.where,
            skipped_count=len(skipped),
            count=count,
            share=share,
            first=skipped[0].name,
            reason=skipped[0].reason,
        )
