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
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.frames.matching_color import read_matching_color
from scanloom.stages.fusion.adding import (
    Work,
    add_frames,
    begun,
    device_of,
    facts_of,
    inside,
    least_weight,
    nothing_fused,
    own_volume,
)
from scanloom.stages.fusion.codes import FUSE_NO_SURFACE
from scanloom.stages.fusion.crop import corners_of, cut, part_of, within
from scanloom.stages.fusion.facts import Facts, MeshFigures
from scanloom.stages.fusion.in_bricks import FusedInBricks, Kept, fuse_in_bricks
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.fusion.relief import read_whole, relief
from scanloom.stages.fusion.voxels import Field, OutgrownError, Seen, block_bytes
from scanloom.stages.fusion.writing import write_fused
from scanloom.stages.params import resolve
from scanloom.stages.printing import by_figures, table
from scanloom.stages.progress import Progress, silent
from scanloom.stages.scans.model.scan import Frame, Scan
from scanloom.stages.surface.formats.ply import read_ply, write_ply
from scanloom.stages.surface.mesh import Mesh

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import FuseKeywords

RESULT_VERSION = 8

R = TypeVar("R")


@dataclass(frozen=True, eq=False, kw_only=True)
class Fused(Facts):
    """Fused mesh with statistics of the fusion.

    Attributes
    ----------
    mesh : with uint8 vertex colours if the frames have colour.
    seen : (n,) float32, number of frames that observed each vertex, capped at 255. None for a single frame,
        for Open3D's backend, and for fusion in bricks.
    """

    mesh: Mesh
    seen: Seen | None = None

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return JSON-ready metrics for the report, with units in the keys."""
        return self.figures_of(MeshFigures.of(self.mesh))


def fuse(
    scan: Scan | Iterable[Frame],
    params: FuseParams | None = None,
    *,
    progress: Progress = silent,
    **changes: Unpack[FuseKeywords],
) -> Fused:
    """Fuse frames with depth and poses into a mesh.

    Depth noise is estimated from a sample of neighbouring frames. Unset parameters are derived from this
    estimate and from the pixel spacing. Frames are then read in parallel and integrated in order. Unusable
    frames are skipped and reported.

    With a crop, the volume extends one truncation beyond the crop. Depth outside the crop only carves free
    space. The mesh is cut at the crop boundary and inside equals the mesh without a crop.

    A single frame is meshed directly from its pixels, without a volume (see scanloom.stages.fusion.relief).
    On one machine, equal input gives a bit-identical mesh for any number of threads and any brick size (see
    scanloom.stages.fusion.in_bricks).

    Parameters
    ----------
    scan : scan or frames with depth; compute depth of stereo pairs with `depth` first.
    params, **changes : see FuseParams.
    progress : called after each frame.

    Raises
    ------
    InputError
        If no frame has a pose or depth, or more than `max_bad_share` of the frames cannot be used.
    UsageError
        If a parameter is out of range, the crop contains no points, or the CUDA device is missing.
    StageError
        If the volume exceeds its memory limit and a single brick does as well, or if the backend does not
        support bricks.

    References
    ----------
    Curless and Levoy 1996 (see scanloom.stages.fusion.voxels).
    """
    params = resolve(FuseParams, params, changes)
    with collecting() as diagnostics:
        work = begun(scan, params)

        def in_bricks() -> Fused:
            with tempfile.TemporaryDirectory() as folder:
                fused = fuse_in_bricks(work, Path(folder) / "fused.ply", progress=progress)
                return Fused(mesh=read_ply(fused.path), **fused.facts())

        fused = _fused(work, progress, in_bricks)
    return replace(fused, diagnostics=tuple(diagnostics))


def fuse_to_file(
    scan: Scan, params: FuseParams, path: Path, *, kept: Kept | None = None, progress: Progress = silent
) -> Fused | FusedInBricks:
    """Fuse frames as `fuse` does, and write a PLY file.

    Large meshes are written in chunks.

    Parameters
    ----------
    kept : store for fused bricks, reused by later runs; None discards the bricks.

    Raises
    ------
    InputError, UsageError, StageError
        As `fuse`.
    """
    with collecting() as diagnostics:
        work = begun(scan, params)
        fused = _fused(work, progress, partial(fuse_in_bricks, work, path, kept=kept, progress=progress))
    fused = replace(fused, diagnostics=tuple(diagnostics))
    if isinstance(fused, Fused):
        if len(work.frames) > 1 and _has_bricks(work, fused.device):
            write_fused(path, fused.mesh, work.plan)
        else:
            write_ply(path, fused.mesh)
    return fused


def _fused(work: Work, progress: Progress, in_bricks: Callable[[], R]) -> Fused | R:
    """Fuse in memory, or in bricks.

    Bricks are used if requested, or if the volume exceeds its memory limit.
    """
    device = device_of(work.params)
    if _is_in_bricks(work, device):
        return in_bricks()
    try:
        return _in_one_piece(work, device, progress)
    except OutgrownError:
        if not _has_bricks(work, device):
            raise
        return in_bricks()


def _is_in_bricks(work: Work, device: str) -> bool:
    """Return True if fusion should start in bricks.

    Bricks are used if requested, or if the expected volume exceeds the memory limit.
    """
    if work.params.brick_size is not None and not _has_bricks(work, device):
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "requires backend 'own' on the CPU",
            Where(parameter="brick_size"),
            remedy="omit device and backend.",
        )
    if len(work.frames) == 1 or not _has_bricks(work, device):
        return False
    expected = work.plan.blocks * work.plan.spread * block_bytes(color=work.color)
    return work.params.brick_size is not None or expected > work.params.memory * 1e6


def _has_bricks(work: Work, device: str) -> bool:
    return device == "CPU:0" and work.params.backend != "open3d"


def _in_one_piece(work: Work, device: str, progress: Progress) -> Fused:
    if len(work.frames) == 1:
        fused = _alone(work)
        progress(1, 1)
        return fused
    volume = _volume(work, device)
    added = add_frames(work, volume, work.frames, progress)
    min_weight = work.params.min_weight or least_weight(volume.typical_frames(), work.frames)
    mesh, seen = volume.mesh(min_weight)
    plan = work.plan
    mesh = mesh.with_(vertices=mesh.vertices + plan.origin)
    if plan.crop:
        kept = within(mesh, plan.crop)
        seen = None if seen is None else seen[corners_of(mesh, kept)]
        mesh = part_of(mesh, kept)
    if len(mesh.triangles) == 0:
        raise nothing_fused(work, added, min_weight)
    return Fused(mesh=mesh, seen=seen, **facts_of(work, added, min_weight, volume.bytes, device))


def _volume(work: Work, device: str) -> Field:
    plan, max_bytes = work.plan, work.params.memory * 1e6
    if work.params.backend == "open3d" or device != "CPU:0":
        from scanloom.stages.fusion.open3d_voxels import Open3DVolume

        return Open3DVolume(
            plan.voxel_size,
            plan.truncation,
            plan.limits.max_depth,
            color=work.color,
            blocks=plan.blocks,
            max_bytes=max_bytes,
            device=device,
        )
    return own_volume(work)


def _alone(work: Work) -> Fused:
    """Mesh the pixels of a single frame."""
    (frame,), plan = work.frames, work.plan
    view = read_whole(frame, plan.limits)
    here = plan.fused(view)
    image = read_matching_color(frame, view.surface.depth) if work.color else None
    mesh = cut(relief(view, here, image, plan.voxel_size, plan.limits), plan.crop)
    if len(mesh.triangles) == 0:
        raise InputError(
            FUSE_NO_SURFACE,
            "the mesh is empty: no triangle was found in the depth map{inside}.",
            Where(frame=frame.name),
            remedy="Check the depth scale and the calibration.",
            inside=inside(plan.crop, int(here.sum())),
        )
    return Fused(
        mesh=mesh,
        voxel_size=plan.voxel_size,
        truncation=0.0,
        max_depth=plan.max_depth,
        min_weight=1,
        noise=plan.noise,
        frames=1,
        skipped=(),
        pixels_valid=view.valid / view.surface.depth.size,
        pixels_used=int(here.sum()) / view.surface.depth.size,
        volume_bytes=0,
        device="CPU:0",
        crop=plan.crop,
        support=plan.support,
        outside=0,
        upsampled=work.factor,
    )
