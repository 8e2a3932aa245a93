"""Out-of-core fusion of a synthetic building: time and memory by frames.

Makes the building (or uses --building FOLDER, written by `benches/building.py`) and fuses its first frames at
1 cm, in a separate process for each number of frames. The fusion is then repeated by runs that are killed
(`kill -9`) at random until one completes. The table shows the bricks reused from killed runs, and if the mesh
has the same bytes as the undisturbed one.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from building import make_building
from markdown_tables import print_head, print_row

from scanloom.pipeline.cache.digest import compute_file_digest
from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.reader import read_scan

SCANLOOM = [sys.executable, "-m", "scanloom.cli.app"]
VOXEL_SIZE = 0.01


def run_bricks_bench(
    building: Path | None,
    frames: list[int],
    killed: list[int],
    memory: float,
    seed: int,
    rooms: int,
    plot: Path | None,
) -> None:
    """Print the tables of `run_bricks_bench`."""
    with tempfile.TemporaryDirectory() as scratch:
        if building is None:
            building = Path(scratch) / "building"
            make_building(building, rooms, max(frames), os.cpu_count() or 1)
        print_head(("frames", "CPU", "CPU per frame", "peak memory", "bricks", "triangles"), 0)
        drawn, contents = [], {}
        for count in frames:
            scan = write_first_frames(building, Path(scratch) / f"scan-{count}", count)
            out, metrics, cpu = fuse_undisturbed(scan, Path(scratch) / f"quiet-{count}", memory)
            contents[count] = compute_file_digest(out / "fused.ply")
            made, peak = metrics["metrics"], metrics["peak_memory_mb"]
            drawn.append((count, 1000 * cpu / count, peak))
            of_mesh = f"{made['bricks']}", f"{made['triangles']:,}"
            print_row(
                (f"{count:,}", f"{cpu:.0f} s", f"{1000 * cpu / count:.1f} ms", f"{peak:.0f} MB", *of_mesh)
            )
            remove_results(out)
        print()
        print_head(("frames", "kills", "reused bricks", "same bytes"), 0)
        for count in killed:
            scan, out = Path(scratch) / f"scan-{count}", Path(scratch) / f"killed-{count}"
            kills, taken = fuse_with_kills(scan, out, memory, seed)
            same = "yes" if compute_file_digest(out / "fused.ply") == contents[count] else "NO"
            print_row((f"{count:,}", f"{kills}", f"{taken}", same))
            remove_results(out)
    if plot is not None:
        plot_costs(plot, drawn)


def remove_results(out: Path) -> None:
    """Remove results and their cache, which take gigabytes."""
    for folder in (out, Path(f"{out}-cache")):
        shutil.rmtree(folder)


def plot_costs(path: Path, measured: list[tuple[int, float, float]]) -> None:
    """Plot CPU time per frame (ms) and peak memory (MB)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 2.8), layout="constrained")
    frames, costs, peaks = zip(*measured, strict=True)
    for axes, values, label in zip(
        figure.subplots(1, 2), (costs, peaks), ("CPU per frame, ms", "peak memory, MB"), strict=True
    ):
        axes.plot(frames, values, "o-", color="#0072b2")
        axes.set(xscale="log", xlabel="frames", ylabel=label, ylim=(0, 1.2 * max(values)))
        axes.grid(visible=True, color="#dddddd")
    figure.savefig(path, dpi=150)


def write_first_frames(building: Path, folder: Path, count: int) -> Path:
    """Write a scan of a building's first frames, with linked images."""
    folder.mkdir()
    for kind in ("color", "depth"):
        (folder / kind).symlink_to(building / kind)
    written = []
    for frame in read_scan(building).frames[:count]:
        assert isinstance(frame.color, Path)
        assert isinstance(frame.depth, Path)
        color, depth = folder / "color" / frame.color.name, folder / "depth" / frame.depth.name
        written.append(replace(frame, color=color, depth=depth))
    write_scan_json(folder, written)
    return folder


def make_command(scan: Path, out: Path, memory: float) -> list[str]:
    """Make the command that fuses a scan in bricks.

    Each output folder gets a separate cache.
    """
    settings = (
        f"fuse.voxel_size={VOXEL_SIZE}",
        "fuse.brick_size=4",
        f"fuse.memory={memory}",
        "adjust.enabled=false",
    )
    sets = [word for setting in settings for word in ("--set", setting)]
    return [
        *SCANLOOM,
        "run",
        str(scan),
        "-o",
        str(out),
        "--set",
        f"run.cache={out}-cache",
        "--quiet",
        "--until",
        "fuse",
        *sets,
    ]


def fuse_undisturbed(scan: Path, out: Path, memory: float) -> tuple[Path, Any, float]:
    """Fuse a scan without disturbance.

    Returns the output folder, the stage's part of the report, and CPU seconds.
    """
    before = os.times()
    subprocess.run(make_command(scan, out, memory), check=True)
    after = os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return out, json.loads((out / "report.json").read_text())["stages"]["fuse"], cpu


def fuse_with_kills(scan: Path, out: Path, memory: float, seed: int) -> tuple[int, int]:
    """Fuse a scan by randomly killed runs, until one completes.

    Returns the number of kills and of bricks that the last run reused.
    """
    draw, kills, longest = random.Random(seed), 0, 4.0
    while True:
        run = subprocess.Popen(make_command(scan, out, memory))
        limit = draw.uniform(1.0, longest)
        started = time.monotonic()
        while run.poll() is None and time.monotonic() - started < limit:
            time.sleep(0.05)
        if run.poll() is not None:
            break
        os.kill(run.pid, signal.SIGKILL)
        run.wait()
        kills += 1
        # A growing limit makes sure that some run completes.
        longest *= 1.5
    metrics = json.loads((out / "report.json").read_text())["stages"]["fuse"]["metrics"]
    return kills, metrics["bricks"] - metrics["bricks_fused"]


def add_to(commands: Any) -> None:
    """Add the command `run_bricks_bench` to a parser."""
    parser = commands.add_parser("bricks", description=__doc__)
    parser.add_argument("--building", type=Path, help="made by benches/building.py")
    parser.add_argument("--frames", type=int, nargs="+", default=[100, 300, 1000, 3000, 10_000])
    parser.add_argument(
        "--killed", type=int, nargs="*", default=[1000], help="numbers of frames to repeat with kills"
    )
    parser.add_argument("--plot", type=Path, help="picture of the first table (requires the extra plot)")
    parser.add_argument("--memory", type=float, default=500, help="memory for voxels, MB")
    parser.add_argument("--rooms", type=int, default=50)
    parser.add_argument("--seed", type=int, default=3)
    parser.set_defaults(bench=run_bricks_bench)
