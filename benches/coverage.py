"""Cost and validity of `coverage`.

    python benches/coverage.py SCAN [--voxel-size 0.003]
    python benches/coverage.py SCAN --held-out
    python benches/coverage.py --again

The first form fuses and cleans the scan into a file. It prints CPU seconds of `coverage` before the second
frame, per frame and after the last frame, the peak memory, and the spread of frames about the surface (median
and 95th percentile). A mesh of more than 5 million triangles is processed twice, in memory and in chunks,
each in a separate process. "difference" is the largest relative difference of any metric.

The second form fuses every second frame. For each kind of thin evidence it measures the distance of the
surface along its normal according to the other frames (mean of at least three frames). Surface with thin
evidence should be farther off.

The third form starts from the first eight frames of the sample, all from one side. In three iterations it
adds a depth frame from each of the first three suggested viewpoints, simulated with the sensor model of the
sample.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from markdown_tables import print_head, print_row

from scanloom.stages.cleaning.chunked_clean import clean_chunked
from scanloom.stages.cleaning.clean import CleanParams, clean
from scanloom.stages.fusion.fuse import fuse, fuse_to_file
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.inspecting.coverage.coverage import coverage
from scanloom.stages.inspecting.coverage.defect_kinds import WEAK_KINDS
from scanloom.stages.inspecting.coverage.depth_view import read_view
from scanloom.stages.inspecting.coverage.measurement_evidence import measure_probes
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.scan import Frame, Scan
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.chunked_mesh import ChunkedMesh
from scanloom.stages.surface.chunked_ply import ChunkedPly, make_table_path
from scanloom.stages.surface.formats.ply import read_ply, write_ply

SAMPLES = Path(__file__).resolve().parents[1] / "samples"
START_FRAMES, VIEWPOINT_COUNT, ITERATIONS = 8, 3, 3
MIN_FRAMES = 3


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scan", type=Path, nargs="?")
    parser.add_argument("--voxel-size", type=float)
    parser.add_argument("--held-out", action="store_true")
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    words = parser.parse_args()
    if words.one:
        print(json.dumps(measure_cost(words.scan, Path(words.one[0]), chunked=words.one[1] == "chunks")))
    elif words.held_out:
        print_held_out_errors(words.scan)
    elif words.again:
        print_recapture()
    else:
        print_cost(words.scan, words.voxel_size)


def print_cost(scan: Path, voxel_size: float | None) -> None:
    """Print cost and metrics of `coverage`, in memory and in chunks.

    Only large meshes are also processed in chunks.
    """
    columns = "triangles", "frames", "start, s", "per frame, ms", "end, s", "peak memory, MB"
    print_head(["mesh", *columns, "spread median, mm", "spread 95 %, mm", "difference"])
    with tempfile.TemporaryDirectory() as folder:
        path = fuse_and_clean(scan, Path(folder), voxel_size)
        found = []
        for way in ("memory", "chunks") if make_table_path(path).exists() else ("memory",):
            words = [sys.executable, __file__, str(scan), "--one", str(path), way]
            outcome = json.loads(subprocess.run(words, check=True, capture_output=True).stdout)
            found.append(collect_numbers(outcome["metrics"]))
            apart = max(abs(a - b) / max(abs(b), 1e-12) for a, b in zip(found[-1], found[0], strict=True))
            spread = (f"{1000 * outcome['metrics'][name]:.1f}" for name in ("spread_median_m", "spread_95_m"))
            print_row([way, *outcome["row"], *spread, f"{apart:.0e}"])


def fuse_and_clean(scan: Path, folder: Path, voxel_size: float | None) -> Path:
    """Fuse and clean a scan into a file, chunked if large."""
    fused, result = folder / "fused.ply", folder / "clean.ply"
    fuse_to_file(read_scan(scan), FuseParams(voxel_size=voxel_size), fused)
    if make_table_path(fused).exists():
        clean_chunked(fused, result, CleanParams())
    else:
        write_ply(result, clean(read_ply(fused)).mesh)
    return result


def measure_cost(folder: Path, path: Path, *, chunked: bool) -> dict[str, Any]:
    """Run `coverage` on one mesh; return its metrics and table cells."""
    scan, times = read_scan(folder), [time.process_time()]

    def record_time(done: int, of: int) -> None:
        if done in (1, of):
            times.append(time.process_time())

    mesh = ChunkedMesh(ChunkedPly(path)) if chunked else read_ply(path)
    found = coverage(mesh, scan, progress=record_time)
    times.append(time.process_time())
    frame = (times[2] - times[1]) / (len(scan.frames) - 1)
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000
    row = [
        f"{found.surface_coverage.surface.triangle_count:,}",
        f"{found.frame_count}",
        f"{times[1] - times[0]:.1f}",
    ]
    row += [f"{1000 * frame:.0f}", f"{times[3] - times[2]:.1f}", f"{peak_mb:.0f}"]
    return {"row": row, "metrics": found.to_dict()}


def collect_numbers(metrics: Any) -> list[float]:
    """Collect all numbers of nested metrics."""
    if isinstance(metrics, dict):
        return [number for value in metrics.values() for number in collect_numbers(value)]
    if isinstance(metrics, list):
        return [number for value in metrics for number in collect_numbers(value)]
    return [float(metrics)] if isinstance(metrics, (int, float)) else []


def print_held_out_errors(folder: Path) -> None:
    """Print surface error according to held-out frames, by kind of evidence."""
    frames = read_scan(folder).frames
    mesh = clean(fuse(frames[::2]).mesh).mesh
    found = coverage(mesh, frames[::2])
    known = found.surface_coverage
    probes, origin = known.probes, known.surface.box.mean(axis=0)
    count, height = np.zeros(len(probes.keys)), np.zeros(len(probes.keys))
    for frame in frames[1::2]:
        measured = measure_probes(read_view(frame, origin), probes, origin, probes.grid.cube_size)
        count[measured.probe_indices] += 1
        height[measured.probe_indices] += measured.heights
    (asked,) = np.nonzero((count >= MIN_FRAMES) & (known.evidence.frame_counts[:-1] > 0))
    off, kinds = 1000 * np.abs(height[asked] / count[asked]), known.kinds[asked]
    print_head(["evidence", "ratio of points", "distance median, mm", "distance 95 %, mm"])
    for number, name in enumerate(("well observed", *WEAK_KINDS), -1):
        if (kinds == number).any():
            some = off[kinds == number]
            median, most = np.percentile(some, (50, 95))
            print_row([name, f"{len(some) / len(off):.1%}", f"{median:.1f}", f"{most:.1f}"])


def print_recapture() -> None:
    """Print the missing area before and after capturing from suggested viewpoints."""
    sys.path.insert(0, str(SAMPLES))
    from scene import Scene
    from sensors import measure_depth

    scan, scene, rng = read_scan(SAMPLES / "rgbd"), Scene(), np.random.default_rng(1)
    frames = [replace(one, color=None, depth=read_depth(one)) for one in scan.frames[:START_FRAMES]]
    print_head(["frames", "hole, m²", "hidden, m²", "total, m²"], words=0)
    for time_ in range(ITERATIONS + 1):
        found = coverage(clean(fuse(frames).mesh).mesh, Scan("again", tuple(frames)))
        hole, hidden = (found.missing_areas[kind] for kind in ("hole", "hidden"))
        print_row([f"{len(frames)}", f"{hole:.3f}", f"{hidden:.3f}", f"{hole + hidden:.3f}"])
        for number, place in enumerate(found.defects[:VIEWPOINT_COUNT]):
            pose = make_level_pose(np.array(place.viewpoint.position), np.array(place.viewpoint.direction))
            depth = measure_depth(scene, frames[0].camera, pose, rng).astype(np.float32) / 1000
            frames.append(Frame(f"{time_}-{number}", frames[0].camera, depth=depth, world_from_camera=pose))


def make_level_pose(eye: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """Make the pose (4, 4) of a level camera, z up."""
    right = np.cross(forward, (0, 0, 1) if abs(forward[2]) < 0.99 else (0, 1, 0))
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(forward, right), forward, eye], axis=1)
    return pose


if __name__ == "__main__":
    main()
