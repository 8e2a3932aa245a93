"""Hanging jobs do not block other jobs; a resumed worker leaves its job to the worker that took it over."""

from __future__ import annotations

import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from queue import SimpleQueue

import pytest
from hanging_jobs import is_any_alive, make_hanging_environment

from scanloom.pipeline.batch.claims import Claim, Claims
from scanloom.pipeline.batch.job_queue import BatchQueue, Job, create_queue
from scanloom.pipeline.batch.job_records import DONE, FAILED, UNUSABLE, JobRecords
from scanloom.pipeline.batch.process_handle import JobProcess
from scanloom.pipeline.batch.slot import RunningJob
from scanloom.pipeline.batch.summary import summarize_batch
from scanloom.pipeline.batch.worker import Worker
from scanloom.pipeline.batch.worker_events import JobEnded, JobProgress, Notice, WorkerEvent
from scanloom.pipeline.config import Config
from scanloom.pipeline.run.run import run
from scanloom.stages.diagnostics.errors import StageError

Begin = Callable[..., BatchQueue]
# Jobs that do not hang report progress in less time, even on a busy machine.
LONG = 300.0


class Clock:
    """Clock that jumps ahead on each call while a job hangs."""

    def __init__(self, has_hung: Callable[[], bool]) -> None:
        self._has_hung = has_hung
        self._ahead = 0.0

    def __call__(self) -> float:
        self._ahead += LONG if self._has_hung() else 0.0
        return time.monotonic() + self._ahead


def make_running_job() -> RunningJob:
    return RunningJob(Job(0, "x", "x"), Claim(0, 0))


def test_repeated_progress_does_not_reset_the_idle_time():
    one = make_running_job()
    for share in (0.0, 0.1, 0.1):
        one.add_idle_time(5.0)
        one.record_progress("fuse", share)
    assert one.idle_seconds == 5.0
    one.record_progress("clean", 0.1)
    assert one.idle_seconds == 0.0


def test_a_job_that_awaits_admission_is_not_idle():
    one = make_running_job()
    one.add_idle_time(5.0)
    one.is_awaiting_admission = True
    one.add_idle_time(1e6)
    assert one.idle_seconds == 0.0
    one.is_awaiting_admission = False
    one.add_idle_time(5.0)
    assert one.idle_seconds == 5.0


def test_progress_after_waiting_for_another_run_resets_the_idle_time():
    one = make_running_job()
    one.record_progress("fuse", 0.0)
    one.is_blocked = True
    one.add_idle_time(5.0)
    one.record_progress("fuse", 0.0)
    assert (one.idle_seconds, one.is_blocked) == (0.0, False)


def read_meshes(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(out.glob("*.ply"))}


@pytest.mark.slow
def test_a_process_that_cannot_be_killed_is_abandoned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    process = JobProcess(SimpleQueue(), 1, tmp_path / "log")
    os.kill(process._process.pid, signal.SIGSTOP)
    with monkeypatch.context() as patched:
        # Simulate a process blocked on a drive: signals are accepted without effect.
        patched.setattr("scanloom.pipeline.batch.process_handle._EXIT_TIMEOUT", 0.05)
        patched.setattr("os.killpg", lambda *_: None)
        assert not process.kill()
        process.end()
    assert process.kill()


@pytest.fixture
def _long_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scanloom.pipeline.batch.worker._MAX_TURN_SECONDS", math.inf)


@pytest.mark.slow
@pytest.mark.usefixtures("_long_turns")
def test_a_hanging_job_is_killed_with_its_children_and_other_jobs_continue(
    small_scans: Path, queue_of: Begin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    queue = queue_of(small_scans, until="clean")
    for name, value in make_hanging_environment(
        tmp_path / "hook", "scan-1/depth-2.png", "fuse", queue.cache
    ).items():
        monkeypatch.setenv(name, value)
    hung = tmp_path / "hook" / "hung"
    Worker(queue, slots=1, threads=1, timeout=LONG, clock=Clock(partial(is_any_alive, hung))).run()
    records = {one.name: one for one in summarize_batch(queue).records}
    states = {name: one.state for name, one in records.items()}
    assert states == {"broken": UNUSABLE, "scan-0": DONE, "scan-1": FAILED, "scan-2": DONE, "scan-3": DONE}
    assert records["scan-1"].reason.startswith(f"ended after {LONG:g} s without progress in fuse; check")
    assert hung.exists()
    assert not is_any_alive(hung)
    assert not list((queue.cache / "drafts").iterdir())

    # A new batch resumes from the cache and gives the same result as an undisturbed run.
    (tmp_path / "hook" / "sitecustomize.py").unlink()
    (scan,) = [one for one in queue.jobs if one.name == "scan-1"]
    again = create_queue(queue.out, 2, queue.settings, [replace(scan, number=0)])
    assert again is not None
    Worker(again, slots=1, threads=1).run()
    (record,) = summarize_batch(again).records
    assert (record.state, record.metrics["stages_cached"]) == (DONE, 1)
    run(small_scans / "scan-1", tmp_path / "quiet", Config(), until="clean")
    assert read_meshes(queue.out / "scan-1") == read_meshes(tmp_path / "quiet") != {}


@pytest.mark.slow
@pytest.mark.usefixtures("_long_turns")
def test_a_stopped_job_process_is_killed(small_scans: Path, queue_of: Begin):
    queue = queue_of(small_scans)
    stopped = False

    def tell(event: WorkerEvent) -> None:
        nonlocal stopped
        if isinstance(event, JobProgress) and event.name == "scan-1":
            (slot,) = worker._slots
            assert slot.process is not None
            os.kill(slot.process._process.pid, signal.SIGSTOP)
            stopped = True
        stopped = stopped and not isinstance(event, JobEnded)

    worker = Worker(queue, slots=1, threads=1, timeout=LONG, on_event=tell, clock=Clock(lambda: stopped))
    worker.run()
    records = {one.name: one for one in summarize_batch(queue).records}
    assert records["scan-1"].state == FAILED
    assert [records[f"scan-{k}"].state for k in (0, 2, 3)] == [DONE] * 3


@pytest.mark.slow
def test_a_resumed_worker_leaves_its_job_to_the_worker_that_took_it_over(
    small_scans: Path, queue_of: Begin, tmp_path: Path
):
    queue = queue_of(small_scans, until="clean", take_over_after=2.0)
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
    ]
    claims = Claims(queue.folder / "claims", "")
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as first:
        # Stop the worker during a job, while the job holds its locks.
        while not claims.read_claim(Claim(1, 0)).stage:
            assert first.poll() is None
            time.sleep(0.01)
        jobs = Path(f"/proc/{first.pid}/task/{first.pid}/children").read_text().split()
        for number in (first.pid, *map(int, jobs)):
            os.kill(number, signal.SIGSTOP)

        def tell(event: WorkerEvent) -> None:
            if isinstance(event, Notice) and "waiting for another run into" in event.text:
                os.kill(first.pid, signal.SIGCONT)

        Worker(queue, slots=1, threads=1, on_event=tell).run()
        os.kill(first.pid, signal.SIGCONT)
        message = first.communicate(timeout=60)[1]
    assert "scan-0: another worker has taken it over while this worker was unresponsive" in message
    ends = [one for one in JobRecords(queue.folder / "done").list_finished() if one.number == 1]
    assert [one.attempt for one in ends] == [1]
    states = {one.name: one.state for one in summarize_batch(queue).records}
    assert states == {"broken": UNUSABLE, **{f"scan-{k}": DONE for k in range(4)}}
    run(small_scans / "scan-0", tmp_path / "quiet", Config(), until="clean")
    assert read_meshes(queue.out / "scan-0") == read_meshes(tmp_path / "quiet") != {}
    assert not list((queue.cache / "drafts").iterdir())


@pytest.mark.slow
def test_a_worker_whose_queue_is_replaced_reports_it(small_scans: Path, queue_of: Begin):
    queue = queue_of(small_scans)

    def tell(event: WorkerEvent) -> None:
        if isinstance(event, JobProgress):
            # Like the next batch, which was started while this worker gave no heartbeat.
            shutil.rmtree(queue.folder)

    with pytest.raises(
        StageError, match=r"another batch was started in .*out while this worker was unresponsive"
    ):
        Worker(queue, slots=1, threads=1, on_event=tell).run()


@pytest.mark.slow
def test_a_queue_replaced_between_two_checks_is_reported(
    small_scans: Path, queue_of: Begin, monkeypatch: pytest.MonkeyPatch
):
    queue = queue_of(small_scans)

    def replace_queue(_: Worker) -> None:
        shutil.rmtree(queue.folder)
        (queue.folder / "claims" / "000001.0").write_text("")

    monkeypatch.setattr(Worker, "_handle_messages", replace_queue)
    with pytest.raises(
        StageError, match=r"another batch was started in .*out while this worker was unresponsive"
    ):
        Worker(queue, slots=1, threads=1).run()
