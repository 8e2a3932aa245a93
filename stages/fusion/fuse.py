"""Fuse posed depth maps into one coloured mesh: a truncated signed distance field, then its zero surface."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stages._open3d import open3d
from stages.errors import InputError, UsageError
from stages.fusion.crop import Crop, corners_of, cut, inside, part_of
from stages.fusion.params import FuseKeywords, FuseParams
from stages.fusion.plan import Plan, make_plan
from stages.fusion.posed_depth import PosedDepth, read_matching_color, read_posed_depth
from stages.fusion.relief import evened_alone, read_whole, relief
from stages.fusion.support import Support
from stages.fusion.survey import Noise
from stages.fusion.upsampling import upsampled_alone, upsampled_frame
from stages.fusion.voxels import Field, Seen, Volume
from stages.params import resolve
from stages.printing import by_figures, table
from stages.progress import Progress, silent
from stages.scans.prefetch import read_ahead, workers
from stages.scans.scan import ColorImage, Frame, Scan, SkippedFrame
from stages.surface.mesh import Mesh

if TYPE_CHECKING:
    from typing_extensions import Unpack

RESULT_VERSION = 6


@dataclass(frozen=True, eq=False, kw_only=True)
class Fused:
    """A fused mesh, and how it came about.

    Attributes
    ----------
    mesh : with uint8 vertex colours where the frames have colour.
    voxel_size, truncation, max_depth : metres, as given or derived; truncation is 0 for a frame alone, whose
        pixels are joined without a field.
    min_weight : frames, as given or derived.
    noise : depth noise measured between neighbouring frames.
    frames : how many frames were fused.
    skipped : which were not, and why.
    pixels_valid : share of the fused frames' pixels that had a depth.
    pixels_used : share of them that went into the volume.
    volume_bytes : memory of the volume at its end.
    device : "CPU:0" or "CUDA:0".
    crop : what was fused of the scan.
    support : the plane that was left out, with what is below it.
    outside : how many frames show nothing of what was fused; they are not among `frames`.
    warnings : of what was left out.
    upsampled : how many times as wide the depth maps were made first; 1 for not at all.
    seen : (n,) float32, how many frames saw each vertex, 255 for more; None of a frame alone, and from
        Open3D's voxels.
    """

    mesh: Mesh
    voxel_size: float
    truncation: float
    max_depth: float
    min_weight: int
    noise: Noise
    frames: int
    skipped: tuple[SkippedFrame, ...]
    pixels_valid: float
    pixels_used: float
    volume_bytes: int
    device: str
    crop: Crop
    support: Support | None
    outside: int
    warnings: tuple[str, ...]
    upsampled: int = 1
    seen: Seen | None = None

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return the figures for a report, JSON-able, units in the names."""
        return {
            "voxel_size_m": self.voxel_size,
            "truncation_m": self.truncation,
            "max_depth_m": self.max_depth,
            "min_weight_frames": self.min_weight,
            "depth_upsampled_times": self.upsampled,
            "depth_noise_constant_m": self.noise.constant,
            "depth_noise_quadratic_per_m": self.noise.quadratic,
            "frames_used": self.frames,
            "frames_used_share": self.frames / (self.frames + len(self.skipped)),
            "frames_skipped": [{"frame": s.name, "reason": s.reason} for s in self.skipped],
            "pixels_valid_share": self.pixels_valid,
            "pixels_used_share": self.pixels_used,
            "volume_mb": self.volume_bytes / 1e6,
            "device": self.device,
            "crop": self._crop_figures() if self.crop else None,
            "lowest_m": self.mesh.vertices.min(axis=0).tolist(),
            "highest_m": self.mesh.vertices.max(axis=0).tolist(),
            "vertices": len(self.mesh.vertices),
            "triangles": len(self.mesh.triangles),
            "warnings": list(self.warnings),
        }

    def _crop_figures(self) -> dict[str, Any]:
        crop, support = self.crop, self.support
        return {
            "box_m": crop.box,
            "center_m": crop.center,
            "radius_m": crop.radius,
            "plane": support
            and {
                "normal": support.normal,
                "offset_m": support.offset_m,
                "spread_m": support.spread_m,
                "points_share": support.share,
                "margin_m": crop.height - support.offset_m,
            },
            "frames_outside": self.outside,
        }


@dataclass(frozen=True, eq=False)
class _Prepared:
    """A frame ready to be integrated."""

    view: PosedDepth
    used: int
    parts: Any
    color: ColorImage | None


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
    stages.fusion.relief). Equal input gives a bit-identical mesh on one machine, whatever the
    number of threads.

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
        If the volume outgrows its memory.

    References
    ----------
    Curless and Levoy 1996; the volume is Open3D's VoxelBlockGrid (see stages.fusion.voxels).
    """
    params = resolve(FuseParams, params, changes)
    device = _device(params)
    frames = list(scan.frames if isinstance(scan, Scan) else scan)
    where = scan.folder if isinstance(scan, Scan) else None
    _require_usable(frames, where)
    measured = evened_alone(frames, params.max_jump)
    frames = list(upsampled_alone(measured, params))
    is_larger = params.upsample == "guided" or frames[0] is not measured[0]
    threads = workers()
    plan = make_plan(frames, params, where, threads)
    color = params.color and any(frame.color is not None for frame in frames)
    factor = params.upsample_factor if is_larger else 1
    if len(frames) == 1:
        fused = _alone(frames[0], plan, factor, color=color)
        progress(1, 1)
        return fused
    volume = _volume(plan, params, device, threads, color=color)

    def prepare(frame: Frame) -> _Prepared | SkippedFrame:
        try:
            if params.upsample == "guided":
                frame = upsampled_frame(frame, params)
            view = read_posed_depth(frame, plan.limits)
            here = plan.fused(view)
            image = read_matching_color(frame, view.surface.depth) if color and here.any() else None
        except InputError as error:
            return SkippedFrame(frame.name, str(error))
        used = int(np.count_nonzero(here))
        return _Prepared(view, used, volume.prepared(view, here, plan.local(view.pose)), image)

    skipped: list[SkippedFrame] = []
    pixels = valid = used = outside = 0
    for done, item in enumerate(read_ahead(prepare, frames, threads=threads, ahead=threads + 2), 1):
        if isinstance(item, SkippedFrame):
            skipped.append(item)
            _require_share(skipped, len(frames), params.max_bad_share, where)
        else:
            view = item.view
            # Without parts, nothing is added.
            volume.integrate(view, item.parts, plan.local(view.pose), item.color)
            outside += item.used == 0
            pixels += view.surface.depth.size
            valid += view.valid
            used += item.used
        progress(done, len(frames))

    min_weight = params.min_weight or _least_weight(volume.typical_frames(), frames)
    mesh, seen = volume.mesh(min_weight)
    mesh = mesh.with_(vertices=mesh.vertices + plan.origin)
    if plan.crop:
        kept = inside(mesh, plan.crop)
        seen = None if seen is None else seen[corners_of(mesh, kept)]
        mesh = part_of(mesh, kept)
    used_frames = len(frames) - len(skipped) - outside
    if len(mesh.triangles) == 0:
        raise InputError(
            f"no surface came out of {used_frames} frames at voxels of {plan.voxel_size:g} m: none was seen "
            f"by {min_weight} of them{_of(plan.crop, used)}. Check poses and depth scale, or lower "
            "min_weight.",
            where,
        )
    return Fused(
        mesh=mesh,
        voxel_size=plan.voxel_size,
        truncation=plan.truncation,
        max_depth=plan.max_depth,
        min_weight=min_weight,
        noise=plan.noise,
        frames=used_frames,
        skipped=tuple(skipped),
        pixels_valid=valid / pixels,
        pixels_used=used / pixels,
        volume_bytes=volume.bytes,
        device=device,
        crop=plan.crop,
        support=plan.support,
        outside=outside,
        warnings=plan.warnings,
        upsampled=factor,
        seen=seen,
    )


def _volume(plan: Plan, params: FuseParams, device: str, threads: int, *, color: bool) -> Field:
    max_bytes = params.memory * 1e6
    if params.backend == "open3d" or device != "CPU:0":
        from stages.fusion.open3d_voxels import Open3DVolume

        return Open3DVolume(
            plan.voxel_size,
            plan.truncation,
            plan.limits.max_depth,
            color=color,
            blocks=plan.blocks,
            max_bytes=max_bytes,
            device=device,
        )
    return Volume(
        plan.voxel_size,
        plan.truncation,
        plan.weighing,
        color=color,
        max_bytes=max_bytes,
        threads=threads,
    )


def _alone(frame: Frame, plan: Plan, factor: int, *, color: bool) -> Fused:
    """Join the pixels of a frame that no other fills up."""
    view = read_whole(frame, plan.limits)
    here = plan.fused(view)
    image = read_matching_color(frame, view.surface.depth) if color else None
    mesh = cut(relief(view, here, image, plan.voxel_size, plan.limits), plan.crop)
    if len(mesh.triangles) == 0:
        raise InputError(
            f"no surface came out of the frame{_of(plan.crop, int(here.sum()))}. Check the depth scale and "
            "the calibration.",
            f"frame {frame.name}",
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
        pixels_used=int(here.sum()) / view.valid,
        volume_bytes=0,
        device="CPU:0",
        crop=plan.crop,
        support=plan.support,
        outside=0,
        warnings=plan.warnings,
        upsampled=factor,
    )


def _of(crop: Crop, points: int) -> str:
    return f" inside {crop}, from {points:,} points there" if crop else ""


def _device(params: FuseParams) -> str:
    wanted = params.device
    if params.backend == "own":
        if wanted == "cuda":
            raise UsageError("device is 'cuda', which backend 'own' knows nothing of; choose open3d or auto.")
        return "CPU:0"
    if wanted != "cpu" and open3d().core.cuda.is_available():
        return "CUDA:0"
    if wanted == "cuda":
        raise UsageError("device is 'cuda', but Open3D finds no CUDA device; choose cpu or auto.")
    return "CPU:0"


def _require_usable(frames: Sequence[Frame], where: Path | None) -> None:
    if not frames:
        raise InputError("there are no frames to fuse.", where)
    if all(frame.world_from_camera is None for frame in frames):
        raise InputError(
            f"none of the {len(frames)} frames has a camera pose; fusion needs the pose of each "
            "(world_from_camera).",
            where,
        )
    if all(frame.depth is None for frame in frames):
        raise InputError(
            f"none of the {len(frames)} frames has a depth map; compute depth from stereo pairs first.", where
        )


def _least_weight(typical: float, frames: Sequence[Frame]) -> int:
    """Return how many frames must have seen a surface, from how many saw the median voxel."""
    least = int(np.clip(round(typical / 2), 1, 3))
    # A masked thing is seen from all around, each side by a few frames, and the plate below it by all.
    is_masked = all(frame.mask is not None for frame in frames)
    return min(least, max(len(frames) // 4, 1)) if is_masked else least


def _require_share(skipped: Sequence[SkippedFrame], count: int, share: float, where: Path | None) -> None:
    if len(skipped) > share * count:
        raise InputError(
            f"{len(skipped)} of {count} frames cannot be used; at most {share:.0%} may be bad "
            f"(max_bad_share). The first: {skipped[0].reason}",
            where,
        )
