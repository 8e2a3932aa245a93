"""Job process: runs jobs one after another for the worker that started it.

The process reads one JSON line per job from stdin. It writes JSON lines to the original stdout: the expected
needs (then it waits for permission to start), the progress, and the outcome. If stdin closes, the worker has
died and the process exits, even in the middle of a job; the next run removes the draft left behind.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from scanloom.pipeline.batch.job_records import DONE, FAILED, UNMET, UNUSABLE
from scanloom.pipeline.batch.metrics import count_written_bytes, metrics_of
from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.config import Config
from scanloom.pipeline.error_conversion import convert_os_errors
from scanloom.pipeline.run.events import RunEvent, RunWaiting, StageProgress, StageStarted
from scanloom.pipeline.run.limits import Limits
from scanloom.pipeline.run.resource_estimation import estimate_stages
from scanloom.pipeline.run.run import PreparedRun, RunResult, prepare_run, run_prepared
from scanloom.stages.diagnostics.collector import listen_to_diagnostics
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError, ScanloomError, UsageError, format_bug_report

# Minimum seconds between two progress messages.
_PROGRESS_INTERVAL = 0.5


class WorkerChannel:
    """Message channel between a job process and its worker."""

    def __init__(self, source: BinaryIO, sink: BinaryIO) -> None:
        self._source = source
        self._sink = sink
        self._inbox: queue.SimpleQueue[Mapping[str, Any]] = queue.SimpleQueue()
        threading.Thread(target=self._listen, name="listen", daemon=True).start()

    def send(self, **message: Any) -> None:
        """Send a message to the worker; exit the process if the worker is gone."""
        try:
            self._sink.write(json.dumps(message, allow_nan=False).encode() + b"\n")
            self._sink.flush()
        except OSError:
            os._exit(1)

    def receive(self) -> Mapping[str, Any]:
        """Wait for the next message of the worker."""
        while True:
            # Short waits: on Windows, Ctrl-C does not interrupt a wait without a timeout.
            with suppress(queue.Empty):
                return self._inbox.get(timeout=1.0)

    def _listen(self) -> None:
        for line in self._source:
            self._inbox.put(json.loads(line))
        os._exit(1)


def main() -> None:
    """Run jobs received on stdin until it closes."""
    # Processes started in the background ignore SIGINT; the worker sends it to cancel a job.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    link = WorkerChannel(sys.stdin.buffer, _redirect_stdout())
    try:
        while True:
            job = link.receive()
            link.send(ended=_execute_job(job, link))
    except KeyboardInterrupt:
        # The run has removed its drafts by now; the interrupted worker waits for this exit.
        os._exit(0)


def _redirect_stdout() -> BinaryIO:
    """Return the original stdout, and redirect stdout to stderr for prints of libraries."""
    kept = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return kept


def _execute_job(job: Mapping[str, Any], link: WorkerChannel) -> dict[str, Any]:
    """Run a job and return its outcome; no exception escapes but KeyboardInterrupt."""
    started = time.perf_counter()
    events = _ProgressForwarder(link)
    metrics: dict[str, Any] = {}
    diagnostics: list[Diagnostic] = []
    written = 0
    try:
        # Stages convert their own OS errors; this converts the OS errors of reading the scan.
        with convert_os_errors(f"{job['name']} cannot be run"), listen_to_diagnostics(diagnostics.append):
            result = _run_job(job, link, events)
        reason = " ".join(map(str, result.unmet_requirements))
        state = UNMET if reason else DONE
        metrics, written = metrics_of(result), count_written_bytes(result)
    except ScanloomError as error:
        is_input = isinstance(error, (InputError, UsageError))
        state, reason = (UNUSABLE if is_input else FAILED), str(error)
        diagnostics.append(error.diagnostic)
    except Exception as error:
        state, reason = FAILED, format_bug_report(error)
    seconds = round(time.perf_counter() - started, 3)
    return {
        "state": state,
        "reason": reason,
        "seconds": seconds,
        "diagnostics": [one.to_dict() for one in dict.fromkeys(diagnostics)],
        "metrics": metrics,
        "written": written,
    }


def _run_job(job: Mapping[str, Any], link: WorkerChannel, events: _ProgressForwarder) -> RunResult:
    out = Path(job["out"])
    cache = Cache(Path(job["cache"]))
    config = Config.loads(job["config"])
    prepared = prepare_run(job["scan"], out, config, job["until"], job["force"], cache)
    limits = _request_limits(prepared, cache, link)
    return run_prepared(prepared, cache, overwrite=job["overwrite"], limits=limits, events=events)


def _request_limits(prepared: PreparedRun, cache: Cache, link: WorkerChannel) -> Limits:
    """Send the expected needs of a run and wait for its limits."""
    needs = estimate_stages(prepared.scan, prepared.config, prepared.planned_names, cache.folder).values()
    link.send(
        needs={
            "memory": max((one.memory_bytes for one in needs), default=0),
            "disk": sum(one.disk_bytes for one in needs),
            "frames": len(prepared.scan.frames),
            "layout": prepared.scan.layout,
        }
    )
    limits = link.receive()
    return Limits(limits["memory"], limits["disk"])


class _ProgressForwarder:
    """Event handler that forwards the progress of a run to the worker."""

    def __init__(self, link: WorkerChannel) -> None:
        self._link = link
        self._next = 0.0

    def __call__(self, event: RunEvent) -> None:
        match event:
            case StageStarted():
                self._link.send(at=event.stage, share=0.0)
            case StageProgress():
                if time.monotonic() >= self._next:
                    self._next = time.monotonic() + _PROGRESS_INTERVAL
                    self._link.send(at=event.stage, share=event.done / max(event.total, 1))
            case RunWaiting():
                self._link.send(waiting=event.text)
            case _:
                pass
