"""Signs of life of workers, and who is taken for dead.

A worker's file says how often it has beaten. Who wonders whether the worker lives looks at whether that
number changes, by its own clock that only goes forward: what time it is elsewhere, or what time a file has,
says nothing.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import secrets
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from scanloom.stages.files.opening import text_in

_SUFFIX = ".alive"
_ENDED = "ended"
# A worker beats this many times before any other could take it for dead, but at least every two seconds.
_BEATS, _LONGEST = 8, 2.0
# Whatever others say, so many beats have to be missed.
_MISSED = 4


def name_of_worker() -> str:
    """Return a name that no other worker has, on this machine or another."""
    host = re.sub(r"[^A-Za-z0-9-]", "-", socket.gethostname())[:40] or "host"
    return f"{host}-{os.getpid()}-{secrets.token_hex(3)}"


class Heartbeat:
    """Beats in a thread of its own, in a `with` block; at its end it says that this worker has ended.

    Parameters
    ----------
    take_over_after : seconds of silence after which others take this worker for dead.
    """

    def __init__(self, folder: Path, worker: str, take_over_after: float) -> None:
        self._path = folder / f"{worker}{_SUFFIX}"
        self.every = min(take_over_after / _BEATS, _LONGEST)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._beat, name="heartbeat", daemon=True)

    def __enter__(self) -> Heartbeat:
        self._write(0)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        with contextlib.suppress(OSError):
            self._path.write_text(f"{_ENDED}\n", encoding="utf-8")

    def _beat(self) -> None:
        count = 0
        while not self._stop.wait(self.every):
            count += 1
            # A full or absent disk may be there again for the next one; if not, others take over.
            with contextlib.suppress(OSError):
                self._write(count)

    def _write(self, count: int) -> None:
        # As long as before, so that even a full disk has room for it.
        descriptor = os.open(self._path, os.O_WRONLY | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o666)
        try:
            os.write(descriptor, f"{count:012d} beats, one each {self.every:09.3f} s\n".encode())
        finally:
            os.close(descriptor)


class Watch:
    """Tells for how long a worker has been silent, as far as this one has watched.

    Parameters
    ----------
    clock : seconds that only go forward.
    """

    def __init__(self, folder: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self._folder = folder
        self._clock = clock
        # What a worker last said, and when that was first seen.
        self._seen: dict[str, tuple[str, float]] = {}

    def look(self) -> None:
        """Note what all workers say now."""
        for path in self._folder.glob(f"*{_SUFFIX}"):
            self._note(path.name.removesuffix(_SUFFIX))

    def silence(self, worker: str) -> float:
        """Return for how many seconds a worker has been known to say nothing new; infinite if it ended."""
        said, since = self._note(worker)
        return math.inf if said == _ENDED else self._clock() - since

    def is_dead(self, worker: str, after: float) -> bool:
        """Return whether a worker has been silent for so many seconds, and has missed several beats."""
        said, _ = self._note(worker)
        every = re.search(r"one each ([0-9.]+) s", said)
        return self.silence(worker) > max(after, _MISSED * float(every[1]) if every else 0.0)

    def said(self, worker: str) -> str:
        """Return what a worker says now."""
        return self._note(worker)[0]

    def living(self) -> list[str]:
        """Return who has not said that it has ended."""
        self.look()
        return [worker for worker, (said, _) in self._seen.items() if said != _ENDED]

    def _note(self, worker: str) -> tuple[str, float]:
        try:
            said = text_in(self._folder / f"{worker}{_SUFFIX}", "utf-8").strip()
        except (OSError, UnicodeDecodeError):
            said = ""
        if worker not in self._seen or self._seen[worker][0] != said:
            self._seen[worker] = (said, self._clock())
        return self._seen[worker]
