"""Estimate of the resources that fusion needs, from its sampled frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from scanloom.stages.fusion.plan import Plan
from scanloom.stages.fusion.voxels import block_bytes
from scanloom.stages.printing import by_fields
from scanloom.stages.scans.model.scan import Frame

# Bytes on disk per fused triangle, over all artifacts: meshes after each stage, records, images.
_DISK_BYTES = 130


@dataclass(frozen=True)
class Outlook:
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

    __repr__ = by_fields


def outlook(frames: Sequence[Frame], plan: Plan) -> Outlook:
    """Estimate the resources that fusion needs from its plan."""
    color = any(frame.color is not None for frame in frames)
    return Outlook(
        voxel_size_m=plan.voxel_size,
        volume_mb=plan.blocks * block_bytes(color=color) / 1e6,
        triangles=plan.triangles,
        disk_mb=plan.triangles * _DISK_BYTES / 1e6,
    )
