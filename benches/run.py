"""Cost of a whole run by stage, beside an earlier version.

    python benches/run.py DATA [--only NAME ...] [--write FILE] [--before FILE]

Runs the samples and three public scans of DATA with default parameters, each without a cache in a process of
its own. Prints a Markdown table of wall time, processor time of all threads, peak memory, and the size of the
files that a stage places in the output folder. `--write` stores the costs. `--before` reads the costs that an
earlier version stored, and adds the ratios to them; ratios above 1.2 are bold. `total` includes reading the
scan and writing the page, and its processor time also the imports.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from markdown_tables import print_head, print_row

from scanloom.pipeline.config import Config
from scanloom.pipeline.run.events import RunEvent, StageFinished
from scanloom.pipeline.run.run import run

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
    options = parser.parse_args()
    scans = [SAMPLES / "rgbd", SAMPLES / "stereo", *(options.data / name for name in PUBLIC)]
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
        if options.only and scan.name not in options.only:
            continue
        # A process of its own, because the peak memory and the imports of a process are counted once.
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            costs[scan.name] = pool.submit(measure_run, scan).result()
        for stage, cost in costs[scan.name].items():
            before = None if earlier is None else earlier.get(scan.name, {}).get(stage, {})
            print_row([scan.name, stage, *make_cells(cost, before)])
    if options.write is not None:
        options.write.write_text(json.dumps(costs, indent=1) + "\n")


if __name__ == "__main__":
    main()
