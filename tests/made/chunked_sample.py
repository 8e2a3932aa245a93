"""Sample scan fused into a chunked PLY file, as large meshes are."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from scanloom.stages.fusion import fused_mesh_files
from scanloom.stages.fusion.fuse import fuse_to_file
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface import chunk_partition, chunked_ply

_SAMPLE = Path(__file__).resolve().parents[2] / "samples" / "rgbd"


@contextmanager
def use_small_chunks(max_in_memory: int = 3_000) -> Iterator[None]:
    """Treat meshes of more than `max_in_memory` triangles as large, with chunks of about 0.3 m."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(chunked_ply, "MAX_IN_MEMORY_TRIANGLES", max_in_memory)
        patch.setattr(fused_mesh_files, "CHUNK_SIZE_M", 0.3)
        patch.setattr(chunk_partition, "CHUNK_SIZE_M", 0.3)
        yield


def fuse_chunked_sample(path: Path) -> Path:
    """Fuse every fourth frame of the sample into a chunked mesh file."""
    scan = read_scan(_SAMPLE)
    with use_small_chunks():
        fuse_to_file(replace(scan, frames=scan.frames[::4]), FuseParams(voxel_size=0.015), path)
    return path


def write_partial_sample(folder: Path, numbers: list[int]) -> Path:
    """Write selected frames of the sample as a separate scan."""
    scan = read_scan(_SAMPLE)
    shutil.copytree(_SAMPLE, folder)
    frames = read_scan(folder).frames
    write_scan_json(folder, [frames[number] for number in numbers])
    assert len(read_scan(folder).frames) == len(numbers) < len(scan.frames)
    return folder
