"""Workers finish every scan despite bad scans, killed job processes and killed workers."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from scanloom.pipeline.batch.claims import CRASHED, KILLED, RELEASED, Claim, Claims
from scanloom.pipeline.batch.job_queue import BatchQueue
from scanloom.pipeline.batch.job_records import DONE, FAILED, UNUSABLE, JobRecord, JobRecords
from scanloom.pipeline.batch.summary import summarize_batch
from scanloom.pipeline.batch.worker import Worker
from scanloom.pipeline.batch.worker_events import (
    JobEnded,
    JobProgress,
    JobStarted,
    QueueProgress,
    WorkerEvent,
)
from scanloom.pipeline.config import Config
from scanloom.pipeline.run.run import run
from scanloom.stages.diagnostics.errors import StageError

pytestmark = pytest.mark.slow
Begin = Callable[..., BatchQueue]


def run_worker(queue: BatchQueue, **how: Any) -> dict[str, JobRecord]:
    how = {"slots": 1, "threads": 1, **how}
    Worker(queue, **how).run()
    summary = summarize_batch(queue)
    assert summary.is_finished
    return {one.name: one for one in summary.records}


def read_meshes(out: Path) -> dict[str, bytes]:
    """Read the meshes of a run by file name; repeated runs give identical bytes."""
    return {path.name: path.read_bytes() for path in sorted(out.glob("*.ply"))}


def get_job_pid(worker: Worker) -> int:
    (process,) = [slot.process for slot in worker._slots if slot.process is not None]
    return process._process.pid


def test_a_bad_scan_does_not_affect_other_scans(small_scans: Path, queue_of: Begin, tmp_path: Path):
    events: list[WorkerEvent] = []
    ended = run_worker(queue_of(small_scans, until="clean"), slots=2, on_event=events.append)
    states = {name: one.state for name, one in ended.items()}
    assert states == {"broken": UNUSABLE, **{f"scan-{k}": DONE for k in range(4)}}
    assert "scan.json: the file is not valid JSON" in ended["broken"].reason
    assert ended["scan-1"].metrics["frames"] == 4
    assert sum(isinstance(one, JobEnded) for one in events) == 5
    assert [one for one in events if isinstance(one, QueueProgress)][-1] == QueueProgress(5, 5)

    # The results have the bytes and names of `run`.
    run(small_scans / "scan-2", tmp_path / "alone", Config(), until="clean")
    assert read_meshes(tmp_path / "out" / "scan-2") == read_meshes(tmp_path / "alone") != {}
    assert (tmp_path / "out" / "scan-2" / "report.json").is_file()
    assert not list((tmp_path / "out" / "cache" / "drafts").iterdir())


def test_a_scan_that_disappears_is_reported(small_scans: Path, queue_of: Begin, tmp_path: Path):
    shutil.copytree(small_scans, tmp_path / "scans")
    queue = queue_of(tmp_path / "scans")
    shutil.rmtree(tmp_path / "scans" / "scan-1")
    ended = run_worker(queue)
    assert ended["scan-1"].state == UNUSABLE
    assert ended["scan-1"].reason == f"{tmp_path / 'scans' / 'scan-1'}: the scan does not exist any more."
    assert [ended[f"scan-{k}"].state for k in (0, 2, 3)] == [DONE] * 3


def test_a_damaged_queue_line_is_a_failed_job(small_scans: Path, queue_of: Begin):
    from scanloom.pipeline.batch.job_queue import read_current_queue

    queue = queue_of(small_scans)
    path = queue.folder / "jobs.jsonl"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:2], lines[2].replace("scan-0", "scan-9"), *lines[3:]]) + "\n")
    damaged = read_current_queue(queue.out)
    assert damaged is not None
    ended = run_worker(damaged)
    assert ended["job 1"].state == FAILED
    assert "the line of this job is damaged; run the batch again" in ended["job 1"].reason
    assert [ended[f"scan-{k}"].state for k in (1, 2, 3)] == [DONE] * 3


@pytest.mark.parametrize(("sent", "noted"), [(signal.SIGKILL, KILLED), (signal.SIGSEGV, CRASHED)])
def test_a_job_whose_process_dies_is_repeated(
    small_scans: Path, queue_of: Begin, sent: signal.Signals, noted: str
):
    queue = queue_of(small_scans)
    begun: list[JobStarted] = []

    def tell(event: WorkerEvent) -> None:
        if isinstance(event, JobStarted):
            begun.append(event)
        if isinstance(event, JobProgress) and len(begun) == 2:
            os.kill(get_job_pid(worker), sent)

    worker = Worker(queue, slots=1, threads=1, on_event=tell)
    worker.run()
    # The event of the killed process does not count as an end of the job.
    assert [one.name for one in begun].count("scan-0") == 2
    records = {one.name: one for one in summarize_batch(queue).records}
    assert (records["scan-0"].state, records["scan-0"].attempt) == (DONE, 1)
    assert Claims(queue.folder / "claims", "").read_claim(Claim(1, 0)).end == noted


def test_a_job_that_crashes_repeatedly_is_given_up(small_scans: Path, queue_of: Begin):
    queue = queue_of(small_scans)
    at = ""

    def tell(event: WorkerEvent) -> None:
        nonlocal at
        at = event.name if isinstance(event, JobStarted) else at
        if isinstance(event, JobProgress) and at == "scan-2":
            os.kill(get_job_pid(worker), signal.SIGSEGV)

    worker = Worker(queue, slots=1, threads=1, on_event=tell)
    worker.run()
    states = {one.name: one.state for one in summarize_batch(queue).records}
    assert states == {"broken": UNUSABLE, "scan-0": DONE, "scan-1": DONE, "scan-2": FAILED, "scan-3": DONE}
    reason = next(one.reason for one in summarize_batch(queue).records if one.name == "scan-2")
    assert reason.startswith("the process of this scan crashed 2 times")


def test_an_interrupted_worker_releases_its_job(small_scans: Path, queue_of: Begin, tmp_path: Path):
    queue = queue_of(small_scans, until="clean")

    def interrupt(event: WorkerEvent) -> None:
        if isinstance(event, JobProgress) and event.stage == "fuse":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Worker(queue, slots=1, threads=1, on_event=interrupt).run()
    # Job 0 is `broken`.
    assert Claims(queue.folder / "claims", "").read_claim(Claim(1, 0)).end == RELEASED
    started = time.monotonic()
    ended = run_worker(queue)
    assert time.monotonic() - started < 50, "an ended worker is not waited for"
    assert (ended["scan-0"].state, ended["scan-0"].attempt) == (DONE, 1)
    assert ended["scan-0"].metrics["stages_cached"] >= 1
    assert not list((tmp_path / "out" / "cache" / "drafts").iterdir())


def test_a_full_disk_stops_the_worker_with_one_error(
    small_scans: Path, queue_of: Begin, monkeypatch: pytest.MonkeyPatch
):
    queue = queue_of(small_scans)
    with monkeypatch.context() as patched:
        patched.setattr(JobRecords, "write", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left")))
        with pytest.raises(
            StageError, match=r"the queue .* cannot be worked on: the disk is full; free disk space"
        ):
            Worker(queue, slots=1, threads=1).run()
    assert run_worker(queue)["scan-3"].state == DONE


def test_a_read_only_queue_is_reported(small_scans: Path, queue_of: Begin, monkeypatch: pytest.MonkeyPatch):
    queue = queue_of(small_scans)
    usual = os.open

    def read_only(path: Any, flags: int, *rest: Any, **more: Any) -> int:
        if flags & os.O_CREAT:
            raise OSError(30, "Read-only file system", str(path))
        return usual(path, flags, *rest, **more)

    monkeypatch.setattr("os.open", read_only)
    with pytest.raises(StageError, match=r"the queue .* cannot be worked on: Read-only file system"):
        Worker(queue, slots=1, threads=1).run()


def test_killed_workers_lose_no_scan(small_scans: Path, queue_of: Begin, tmp_path: Path):
    quiet = tmp_path / "quiet"
    for number in range(4):
        run(small_scans / f"scan-{number}", quiet / f"scan-{number}", Config(), until="clean")
    queue = queue_of(small_scans, until="clean", take_over_after=1.0)
    words = [
        sys.executable,
        "-m",
        "scanloom.cli.app",
        "worker",
        str(queue.out),
        "--jobs",
        "1",
        "--set",
        "worker.threads=1",
        "-q",
    ]

    def start_worker() -> subprocess.Popen[bytes]:
        return subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    draw, workers, kills = random.Random(3), [start_worker(), start_worker()], 0
    while any(one.poll() is None for one in workers):
        # Wait until a worker has reached a job.
        time.sleep(draw.uniform(0.5, 1.5))
        at = kills % 2
        if kills < 4 and workers[at].poll() is None and list((queue.folder / "claims").iterdir()):
            children = Path(f"/proc/{workers[at].pid}/task/{workers[at].pid}/children")
            jobs = children.read_text().split() if children.exists() else []
            os.kill(int(jobs[0]) if jobs and kills % 3 == 2 else workers[at].pid, signal.SIGKILL)
            kills += 1
            if not (jobs and (kills - 1) % 3 == 2):
                workers[at].wait()
                workers[at] = start_worker()
    assert kills >= 2
    assert all(one.returncode in (1, -9) for one in workers)  # The batch fails because `broken` is unusable.
    ends = Counter(claim.number for claim in JobRecords(queue.folder / "done").list_finished())
    assert sorted(ends) == [0, 1, 2, 3, 4]
    assert sum(count > 1 for count in ends.values()) <= kills
    for number in range(4):
        name = f"scan-{number}"
        assert read_meshes(queue.out / name) == read_meshes(quiet / name) != {}


def test_a_worker_that_does_not_wait_ends_when_no_job_is_free(small_scans: Path, queue_of: Begin):
    queue = queue_of(small_scans)
    claims = Claims(queue.folder / "claims", "other")
    assert claims.take(Claim(4, 0))
    Worker(queue, slots=1, threads=1, wait_for_others=False).run()
    states = {one.name: one.state for one in summarize_batch(queue).records}
    assert states["scan-3"] == "running"
    assert [states[f"scan-{k}"] for k in range(3)] == [DONE] * 3
