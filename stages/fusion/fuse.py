"""Fuse posed depth maps into one coloured mesh: a truncated signed distance field, then its zero surface."""

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
    """A fused mesh, and how it came about.

    Attributes
    ----------
    mesh : with uint8 vertex colours where the frames have colour.
    seen : (n,) float32, how many frames saw each vertex, 255 for more; None of a frame alone, from Open3D's
        voxels and where space was cut in bricks.
    """

    mesh: Mesh
    seen: Seen | None = None

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return the figures for a report, JSON-able, units in the names."""
        return self.figures_of(MeshFigures.of(self.mesh))


def fuse(
    scan: Scan | Iterable[Frame],
    params: FuseParams | None = None,
    *,
    progress: Progress = silent,
    **changes: Unpack[FuseKeywords],
) -> Fused:
    """Fuse frames with depth and poses into a mesh.

    Some frames are looked at first: depth noise is measured by comparing neighbouring frames, and whatever
    parameter is left open follows from it and from the spacing of the pixels that are kept. Then frames are
    read and filtered in threads, a few ahead, while one after the other goes into the volume. A frame that
    cannot be used is skipped and reported. With a crop the volume holds what is inside, and a seam outside as
    wide as the field is cut off at; depth outside tells that nothing is before it. The mesh is cut at the
    border: there it is as without a crop. Of a frame alone the pixels are joined instead (see
    scanloom.stages.fusion.relief). Equal input gives a bit-identical mesh on one machine, whatever the
    number of threads, and whether space was cut in bricks (see scanloom.stages.fusion.in_bricks).

    Parameters
    ----------
    scan : a scan, or frames, with depth; stereo pairs go through `depth` first.
    params, **changes : see FuseParams.
    progress : called after each frame.

    Raises
    ------
    InputError
        If no frame has a pose or depth, or more than `max_bad_share` of the frames cannot be used.
    UsageError
        For a parameter out of its range, a crop that leaves nothing, or a CUDA device that is not there.
    StageError
        If the volume outgrows its memory, and so does each brick of space, or they are not to be had.

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
    """Fuse frames as `fuse` does, and write the mesh to a PLY file; in pieces, if space was cut in bricks.

    Parameters
    ----------
    kept : where bricks are kept for the next time; None for nowhere.

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
    """Fuse in one piece; or in bricks, where that is asked for or one piece does not fit."""
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
    """Whether space is to be cut in bricks from the start: as asked for, or likely to be needed."""
    if work.params.brick_size is not None and not _has_bricks(work, device):
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "is for scanloom's own voxels",
            Where(parameter="brick_size"),
            remedy="leave out device and backend.",
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
    """Join the pixels of a frame that no other fills up."""
    (frame,), plan = work.frames, work.plan
    view = read_whole(frame, plan.limits)
    here = plan.fused(view)
    image = read_matching_color(frame, view.surface.depth) if work.color else None
    mesh = cut(relief(view, here, image, plan.voxel_size, plan.limits), plan.crop)
    if len(mesh.triangles) == 0:
        raise InputError(
            FUSE_NO_SURFACE,
            "no surface came out of the frame{inside}.",
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
