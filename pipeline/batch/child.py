"""The process that runs jobs, one after another, for the worker that started it.

It reads a line of JSON for each job from stdin, and writes lines of JSON to what was stdout: what it needs
before it begins (and then waits for leave), what it is at, and how the job ended. Where stdin ends the worker
is gone, and so is this process, in the middle of a job too: what it was writing is a draft that the next run
removes.
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

# Seconds between two lines of progress.
_PAUSE = 0.5


class Link:
    """What goes to the worker and comes from it."""

    def __init__(self, words: BinaryIO, to: BinaryIO) -> None:
        self._words = words
        self._to = to
        self._inbox: queue.SimpleQueue[Mapping[str, Any]] = queue.SimpleQueue()
        threading.Thread(target=self._listen, name="listen", daemon=True).start()

    def say(self, **message: Any) -> None:
        """Tell the worker something; without one there is nothing more to do."""
        try:
            self._to.write(json.dumps(message, allow_nan=False).encode() + b"\n")
            self._to.flush()
        except OSError:
            os._exit(1)

    def hear(self) -> Mapping[str, Any]:
        """Wait for what the worker says next."""
        while True:
            # In short waits, which Ctrl-C ends on every system.
            with suppress(queue.Empty):
                return self._inbox.get(timeout=1.0)

    def _listen(self) -> None:
        for line in self._words:
            self._inbox.put(json.loads(line))
        os._exit(1)


def main() -> None:
    """Run the jobs that come, until no more do."""
    # Only the worker sends it here; started in the background, a process has it switched off.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    link = Link(sys.stdin.buffer, _own_stdout())
    try:
        while True:
            job = link.hear()
            link.say(ended=_ended(job, link))
    except KeyboardInterrupt:
        # The worker is interrupted, and waits for this to have put its drafts away.
        os._exit(0)


def _own_stdout() -> BinaryIO:
    """Return what stdout was; what libraries print goes where errors go from now on."""
    kept = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return kept


def _ended(job: Mapping[str, Any], link: Link) -> dict[str, Any]:
    """Run a job, and return what became of it; nothing that it raises gets out, but an interruption."""
    started = time.perf_counter()
    events = _Told(link)
    figures: dict[str, Any] = {}
    diagnostics: list[Diagnostic] = []
    written = 0
    try:
        # What a run explains already goes through; what reading a scan may meet is explained here.
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
    """Tell the worker what a run needs, wait until it may begin, and return what it may take."""
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
    """Passes on the progress of a run."""

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
