"""Speed and accuracy of fusion, compared with Open3D's volumes.

python benches/fusion.py SCAN [--voxels 0.02 0.01 0.006] [--repeats 3] [--samples samples]

Prints Markdown. Times cover reading the files, integration and mesh extraction. Each run is a separate
process, because a process never returns its peak memory. The runs of all tools alternate and medians are
reported, because a machine's speed drifts. Open3D is imported before the clock starts by the tools that use
it.

The Open3D loops are the ones that users write: decode, touch, integrate, with the constants of Open3D's
documentation (16³ blocks, truncation of 8 voxels, weight over 3). Only the block count is reduced to fit in
memory.

With --samples (the folder of scans with known truth), a second table shows the distance to the truth with our
own volume and with Open3D's volume in the same stage. The last table shows by how many voxels the sides of
thin sheets are displaced outward.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages._open3d import import_open3d
from scanloom.stages.comparing.compare import compare
from scanloom.stages.fusion.fuse import fuse
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.stereo.depth import DepthMap, depth_scan
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import topology

sys.path[:0] = [str(Path(__file__).parents[1] / "tests" / "made")]

from thin_sheet import thin_sheet  # noqa: E402

MAX_DEPTH = 4.0


class RunTimes:
    """Start time of a fusion run, and the time when its volume is complete.

    Each time is a pair of wall-clock and CPU seconds.
    """

    def __init__(self) -> None:
        self.start_times = time.perf_counter(), time.process_time()
        self.volume_times = self.start_times

    def mark_volume(self) -> None:
        """Record the time at which the volume is complete."""
        self.volume_times = time.perf_counter(), time.process_time()


def fuse_scanloom(scan: Scan, voxel_size: float, times: RunTimes, backend: str = "own") -> Mesh:
    """Fuse as `scanloom run` does."""

    def record_progress(done: int, total: int) -> None:
        if done == total:
            times.mark_volume()

    found = fuse(scan, voxel_size=voxel_size, max_depth=MAX_DEPTH, backend=backend, progress=record_progress)
    return found.mesh


def fuse_scanloom_open3d(scan: Scan, voxel_size: float, times: RunTimes) -> Mesh:
    """Fuse as `scanloom run` does, with Open3D's volume as backend."""
    return fuse_scanloom(scan, voxel_size, times, "open3d")


def fuse_voxel_block_grid(scan: Scan, voxel_size: float, times: RunTimes) -> Mesh:
    """Fuse with Open3D's tensor volume, as in its documentation."""
    o3d = import_open3d()
    f32 = o3d.core.float32
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight", "color"), (f32,) * 3, ((1), (1), (3)), voxel_size, 16, 4000
    )
    for frame in scan.frames:
        depth = o3d.t.geometry.Image(o3d.core.Tensor(read_depth(frame)))
        color = o3d.t.geometry.Image(o3d.core.Tensor(read_color(frame).astype(np.float32) / 255))
        matrix, extrinsic = (
            o3d.core.Tensor(m) for m in (frame.camera.matrix, np.linalg.inv(frame.world_from_camera))
        )
        blocks = grid.compute_unique_block_coordinates(depth, matrix, extrinsic, 1.0, MAX_DEPTH)
        grid.integrate(blocks, depth, color, matrix, extrinsic, 1.0, MAX_DEPTH)
    times.mark_volume()
    mesh = grid.extract_triangle_mesh()
    return Mesh(mesh.vertex.positions.numpy().astype(float), mesh.triangle.indices.numpy())


def fuse_legacy(scan: Scan, voxel_size: float, times: RunTimes) -> Mesh:
    """Fuse with Open3D's legacy volume, whose mesh is empty in Open3D 0.20.0."""
    o3d = import_open3d()
    volume = o3d.pipelines.integration.ScalableTSDFVolume(
        voxel_size, 4 * voxel_size, o3d.pipelines.integration.TSDFVolumeColorType.RGB8
    )
    for frame in scan.frames:
        image = o3d.geometry.RGBDImage.create_from_color_and_depth(
            o3d.geometry.Image(read_color(frame)),
            o3d.geometry.Image(read_depth(frame)),
            depth_scale=1.0,
            depth_trunc=MAX_DEPTH,
            convert_rgb_to_intensity=False,
        )
        camera = o3d.camera.PinholeCameraIntrinsic(
            frame.camera.width, frame.camera.height, frame.camera.matrix
        )
        volume.integrate(image, camera, np.linalg.inv(frame.world_from_camera))
    times.mark_volume()
    mesh = volume.extract_triangle_mesh()
    return Mesh(np.asarray(mesh.vertices), np.asarray(mesh.triangles))


TOOLS: dict[str, Callable[[Scan, float, RunTimes], Mesh]] = {
    "scanloom": fuse_scanloom,
    "scanloom, `backend=open3d`": fuse_scanloom_open3d,
    "Open3D VoxelBlockGrid": fuse_voxel_block_grid,
    "Open3D ScalableTSDFVolume": fuse_legacy,
}


def run_tool(folder: Path, tool: str, voxel_size: float) -> dict[str, Any]:
    """Run one tool at one voxel size in this process.

    Returns frames per second, CPU seconds, seconds of mesh extraction, peak memory (MB) and counts of the
    mesh.
    """
    scan = read_scan(folder)
    if tool != "scanloom":
        import_open3d()
    laps = RunTimes()
    mesh = TOOLS[tool](scan, voxel_size, laps)
    end = time.perf_counter()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    found = topology(mesh) if len(mesh.triangles) else None
    return {
        "rate": len(scan.frames) / (laps.volume_times[0] - laps.start_times[0]),
        "processor": laps.volume_times[1] - laps.start_times[1],
        "extraction": end - laps.volume_times[0],
        "peak": peak,
        "triangles": len(mesh.triangles),
        "nonmanifold": found.nonmanifold_edges if found else 0,
        "components": found.components if found else 0,
    }


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scan", type=Path)
    parser.add_argument("--voxels", type=float, nargs="+", default=[0.02, 0.01, 0.006], help="metres")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--samples", type=Path, help="folder of sample scans with truth.ply")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(run_tool(options.scan, options.one, options.voxels[0])))
        return
    print(f"Open3D {import_open3d().__version__}, {len(read_scan(options.scan).frames)} frames\n")
    print("| voxel | tool | frames/s | CPU s | mesh s | MB | triangles | components | non-manifold edges |")
    print("|---|---|---|---|---|---|---|---|---|")
    for voxel in options.voxels:
        runs_by_tool: dict[str, list[dict[str, Any]]] = {name: [] for name in TOOLS}
        for _ in range(options.repeats):
            for name, runs in runs_by_tool.items():
                command = [sys.executable, __file__, str(options.scan), "--voxels", str(voxel), "--one", name]
                runs.append(json.loads(subprocess.run(command, check=True, capture_output=True).stdout))
        for name, runs in runs_by_tool.items():
            r = {key: statistics.median(run[key] for run in runs) for key in runs[0]}
            print(
                f"| {voxel * 1000:g} mm | {name} | {r['rate']:.1f} | {r['processor']:.2f} "
                f"| {r['extraction']:.2f} | {r['peak']:.0f} | {r['triangles']:.0f} | {r['components']:.0f} "
                f"| {r['nonmanifold']:.0f} |",
                flush=True,
            )
    if options.samples:
        print_truth(options.samples)
    print_thin_sheets()


def print_thin_sheets() -> None:
    """Print the displacement of both sides of thin sheets, in voxels.

    Three frames see one side, twelve frames the other.
    """
    voxel = 0.01
    print("\n| sheet thickness, voxels | volume | side of 3 frames, voxels | side of 12 frames, voxels |")
    print("|---|---|---|---|")
    for thickness in (1.5, 2.0, 3.0, 4.0, 6.0):
        frames = [thin_sheet(-1, 0.02 * k, thickness * voxel, (200, 40, 30)) for k in range(3)]
        frames += [thin_sheet(1, 0.02 * k, thickness * voxel, (20, 60, 220)) for k in range(12)]
        for backend in ("own", "open3d"):
            mesh = fuse(frames, voxel_size=voxel, truncation=5 * voxel, min_weight=1, backend=backend).mesh
            inner = (np.abs(mesh.vertices[:, :2]).max(axis=1) < 0.18) & (np.abs(mesh.vertices[:, 2]) < 0.5)
            off = []
            for side in (-1, 1):
                z = side * mesh.vertices[inner & (side * mesh.vertices[:, 2] > 0), 2]
                off.append(f"{np.median(z) / voxel - thickness / 2:+.2f}" if len(z) else "missing")
            print(f"| {thickness:g} | {backend} | {off[0]} | {off[1]} |", flush=True)


def print_truth(samples: Path) -> None:
    """Print two-sided distances between fused samples and their true surface."""
    truth = read_ply(samples / "truth.ply")
    print("\n| sample | volume | mean mm | RMS mm | truth to mesh, mean mm | colour RMS | triangles |")
    print("|---|---|---|---|---|---|---|")
    for name in ("rgbd", "stereo"):
        scan = read_scan(samples / name)
        frames = (
            [frame for frame, found in depth_scan(scan) if isinstance(found, DepthMap)] if scan.rig else scan
        )
        for backend in ("own", "open3d"):
            mesh = fuse(frames, backend=backend).mesh
            found = compare(truth, mesh, samples=100_000)
            print(
                f"| {name} | {backend} | {found.b_to_a.mean * 1e3:.3f} | {found.b_to_a.rms * 1e3:.3f} "
                f"| {found.a_to_b.mean * 1e3:.2f} | {found.color_b_to_a.rmse:.1f} | {len(mesh.triangles)} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
