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

from scanloom.pipeline.batch.figures import figures_of, written_by
from scanloom.pipeline.batch.records import DONE, FAILED, UNMET, UNUSABLE
from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.config import Config
from scanloom.pipeline.failures import explained
from scanloom.pipeline.run.events import Event, StageProgress, StageStarted, Waiting
from scanloom.pipeline.run.limits import Limits
from scanloom.pipeline.run.needs import expected_of
from scanloom.pipeline.run.run import RunResult, Wanted, run_wanted, wanted_of
from scanloom.stages.diagnostics.collector import listening
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError, ScanloomError, UsageError, bug_explained

# Minimum seconds between two progress messages.
_PAUSE = 0.5


class Link:
    """Message channel between a job process and its worker."""

    def __init__(self, words: BinaryIO, to: BinaryIO) -> None:
        self._words = words
        self._to = to
        self._inbox: queue.SimpleQueue[Mapping[str, Any]] = queue.SimpleQueue()
        threading.Thread(target=self._listen, name="listen", daemon=True).start()

    def say(self, **message: Any) -> None:
        """Send a message to the worker; exit the process if the worker is gone."""
        try:
            self._to.write(json.dumps(message, allow_nan=False).encode() + b"\n")
            self._to.flush()
        except OSError:
            os._exit(1)

    def hear(self) -> Mapping[str, Any]:
        """Wait for the next message of the worker."""
        while True:
            # Short waits: on Windows, Ctrl-C does not interrupt a wait without a timeout.
            with suppress(queue.Empty):
                return self._inbox.get(timeout=1.0)

    def _listen(self) -> None:
        for line in self._words:
            self._inbox.put(json.loads(line))
        os._exit(1)


def main() -> None:
    """Run jobs received on stdin until it closes."""
    # Processes started in the background ignore SIGINT; the worker sends it to cancel a job.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    link = Link(sys.stdin.buffer, _own_stdout())
    try:
        while True:
            job = link.hear()
            link.say(ended=_ended(job, link))
    except KeyboardInterrupt:
        # The run has removed its drafts by now; the interrupted worker waits for this exit.
        os._exit(0)


def _own_stdout() -> BinaryIO:
    """Return the original stdout, and redirect stdout to stderr for prints of libraries."""
    kept = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return kept


def _ended(job: Mapping[str, Any], link: Link) -> dict[str, Any]:
    """Run a job and return its outcome; no exception escapes but KeyboardInterrupt."""
    started = time.perf_counter()
    events = _Told(link)
    figures: dict[str, Any] = {}
    diagnostics: list[Diagnostic] = []
    written = 0
    try:
        # Stages convert their own OS errors; this converts the OS errors of reading the scan.
        with explained(f"{job['name']} cannot be run"), listening(diagnostics.append):
            result = _run(job, link, events)
        reason = " ".join(map(str, result.unmet))
        state = UNMET if reason else DONE
        figures, written = figures_of(result), written_by(result)
    except ScanloomError as error:
        is_input = isinstance(error, (InputError, UsageError))
        state, reason = (UNUSABLE if is_input else FAILED), str(error)
        diagnostics.append(error.diagnostic)
    except Exception as error:
        state, reason = FAILED, bug_explained(error)
    seconds = round(time.perf_counter() - started, 3)
    return {
        "state": state,
        "reason": reason,
        "seconds": seconds,
        "diagnostics": [one.figures() for one in dict.fromkeys(diagnostics)],
        "figures": figures,
        "written": written,
    }


def _run(job: Mapping[str, Any], link: Link, events: _Told) -> RunResult:
    out = Path(job["out"])
    cache = Cache(Path(job["cache"]))
    config = Config.loads(job["config"])
    wanted = wanted_of(job["scan"], out, config, job["until"], job["force"], cache)
    limits = _leave(wanted, cache, link)
    return run_wanted(wanted, cache, overwrite=job["overwrite"], limits=limits, events=events)


def _leave(wanted: Wanted, cache: Cache, link: Link) -> Limits:
    """Send the expected needs of a run and wait for its limits."""
    needs = expected_of(wanted.scan, wanted.config, wanted.planned, cache.folder).values()
    link.say(
        needs={
            "memory": max((one.memory_bytes for one in needs), default=0),
            "disk": sum(one.disk_bytes for one in needs),
            "frames": len(wanted.scan.frames),
            "layout": wanted.scan.layout,
        }
    )
    leave = link.hear()
    return Limits(leave["memory"], leave["disk"])


class _Told:
    """Event handler that forwards the progress of a run to the worker."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._next = 0.0

    def __call__(self, event: Event) -> None:
        match event:
            case StageStarted():
                self._link.say(at=event.stage, share=0.0)
            case StageProgress():
                if time.monotonic() >= self._next:
                    self._next = time.monotonic() + _PAUSE
                    self._link.say(at=event.stage, share=event.done / max(event.total, 1))
            case Waiting():
                self._link.say(waiting=event.text)
            case _:
                pass
