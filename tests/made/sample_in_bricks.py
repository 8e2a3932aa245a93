"""The sample scan fused in bricks: a PLY file in pieces."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from stages.fusion.fuse import fuse_to_file
from stages.fusion.params import FuseParams
from stages.scans.read import read_scan

_SAMPLE = Path(__file__).resolve().parents[2] / "samples" / "rgbd"


def sample_in_bricks(path: Path) -> Path:
    """Fuse every fourth frame of the sample into a PLY file in pieces, and return its path."""
    scan = read_scan(_SAMPLE)
    params = FuseParams(voxel_size=0.015, brick_size=0.3)
    fuse_to_file(replace(scan, frames=scan.frames[::4]), params, path)
    return path
