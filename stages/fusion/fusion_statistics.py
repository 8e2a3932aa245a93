"""Statistics of a fusion."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.fusion.crop import Crop
from scanloom.stages.fusion.scene_statistics import DepthNoise
from scanloom.stages.fusion.support_plane import SupportPlane
from scanloom.stages.scans.model.scan import SkippedFrame
from scanloom.stages.surface.mesh import Mesh


@dataclass(frozen=True, eq=False)
class MeshStatistics:
    """Bounding box (two corners (3,), metres) and element counts of a mesh."""

    min_corner: NDArray[np.float64]
    max_corner: NDArray[np.float64]
    vertex_count: int
    triangle_count: int

    @classmethod
    def from_mesh(cls, mesh: Mesh) -> MeshStatistics:
        """Measure a mesh in memory."""
        vertices = mesh.vertices
        return cls(vertices.min(axis=0), vertices.max(axis=0), len(vertices), len(mesh.triangles))


@dataclass(frozen=True, eq=False, kw_only=True)
class FusionStatistics:
    """Statistics of a fusion.

    Attributes
    ----------
    voxel_size, truncation, max_depth : metres, as given or derived; truncation is 0 for a single frame, which
        is meshed without a volume.
    min_weight : minimum observation count of a voxel in frames, as given or derived.
    noise : depth noise measured between neighbouring frames.
    frames : number of fused frames.
    skipped : skipped frames, with reasons.
    pixels_valid : ratio of pixels with valid depth in the frames that were read.
    pixels_used : ratio of pixels that were fused, including bridged gaps of one pixel.
    volume_bytes : final memory of the volume; with bricks, of the largest volume.
    device : "CPU:0" or "CUDA:0".
    crop : region that was fused.
    support : support plane that was removed with everything below it; None if no plane was removed.
    outside : number of frames without a point inside the crop; not counted in `frames`.
    upsampled : upsampling factor of the depth maps; 1 if they were not upsampled.
    diagnostics : warnings of the fusion.
    """

    voxel_size: float
    truncation: float
    max_depth: float
    min_weight: int
    noise: DepthNoise
    frames: int
    skipped: tuple[SkippedFrame, ...]
    pixels_valid: float
    pixels_used: float
    volume_bytes: int
    device: str
    crop: Crop
    support: SupportPlane | None
    outside: int
    upsampled: int = 1
    diagnostics: tuple[Diagnostic, ...] = ()

    def to_field_dict(self) -> dict[str, Any]:
        """Return the fields of `FusionStatistics` without the fields of subclasses."""
        return {one.name: getattr(self, one.name) for one in fields(FusionStatistics)}

    def compute_metrics(self, mesh: MeshStatistics) -> dict[str, Any]:
        """Return JSON-ready metrics for the report, with units in the keys."""
        return {
            "voxel_size_m": self.voxel_size,
            "truncation_m": self.truncation,
            "max_depth_m": self.max_depth,
            "min_weight_frames": self.min_weight,
            "depth_upsampling_factor": self.upsampled,
            "depth_noise_constant_m": self.noise.constant,
            "depth_noise_quadratic_per_m": self.noise.quadratic,
            "frames_used": self.frames,
            "frames_used_ratio": self.frames / (self.frames + len(self.skipped)),
            "frames_skipped": [one.to_dict() for one in self.skipped],
            "pixels_valid_ratio": self.pixels_valid,
            "pixels_used_ratio": self.pixels_used,
            "volume_mb": self.volume_bytes / 1e6,
            "device": self.device,
            "crop": self._compute_crop_metrics() if self.crop else None,
            "lowest_m": mesh.min_corner.tolist(),
            "highest_m": mesh.max_corner.tolist(),
            "vertices": mesh.vertex_count,
            "triangles": mesh.triangle_count,
        }

    def _compute_crop_metrics(self) -> dict[str, Any]:
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
                "points_ratio": support.inlier_ratio,
                "margin_m": crop.height - support.offset_m,
            },
            "frames_outside": self.outside,
        }
