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

from scanloom.stages._open3d import import_open3d
from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID, USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.frames.aligned_color import read_color_aligned_to_depth
from scanloom.stages.frames.posed_depth import PosedDepth, read_posed_depth
from scanloom.stages.fusion.codes import FUSE_DEVICE_MISSING, FUSE_NO_SURFACE
from scanloom.stages.fusion.crop import Crop
from scanloom.stages.fusion.depth_upsampling import upsample_frame, upsample_single_frame
from scanloom.stages.fusion.fusion_plan import FusionPlan, make_plan
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.fusion.single_frame_mesh import denoise_single_frame
from scanloom.stages.fusion.tsdf_volume import (
    BlockBox,
    BlockKeys,
    SparseVolume,
    TsdfVolume,
    find_touched_blocks,
)
from scanloom.stages.progress import Progress
from scanloom.stages.scans.codes import POSE_MISSING, SCAN_TOO_MANY_FRAMES_SKIPPED
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import ColorImage, Frame, Pose, Scan, SkippedFrame


@dataclass(frozen=True, eq=False)
class FusionJob:
    """Frames and resolved parameters of a fusion.

    Attributes
    ----------
    frames : all frames of the scan, with denoised or upsampled depth if there is a single frame.
    params, plan : parameters as given, and the plan with every derived value.
    color : whether voxels store colour.
    upsampling_factor : upsampling factor of the depth maps; 1 if they are not upsampled.
    threads : thread count for reading and integration.
    folder : folder of the scan, for messages.
    """

    frames: list[Frame]
    params: FuseParams
    plan: FusionPlan
    color: bool
    upsampling_factor: int
    threads: int
    folder: Path | None


@dataclass(frozen=True)
class PixelCounts:
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


FrameOutcome: TypeAlias = PixelCounts | SkippedFrame


@dataclass(frozen=True, eq=False)
class PreparedFrame:
    """Frame ready for integration.

    Attributes
    ----------
    view : filtered depth and pose.
    fused_count : number of pixels that are fused.
    volume_input : volume-specific input, as returned by `TsdfVolume.prepared`: touched blocks or depth
        layers.
    color : (h, w, 3) uint8 at the size of the depth map; None without colour.
    """

    view: PosedDepth
    fused_count: int
    volume_input: Any
    color: ColorImage | None


def prepare_fusion(scan: Scan | Iterable[Frame], params: FuseParams) -> FusionJob:
    """Sample some frames and derive the parameters left unset.

    Raises
    ------
    InputError
        If there are no frames, or no frame has a pose or a depth map.
    UsageError
        If the crop contains no points.
    """
    frames = list(scan.frames if isinstance(scan, Scan) else scan)
    folder = scan.folder if isinstance(scan, Scan) else None
    _check_usable(frames, folder)
    measured = denoise_single_frame(frames, params.max_jump)
    frames = list(upsample_single_frame(measured, params))
    is_upsampled = params.upsample == "guided" or frames[0] is not measured[0]
    threads = get_worker_count()
    return FusionJob(
        frames,
        params,
        make_plan(frames, params, folder, threads),
        color=params.color and any(frame.color is not None for frame in frames),
        upsampling_factor=params.upsample_factor if is_upsampled else 1,
        threads=threads,
        folder=folder,
    )


def create_volume(work: FusionJob, within: BlockBox | None = None) -> SparseVolume:
    """Create an empty TSDF volume.

    Parameters
    ----------
    within : limits the volume to a box of blocks; None for no limit.
    """
    return SparseVolume(
        work.plan.voxel_size,
        work.plan.truncation,
        work.plan.noise_model,
        color=work.color,
        max_bytes=work.params.memory * 1e6,
        threads=work.threads,
        within=within,
    )


def integrate_frames(
    work: FusionJob, volume: TsdfVolume, frames: Sequence[Frame], progress: Progress
) -> list[FrameOutcome]:
    """Integrate frames into a volume in the given order.

    Returns
    -------
    One outcome per frame: its pixel counts, or the reason why the frame was skipped.

    Raises
    ------
    InputError
        If more than `max_skipped_ratio` of all frames cannot be used.
    StageError
        If the volume exceeds its memory limit.
    """

    def add(_number: int, item: PreparedFrame) -> None:
        # Frames without touched blocks add nothing.
        volume.integrate(item.view, item.volume_input, work.plan.to_local_pose(item.view.pose), item.color)

    return _process_frames(work, frames, volume.prepare_frame, add, progress, color=work.color)


def collect_touched_blocks(
    work: FusionJob, on_blocks: Callable[[int, BlockKeys], object], progress: Progress
) -> list[FrameOutcome]:
    """Find the blocks that each frame touches, without reading colour images.

    Parameters
    ----------
    on_blocks : called with the index of each frame and the keys of its blocks, in order.

    Returns
    -------
    One outcome per frame, as `integrate_frames`.

    Raises
    ------
    InputError
        If more than `max_skipped_ratio` of the frames cannot be used.
    """
    plan = work.plan

    def find_blocks(view: PosedDepth, here: NDArray[np.bool_], pose: Pose) -> BlockKeys:
        return find_touched_blocks(view, here, pose, voxel_size=plan.voxel_size, truncation=plan.truncation)

    def report_blocks(number: int, item: PreparedFrame) -> None:
        on_blocks(number, item.volume_input)

    return _process_frames(work, work.frames, find_blocks, report_blocks, progress, color=False)


def _process_frames(
    work: FusionJob,
    frames: Sequence[Frame],
    prepare_input: Callable[[PosedDepth, NDArray[np.bool_], Pose], Any],
    on_frame: Callable[[int, PreparedFrame], object],
    progress: Progress,
    *,
    color: bool,
) -> list[FrameOutcome]:
    plan, params = work.plan, work.params

    def prepare(frame: Frame) -> PreparedFrame | SkippedFrame:
        try:
            larger = upsample_frame(frame, params) if params.upsample == "guided" else frame
            view = read_posed_depth(larger, plan.limits)
            here = plan.mask_fused_pixels(view)
            image = read_color_aligned_to_depth(larger, view.surface.depth) if color and here.any() else None
        except InputError as error:
            return SkippedFrame(frame.name, error.diagnostic.replace_location_fields(frame=None))
        used = int(np.count_nonzero(here))
        return PreparedFrame(view, used, prepare_input(view, here, plan.to_local_pose(view.pose)), image)

    outcomes: list[FrameOutcome] = []
    ahead = work.threads + 2
    for number, item in enumerate(map_ordered(prepare, frames, threads=work.threads, max_pending=ahead)):
        if isinstance(item, SkippedFrame):
            outcomes.append(item)
            check_skipped_ratio(work, outcomes)
        else:
            on_frame(number, item)
            outcomes.append(
                PixelCounts(item.view.surface.depth.size, item.view.valid_pixel_count, item.fused_count)
            )
        progress(number + 1, len(frames))
    return outcomes


def collect_statistics(
    work: FusionJob, outcomes: Sequence[FrameOutcome], min_weight: int, volume_bytes: int, device: str
) -> dict[str, Any]:
    """Collect the fields of `FusionStatistics` as keyword arguments.

    Parameters
    ----------
    outcomes : one entry per frame of the scan.
    """
    plan = work.plan
    read = [one for one in outcomes if isinstance(one, PixelCounts)]
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
        "support": plan.support_plane,
        "outside": sum(one.used == 0 for one in read),
        "upsampled": work.upsampling_factor,
    }


def derive_min_observations(median_observations: float, frames: Sequence[Frame]) -> int:
    """Derive the minimum observation count from the median observation count.

    The result is half the median of the voxels near the surface, within 1 to 3 frames.
    """
    min_observations = int(np.clip(round(median_observations / 2), 1, 3))
    # Few frames observe each side of a masked turntable object. All frames observe the plate below it, which
    # dominates the median.
    is_masked = all(frame.mask is not None for frame in frames)
    return min(min_observations, max(len(frames) // 4, 1)) if is_masked else min_observations


def make_empty_mesh_error(work: FusionJob, outcomes: Sequence[FrameOutcome], min_weight: int) -> InputError:
    """Build the error for a fusion whose mesh has no triangles."""
    used = [one.used for one in outcomes if isinstance(one, PixelCounts) and one.used]
    return InputError(
        FUSE_NO_SURFACE,
        (
            "the mesh is empty: no voxel of {voxel_size:g} m was observed by at least {min_weight} of "
            "{used_count} frames{inside}."
        ),
        work.folder,
        remedy="Check the poses and the depth scale, or lower min_weight.",
        used_count=len(used),
        voxel_size=work.plan.voxel_size,
        min_weight=min_weight,
        inside=describe_crop(work.plan.crop, sum(used)),
    )


def describe_crop(crop: Crop, point_count: int) -> str:
    """Describe the crop for a message; empty without a crop."""
    return f" inside {crop} ({point_count:,} depth points there)" if crop else ""


def resolve_device(params: FuseParams) -> str:
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
                DiagnosticLocation(parameter="device"),
                remedy="set backend to open3d or auto.",
            )
        return "CPU:0"
    if wanted != "cpu" and import_open3d().core.cuda.is_available():
        return "CUDA:0"
    if wanted == "cuda":
        raise UsageError(
            FUSE_DEVICE_MISSING,
            "is 'cuda', but Open3D finds no CUDA device",
            DiagnosticLocation(parameter="device"),
            remedy="set it to cpu or auto.",
        )
    return "CPU:0"


def _check_usable(frames: Sequence[Frame], folder: Path | None) -> None:
    if not frames:
        raise InputError(USAGE_ARGUMENT_INVALID, "there are no frames to fuse.", folder)
    if all(frame.world_from_camera is None for frame in frames):
        raise InputError(
            POSE_MISSING,
            (
                "none of the {frames_count} frames has a camera pose (world_from_camera), which "
                "fusion requires."
            ),
            folder,
            frames_count=len(frames),
        )
    if all(frame.depth is None for frame in frames):
        raise InputError(
            FUSE_NO_SURFACE,
            "none of the {frames_count} frames has a depth map",
            folder,
            remedy="compute depth from stereo pairs first.",
            frames_count=len(frames),
        )


def check_skipped_ratio(work: FusionJob, outcomes: Sequence[FrameOutcome]) -> None:
    """Raise InputError if the ratio of skipped frames exceeds `max_skipped_ratio`."""
    skipped = [one for one in outcomes if isinstance(one, SkippedFrame)]
    count, max_ratio = len(work.frames), work.params.max_skipped_ratio
    if len(skipped) > max_ratio * count:
        raise InputError(
            SCAN_TOO_MANY_FRAMES_SKIPPED,
            (
                "{skipped_count} of {count} frames cannot be used; max_skipped_ratio allows "
                "{share:.0%}. First unusable frame, {first}: {reason}"
            ),
            work.folder,
            skipped_count=len(skipped),
            count=count,
            share=max_ratio,
            first=skipped[0].name,
            reason=skipped[0].reason,
        )
