"""What fusing a scan will take, before it is begun: estimated from the frames that fusion looks at first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from scanloom.stages.fusion.plan import Plan
from scanloom.stages.fusion.voxels import block_bytes
from scanloom.stages.printing import by_fields
from scanloom.stages.scans.model.scan import Frame

# What a run leaves behind for each triangle that is fused: meshes after each stage, records, pictures.
_DISK_BYTES = 130


@dataclass(frozen=True)
class Outlook:
    """What a run with the default parameters will need; good to a factor of about two.

    Attributes
    ----------
    voxel_size_m : metres, as fusion derives it.
    volume_mb : memory of the voxels at the end of fusion; fusion stops where it outgrows `fuse.memory`.
    triangles : of the fused mesh.
    disk_mb : of all results and the cache.
    """

    voxel_size_m: float
    volume_mb: float
    triangles: int
    disk_mb: float

    __repr__ = by_fields


def outlook(frames: Sequence[Frame], plan: Plan) -> Outlook:
    """Estimate what fusing frames with depth and poses takes, from the plan of it."""
    color = any(frame.color is not None for frame in frames)
    return Outlook(
        voxel_size_m=plan.voxel_size,
        volume_mb=plan.blocks * block_bytes(color=color) / 1e6,
        triangles=plan.triangles,
        disk_mb=plan.triangles * _DISK_BYTES / 1e6,
    )
