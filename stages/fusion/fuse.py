"""Fusion of posed depth maps into a coloured mesh."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.frames.aligned_color import read_color_aligned_to_depth
from scanloom.stages.fusion.brick_fusion import BrickStore, FusedInBricks, fuse_in_bricks
from scanloom.stages.fusion.codes import FUSE_NO_SURFACE
from scanloom.stages.fusion.crop import crop_mesh, mask_triangles_inside, mask_used_vertices, select_triangles
from scanloom.stages.fusion.fused_mesh_files import write_fused_mesh
from scanloom.stages.fusion.fusion_statistics import FusionStatistics, MeshStatistics
from scanloom.stages.fusion.integration import (
    FusionJob,
    collect_statistics,
    create_volume,
    derive_min_observations,
    describe_crop,
    integrate_frames,
    make_empty_mesh_error,
    prepare_fusion,
    resolve_device,
)
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.fusion.single_frame_mesh import mesh_depth_map, read_unfiltered_depth
from scanloom.stages.fusion.tsdf_volume import (
    ObservationCounts,
    TsdfVolume,
    VolumeMemoryError,
    compute_block_bytes,
)
from scanloom.stages.params import resolve
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.scans.model.scan import Frame, Scan
from scanloom.stages.surface.formats.ply import read_ply, write_ply
from scanloom.stages.surface.mesh import Mesh

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import FuseKeywords

RESULT_VERSION = 8

R = TypeVar("R")


@dataclass(frozen=True, eq=False, kw_only=True)
class FusionResult(FusionStatistics):
    """Fused mesh with statistics of the fusion.

    Attributes
    ----------
    mesh : fused mesh, with uint8 vertex colours if the frames have colour.
    observation_counts : (n,) float32, number of frames that observed each vertex, capped at 255. None for a
        single frame, for Open3D's backend, and for fusion in bricks.
    """

    mesh: Mesh
    observation_counts: ObservationCounts | None = None

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return JSON-ready metrics for the report, with units in the keys."""
        return self.compute_metrics(MeshStatistics.from_mesh(self.mesh))


def fuse(
    scan: Scan | Iterable[Frame],
    params: FuseParams | None = None,
    *,
    progress: Progress = ignore_progress,
    **changes: Unpack[FuseKeywords],
) -> FusionResult:
    """Fuse frames with depth and poses into a mesh.

    Depth noise is estimated from a sample of neighbouring frames. Unset parameters are derived from this
    estimate and from the pixel spacing. Frames are then read in parallel and integrated in order. Unusable
    frames are skipped and reported.

    With a crop, the volume extends one truncation beyond the crop. Depth outside the crop only carves free
    space. The mesh is cut at the crop boundary and inside equals the mesh without a crop.

    A single frame is meshed directly from its pixels, without a volume (see
    scanloom.stages.fusion.single_frame_mesh). On one machine, equal input gives a bit-identical mesh for any
    number of threads and any brick size (see scanloom.stages.fusion.brick_fusion).

    Parameters
    ----------
    scan : scan or frames with depth; compute depth of stereo pairs with `depth` first.
    params, **changes : see FuseParams.
    progress : called after each frame.

    Raises
    ------
    InputError
        If no frame has a pose or depth, or more than `max_skipped_ratio` of the frames cannot be used.
    UsageError
        If a parameter is out of range, the crop contains no points, or the CUDA device is missing.
    StageError
        If the volume exceeds its memory limit and a single brick does as well, or if the backend does not
        support bricks.

    References
    ----------
    Curless and Levoy 1996 (see scanloom.stages.fusion.tsdf_volume).
    """
    params = resolve(FuseParams, params, changes)
    with collecting() as diagnostics:
        work = prepare_fusion(scan, params)

        def fuse_bricks() -> FusionResult:
            with tempfile.TemporaryDirectory() as folder:
                fused = fuse_in_bricks(work, Path(folder) / "fused.ply", progress=progress)
                return FusionResult(mesh=read_ply(fused.path), **fused.to_field_dict())

        fused = _fuse_in_memory_or_bricks(work, progress, fuse_bricks)
    return replace(fused, diagnostics=tuple(diagnostics))


def fuse_to_file(
    scan: Scan,
    params: FuseParams,
    path: Path,
    *,
    brick_store: BrickStore | None = None,
    progress: Progress = ignore_progress,
) -> FusionResult | FusedInBricks:
    """Fuse frames as `fuse` does, and write a PLY file.

    Large meshes are written in chunks.

    Parameters
    ----------
    brick_store : store for fused bricks, reused by later runs; None discards the bricks.

    Raises
    ------
    InputError, UsageError, StageError
        As `fuse`.
    """
    with collecting() as diagnostics:
        work = prepare_fusion(scan, params)
        fused = _fuse_in_memory_or_bricks(
            work, progress, partial(fuse_in_bricks, work, path, brick_store=brick_store, progress=progress)
        )
    fused = replace(fused, diagnostics=tuple(diagnostics))
    if isinstance(fused, FusionResult):
        if len(work.frames) > 1 and _supports_bricks(work, fused.device):
            write_fused_mesh(path, fused.mesh, work.plan)
        else:
            write_ply(path, fused.mesh)
    return fused


def _fuse_in_memory_or_bricks(
    work: FusionJob, progress: Progress, fuse_bricks: Callable[[], R]
) -> FusionResult | R:
    """Fuse in memory, or in bricks.

    Bricks are used if requested, or if the volume exceeds its memory limit.
    """
    device = resolve_device(work.params)
    if _needs_bricks(work, device):
        return fuse_bricks()
    try:
        return _fuse_in_memory(work, device, progress)
    except VolumeMemoryError:
        if not _supports_bricks(work, device):
            raise
        return fuse_bricks()


def _needs_bricks(work: FusionJob, device: str) -> bool:
    """Return True if fusion should start in bricks.

    Bricks are used if requested, or if the expected volume exceeds the memory limit.
    """
    if work.params.brick_size is not None and not _supports_bricks(work, device):
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "requires backend 'own' on the CPU",
            DiagnosticLocation(parameter="brick_size"),
            remedy="omit device and backend.",
        )
    if len(work.frames) == 1 or not _supports_bricks(work, device):
        return False
    expected = work.plan.block_count * work.plan.position_ratio * compute_block_bytes(color=work.color)
    return work.params.brick_size is not None or expected > work.params.memory * 1e6


def _supports_bricks(work: FusionJob, device: str) -> bool:
    return device == "CPU:0" and work.params.backend != "open3d"


def _fuse_in_memory(work: FusionJob, device: str, progress: Progress) -> FusionResult:
    if len(work.frames) == 1:
        fused = _mesh_single_frame(work)
        progress(1, 1)
        return fused
    volume = _create_volume(work, device)
    added = integrate_frames(work, volume, work.frames, progress)
    min_weight = work.params.min_weight or derive_min_observations(
        volume.compute_median_observations(), work.frames
    )
    mesh, seen = volume.extract_mesh(min_weight)
    plan = work.plan
    mesh = mesh.with_(vertices=mesh.vertices + plan.origin)
    if plan.crop:
        kept = mask_triangles_inside(mesh, plan.crop)
        seen = None if seen is None else seen[mask_used_vertices(mesh, kept)]
        mesh = select_triangles(mesh, kept)
    if len(mesh.triangles) == 0:
        raise make_empty_mesh_error(work, added, min_weight)
    return FusionResult(
        mesh=mesh,
        observation_counts=seen,
        **collect_statistics(work, added, min_weight, volume.bytes, device),
    )


def _create_volume(work: FusionJob, device: str) -> TsdfVolume:
    plan, max_bytes = work.plan, work.params.memory * 1e6
    if work.params.backend == "open3d" or device != "CPU:0":
        from scanloom.stages.fusion.open3d_volume import Open3DVolume

        return Open3DVolume(
            plan.voxel_size,
            plan.truncation,
            plan.limits.max_depth,
            color=work.color,
            blocks=plan.block_count,
            max_bytes=max_bytes,
            device=device,
        )
    return create_volume(work)


def _mesh_single_frame(work: FusionJob) -> FusionResult:
    """Mesh the pixels of a single frame."""
    (frame,), plan = work.frames, work.plan
    view = read_unfiltered_depth(frame, plan.limits)
    here = plan.mask_fused_pixels(view)
    image = read_color_aligned_to_depth(frame, view.surface.depth) if work.color else None
    mesh = crop_mesh(mesh_depth_map(view, here, image, plan.voxel_size, plan.limits), plan.crop)
    if len(mesh.triangles) == 0:
        raise InputError(
            FUSE_NO_SURFACE,
            "the mesh is empty: no triangle was found in the depth map{inside}.",
            DiagnosticLocation(frame=frame.name),
            remedy="Check the depth scale and the calibration.",
            inside=describe_crop(plan.crop, int(here.sum())),
        )
    return FusionResult(
        mesh=mesh,
        voxel_size=plan.voxel_size,
        truncation=0.0,
        max_depth=plan.max_depth,
        min_weight=1,
        noise=plan.noise,
        frames=1,
        skipped=(),
        pixels_valid=view.valid_pixel_count / view.surface.depth.size,
        pixels_used=int(here.sum()) / view.surface.depth.size,
        volume_bytes=0,
        device="CPU:0",
        crop=plan.crop,
        support=plan.support_plane,
        outside=0,
        upsampled=work.upsampling_factor,
    )
