"""Estimate of the resources that fusion needs, from its sampled frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from scanloom.stages.fusion.fusion_plan import FusionPlan
from scanloom.stages.fusion.tsdf_volume import compute_block_bytes
from scanloom.stages.printing import format_by_fields
from scanloom.stages.scans.model.scan import Frame

# Bytes on disk per fused triangle, over all artifacts: meshes after each stage, records, images.
_DISK_BYTES_PER_TRIANGLE = 130


@dataclass(frozen=True)
class FusionEstimate:
    """Estimated resources of a run with default parameters.

    Estimates are within a factor of about two.

    Attributes
    ----------
    voxel_size_m : derived voxel size, metres.
    volume_mb : memory of the TSDF volume at the end of fusion, MB. Fusion stops if it exceeds `fuse.memory`.
    triangles : triangles of the fused mesh.
    disk_mb : disk space of all results and the cache, MB.
    """

    voxel_size_m: float
    volume_mb: float
    triangles: int
    disk_mb: float

    __repr__ = format_by_fields


def estimate_fusion(frames: Sequence[Frame], plan: FusionPlan) -> FusionEstimate:
    """Estimate the resources that fusion needs from its plan."""
    color = any(frame.color is not None for frame in frames)
    return FusionEstimate(
        voxel_size_m=plan.voxel_size,
        volume_mb=plan.block_count * compute_block_bytes(color=color) / 1e6,
        triangles=plan.triangle_count,
        disk_mb=plan.triangle_count * _DISK_BYTES_PER_TRIANGLE / 1e6,
    )
