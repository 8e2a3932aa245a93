"""Batch of many scans: speedup by workers, and recovery from killed workers.

Small synthetic scans (RGB-D, four frames) are processed up to `simplify`: by one worker of one thread, by
two, and by two that are killed (`kill -9`) at random every few seconds and replaced. Half of the kills hit
the worker, the others the process that runs its job.

"finished twice" counts scans that were completed by two attempts. "same bytes" compares every result except
report.json with the results of one worker. Then all jobs of a long queue are claimed without being run.
Wall-clock seconds are unreliable on a busy machine; CPU seconds cover all processes of the workers.
"""

from __future__ import annotations

import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from markdown_tables import print_head, print_row

from scanloom.pipeline.batch.claims import Claims
from scanloom.pipeline.batch.heartbeat import HeartbeatObserver
from scanloom.pipeline.batch.job_queue import BatchSettings, Job, create_queue, read_current_queue
from scanloom.pipeline.batch.job_records import JobRecords
from scanloom.pipeline.batch.job_scheduler import JobScheduler
from scanloom.pipeline.cache.digest import compute_file_digest

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests" / "made")]

from small_scans import write_small_scans  # noqa: E402

SCANLOOM = [sys.executable, "-m", "scanloom.cli.app"]
WORKER = [*SCANLOOM, "worker", "--quiet", "--jobs", "1", "--set", "worker.threads=1"]
# Range of seconds between two kills.
MIN_KILL_INTERVAL_S, MAX_KILL_INTERVAL_S = 2.0, 6.0
IGNORED_FILES = {"report.json"}


def run_batch_bench(scans: int, jobs: int, seed: int) -> None:
    """Print the table of `run_batch_bench` and the time per claim."""
    with tempfile.TemporaryDirectory() as folder:
        made = write_small_scans(Path(folder) / "scans", scans)
        print_head(("scans", "workers", "kills", "wall", "CPU", "speedup", "same bytes", "finished twice"), 0)
        scan_count = f"{scans:,}"
        wall, cpu, one = run_workers(made, Path(folder) / "one", 1)
        print_row(
            (scan_count, "1", "0", f"{wall:.0f} s", f"{cpu:.0f} s", "", "", f"{count_repeated_jobs(one)}")
        )
        results = compute_digests(one)
        shorter, cpu, two = run_workers(made, Path(folder) / "two", 2)
        faster = f"{wall / shorter:.2f}×"
        compared = compare_results(results, two)
        print_row(
            (
                scan_count,
                "2",
                "0",
                f"{shorter:.0f} s",
                f"{cpu:.0f} s",
                faster,
                compared,
                f"{count_repeated_jobs(two)}",
            )
        )
        longer, kills, killed = run_killed_workers(made, Path(folder) / "killed", seed)
        compared = compare_results(results, killed)
        print_row(
            (
                scan_count,
                "2",
                f"{kills}",
                f"{longer:.0f} s",
                "",
                "",
                compared,
                f"{count_repeated_jobs(killed)}",
            )
        )
        print(
            f"\n{jobs:,} jobs in a queue: {measure_claim_ms(Path(folder) / 'queue', jobs):.3f} ms per claim"
        )


def write_queue(scans: Path, out: Path) -> Path:
    """Write the queue of a batch; return its folder."""
    words = [
        "batch",
        scans,
        "-o",
        out,
        "--queue-only",
        "--until",
        "simplify",
        "--set",
        "worker.worker_timeout=2",
    ]
    subprocess.run([*SCANLOOM, *map(str, words), "--quiet"], check=True, stdout=subprocess.DEVNULL)
    return out


def run_workers(scans: Path, out: Path, workers: int) -> tuple[float, float, Path]:
    """Process a batch with several workers.

    Returns wall seconds, CPU seconds, and the output folder.
    """
    write_queue(scans, out)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    started = time.perf_counter()
    running = [start_worker(out) for _ in range(workers)]
    codes = [one.wait() for one in running]
    assert codes == [0] * workers, codes
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - started, cpu, out


def run_killed_workers(scans: Path, out: Path, seed: int) -> tuple[float, int, Path]:
    """Process a batch with two workers that are killed and replaced.

    Returns wall seconds, number of kills, and the output folder.
    """
    write_queue(scans, out)
    drawn = random.Random(seed)
    started = time.perf_counter()
    running = [start_worker(out) for _ in range(2)]
    kills = 0
    while any(one.poll() is None for one in running):
        time.sleep(drawn.uniform(MIN_KILL_INTERVAL_S, MAX_KILL_INTERVAL_S))
        at = drawn.randrange(2)
        if running[at].poll() is not None:
            continue
        job = list_children(running[at].pid)
        victim = job[0] if job and drawn.random() < 0.5 else running[at].pid
        try:
            os.kill(victim, signal.SIGKILL)
        except ProcessLookupError:
            continue
        kills += 1
        if victim == running[at].pid:
            running[at].wait()
            running[at] = start_worker(out)
    return time.perf_counter() - started, kills, out


def start_worker(out: Path) -> subprocess.Popen[bytes]:
    """Start a worker process."""
    return subprocess.Popen([*WORKER, str(out)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def list_children(process: int) -> list[int]:
    """List the child processes of a process."""
    path = Path(f"/proc/{process}/task/{process}/children")
    return [int(word) for word in path.read_text().split()] if path.exists() else []


def compute_digests(out: Path) -> dict[str, str]:
    """Compute the digest of every result, by path."""
    files = [
        path for path in sorted(out.glob("scan-*/*")) if path.is_file() and path.name not in IGNORED_FILES
    ]
    return {path.relative_to(out).as_posix(): compute_file_digest(path) for path in files}


def compare_results(expected: dict[str, str], out: Path) -> str:
    """Compare the results in a folder with expected digests; format the outcome."""
    found = compute_digests(out)
    differ = sum(found.get(name) != content for name, content in expected.items()) + len(
        found.keys() - expected
    )
    return f"all of {len(expected):,}" if differ == 0 else f"{differ} differ of {len(expected):,}"


def count_repeated_jobs(out: Path) -> int:
    """Count jobs that were completed more than once."""
    queue = read_current_queue(out)
    assert queue is not None
    ends = Counter(claim.number for claim in JobRecords(queue.folder / "done").list_finished())
    assert len(ends) == len(queue.jobs)
    return sum(count > 1 for count in ends.values())


def measure_claim_ms(out: Path, jobs: int) -> float:
    """Measure the CPU milliseconds per claim in a queue of `jobs` jobs."""
    queue = create_queue(out, 1, BatchSettings(""), [Job(k, f"../scans/{k}", f"{k}") for k in range(jobs)])
    assert queue is not None
    started = time.process_time()
    standing = read_current_queue(out)
    assert standing is not None
    claims = Claims(standing.folder / "claims", "bench")
    records, watch = JobRecords(standing.folder / "done"), HeartbeatObserver(standing.folder / "workers")
    supply = JobScheduler(standing, claims, records, watch, 60.0)
    numbers = [claim.number for claim in iter(supply.take_next, None)]
    assert numbers == list(range(jobs))
    return 1e3 * (time.process_time() - started) / jobs


def add_to(commands: Any) -> None:
    """Add the command `run_batch_bench` to a parser."""
    parser = commands.add_parser("batch", description=__doc__)
    parser.add_argument("--scans", type=int, default=1000)
    parser.add_argument("--jobs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=3)
    parser.set_defaults(bench=run_batch_bench)
