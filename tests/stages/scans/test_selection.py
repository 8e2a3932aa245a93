"""Selection of frames: limited in number, evenly spread, if neighbours need not overlap."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.scan import Camera, Frame
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

CAMERA = Camera(32, 24, 100.0, 100.0, 16.0, 12.0)
COUNT = 24


def write(folder: Path, tiny, *, posed: bool = True, depth: bool = True) -> Path:
    frames = []
    for k in range(COUNT):
        name = f"{k:04d}.png"
        tiny.color(folder / "color" / name)
        tiny.depth(folder / "depth" / name, 1000)
        pose = np.eye(4)
        pose[0, 3] = 0.01 * k
        frame = Frame(name, CAMERA, folder / "color" / name, world_from_camera=pose if posed else None)
        frames.append(replace(frame, depth=folder / "depth" / name) if depth else frame)
    write_scan_json(folder, frames)
    return folder


def read(folder: Path, **options: object) -> list[int]:
    scan = read_scan(folder, ScanParams(**options), complete=False)
    return [int(Path(frame.name).stem) for frame in scan.frames]


def test_frames_are_thinned_evenly_from_the_first_to_the_last(tiny, tmp_path):
    folder = write(tmp_path, tiny)
    assert read(folder, max_frames=2) == [0, 23]
    assert read(folder, max_frames=5) == [0, 5, 11, 17, 23]
    assert read(folder, max_frames=COUNT) == read(folder, max_frames=1000) == list(range(COUNT))
    assert read(folder, max_frames=3, first=4, last=20, every=2) == [4, 12, 20]
    for most in range(2, COUNT):
        chosen = read(folder, max_frames=most)
        assert len(chosen) == most
        assert np.ptp(np.diff(chosen)) <= 1


def test_some_of_those_that_are_used_are_held_out(tiny, tmp_path):
    scan = read_scan(write(tmp_path, tiny), ScanParams(max_frames=12, hold_out=4))
    assert (len(scan.frames), len(scan.held_out)) == (9, 3)


def test_where_neighbours_must_overlap_all_are_used(tiny, tmp_path):
    assert len(read(write(tmp_path / "a", tiny, posed=False), max_frames=5)) == COUNT
    scan = read_scan(write(tmp_path / "b", tiny, depth=False), ScanParams(max_frames=5), complete=False)
    assert scan.is_views
    assert len(scan.frames) == COUNT


def test_one_frame_is_no_scan_to_thin():
    with pytest.raises(UsageError, match="max_frames is 1 frames; it must be at least 2"):
        ScanParams(max_frames=1)
