"""Cost of a whole run by stage, compared with an earlier version.

    python benches/run.py DATA [--only NAME ...] [--write FILE] [--before FILE] [--profile]

Runs the samples and three public scans of DATA with default parameters, each without a cache in a separate
process. Prints a Markdown table of wall time, processor time of all threads, peak memory, and the size of the
files that a stage places in the output folder. `--write` stores the costs. `--before` reads the costs that an
earlier version stored, and adds the ratios to them; ratios above 1.2 are bold. `total` includes reading the
scan and writing the page, and its processor time also the imports.

`--profile` prints the functions with the largest shares of a run on one thread instead.
"""

from __future__ import annotations

import argparse
import cProfile
import json
import os
import pstats
import re
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

from markdown_tables import print_head, print_row

from scanloom.pipeline.config import Config
from scanloom.pipeline.run.events import RunEvent, StageFinished
from scanloom.pipeline.run.run import run
from scanloom.stages.scans.model.threads import THREADS_VARIABLE

SAMPLES = Path(__file__).parents[1] / "samples"
PUBLIC = ("rgbd/7scenes_redkitchen", "rgbd/tabletop_box_realsense", "stereo/kitti_sequence_1")
# Kinds of cost: key in the file, head of the column, and format.
KINDS = (
    ("wall_s", "wall s", ".1f"),
    ("cpu_s", "CPU s", ".1f"),
    ("peak_mb", "MB", ".0f"),
    ("bytes", "bytes", ",.0f"),
)
MAX_RATIO = 1.2
# Smallest share that `--profile` prints.
MIN_SHARE = 0.01
T = TypeVar("T")

Cost = dict[str, float]


def measure_run(scan: Path) -> dict[str, Cost]:
    """Run a scan; return the cost of each stage and of the whole run."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        times = [(time.perf_counter(), time.process_time())]
        costs: dict[str, Cost] = {}

        def record(event: RunEvent) -> None:
            if isinstance(event, StageFinished):
                now = (time.perf_counter(), time.process_time())
                wall, cpu = (end - start for start, end in zip(times[-1], now, strict=True))
                times.append(now)
                costs[event.stage] = {"wall_s": wall, "cpu_s": cpu, "bytes": measure_bytes(event.results)}

        report = run(scan, out, Config(), events=record).report
        for stage, cost in costs.items():
            cost["peak_mb"] = report["stages"][stage]["peak_memory_mb"]
        costs["total"] = {
            "wall_s": time.perf_counter() - times[0][0],
            "cpu_s": time.process_time(),
            "peak_mb": max(cost["peak_mb"] for cost in costs.values()),
            "bytes": measure_bytes([one for one in out.iterdir() if one.name != "cache"]),
        }
    return costs


def profile_run(scan: Path) -> list[tuple[str, str, float]]:
    """Run a scan on one thread; return stage, function, and share of the seconds, in descending order."""
    os.environ[THREADS_VARIABLE] = "1"
    profiles = [cProfile.Profile()]
    names: list[str] = []

    def change_profile(event: RunEvent) -> None:
        if isinstance(event, StageFinished):
            profiles[-1].disable()
            names.append(event.stage)
            profiles.append(cProfile.Profile())
            profiles[-1].enable()

    with tempfile.TemporaryDirectory() as folder:
        profiles[0].enable()
        run(scan, Path(folder) / "out", Config(), events=change_profile)
        profiles[-1].disable()
    rows = [
        (stage, name_function(*key), values[2])
        for stage, profile in zip([*names, "page"], profiles, strict=True)
        for key, values in pstats.Stats(profile).stats.items()  # type: ignore[attr-defined]
    ]
    total = sum(seconds for *_, seconds in rows)
    return sorted(((stage, name, seconds / total) for stage, name, seconds in rows), key=lambda row: -row[2])


def name_function(file: str, _line: int, name: str) -> str:
    """Shorten the name of a profiled function."""
    if method := re.match(r"<method '(\w+)' of '(?:.*\.)?(\w+)' objects>", name):
        return f"{method[2]}.{method[1]}"
    if function := re.match(r"<built-in method (?:.*\.)?(\w+)>", name):
        return function[1]
    return name.strip("<>") if file == "~" else f"{Path(file).stem}.{name}"


def print_profiles(scans: Sequence[Path]) -> None:
    """Print the shares of each scan."""
    print_head(["scan", "stage", "function", "share of the run"], words=3)
    for scan in scans:
        for stage, name, share in run_alone(profile_run, scan):
            if share >= MIN_SHARE:
                print_row([scan.name, stage, f"`{name}`", f"{share:.1%}"])


def run_alone(measure: Callable[[Path], T], scan: Path) -> T:
    """Measure in a separate process: the peak memory and the imports of a process are counted once."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(measure, scan).result()


def measure_bytes(files: list[Path] | tuple[Path, ...]) -> int:
    """Return the size of files and of the files in folders."""
    return sum(
        one.stat().st_size
        for path in files
        for one in (path.rglob("*") if path.is_dir() else [path])
        if one.is_file()
    )


def make_cells(cost: Cost, before: Cost | None) -> list[str]:
    """Format the costs, each followed by its ratio to an earlier cost."""
    cells = []
    for key, _, style in KINDS:
        cells.append(format(cost[key], style))
        if before is not None:
            ratio = cost[key] / before[key] if before.get(key) else None
            is_worse = ratio is not None and ratio > MAX_RATIO
            cells.append("–" if ratio is None else f"**{ratio:.2f}**" if is_worse else f"{ratio:.2f}")
    return cells


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, metavar="DATA")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="names of scan folders")
    parser.add_argument("--write", type=Path, metavar="FILE", help="JSON file for the costs")
    parser.add_argument("--before", type=Path, metavar="FILE", help="costs of an earlier version")
    parser.add_argument("--profile", action="store_true", help="print the shares of functions")
    options = parser.parse_args()
    scans = [SAMPLES / "rgbd", SAMPLES / "stereo", *(options.data / name for name in PUBLIC)]
    scans = [scan for scan in scans if not options.only or scan.name in options.only]
    if options.profile:
        print_profiles(scans)
        return
    earlier = None if options.before is None else json.loads(options.before.read_text())
    costs = {}
    print_head(
        [
            "scan",
            "stage",
            *(word for _, head, _ in KINDS for word in ([head] if earlier is None else [head, "ratio"])),
        ],
        words=2,
    )
    for scan in scans:
        costs[scan.name] = run_alone(measure_run, scan)
        for stage, cost in costs[scan.name].items():
            before = None if earlier is None else earlier.get(scan.name, {}).get(stage, {})
            print_row([scan.name, stage, *make_cells(cost, before)])
    if options.write is not None:
        options.write.write_text(json.dumps(costs, indent=1) + "\n")


if __name__ == "__main__":
    main()
