"""Heartbeats of workers, and detection of dead workers.

Each worker writes a beat counter to its file. Other workers watch the counter for changes, with their own
monotonic clocks. Clocks of other machines and file times are not used: they may differ.
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

from scanloom.stages.files.input_files import read_input_text

_SUFFIX = ".alive"
_ENDED = "ended"
# Links and pipes in place of a heartbeat are not followed.
_OVERWRITE = os.O_WRONLY | sum(getattr(os, name, 0) for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_BINARY"))
# Beats per `take_over_after`, and the maximum seconds between two beats.
_BEATS_PER_TIMEOUT, _MAX_INTERVAL = 8, 2.0
# Minimum number of missed beats before a worker is presumed dead, whatever timeout the observer uses.
_MIN_MISSED_BEATS = 4


def create_worker_name() -> str:
    """Generate a worker name that is unique across machines."""
    host = re.sub(r"[^A-Za-z0-9-]", "-", socket.gethostname())[:40] or "host"
    return f"{host}-{os.getpid()}-{secrets.token_hex(3)}"


class Heartbeat:
    """Heartbeat thread of a worker, as a context manager.

    On exit, it records that the worker ended.

    Parameters
    ----------
    folder : folder of the heartbeat files.
    worker : name of the worker.
    take_over_after : seconds of silence after which other workers presume this one dead.
    """

    def __init__(self, folder: Path, worker: str, take_over_after: float) -> None:
        self._path = folder / f"{worker}{_SUFFIX}"
        self.interval = min(take_over_after / _BEATS_PER_TIMEOUT, _MAX_INTERVAL)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run_beats, name="heartbeat", daemon=True)

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
            self._overwrite(f"{_ENDED}\n", os.O_TRUNC)

    def _run_beats(self) -> None:
        count = 0
        while not self._stop.wait(self.interval):
            count += 1
            # A full or missing disk may recover before the next beat; otherwise others take over.
            with contextlib.suppress(OSError):
                self._write(count)

    def _write(self, count: int) -> None:
        # Constant length: overwriting in place works on a full disk, too.
        self._overwrite(f"{count:012d} beats, one each {self.interval:09.3f} s\n", os.O_CREAT)

    def _overwrite(self, text: str, flag: int) -> None:
        descriptor = os.open(self._path, _OVERWRITE | flag, 0o666)
        try:
            os.write(descriptor, text.encode())
        finally:
            os.close(descriptor)


class HeartbeatObserver:
    """Observer of heartbeats: measures for how long each worker has been silent.

    Parameters
    ----------
    folder : folder of the heartbeat files.
    clock : monotonic clock in seconds.
    """

    def __init__(self, folder: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self._folder = folder
        self._clock = clock
        # Last content of each heartbeat file, and the time it was first seen.
        self._seen: dict[str, tuple[str, float]] = {}

    def refresh(self) -> None:
        """Read the heartbeats of all workers."""
        for path in self._folder.glob(f"*{_SUFFIX}"):
            self._update(path.name.removesuffix(_SUFFIX))

    def get_silence(self, worker: str) -> float:
        """Return the seconds since the last observed beat of a worker.

        The result is infinite if the worker ended.
        """
        said, since = self._update(worker)
        return math.inf if said == _ENDED else self._clock() - since

    def is_dead(self, worker: str, after: float) -> bool:
        """Return True if a worker is presumed dead.

        A worker is presumed dead after `after` seconds of silence, and at least several missed beats.
        """
        said, _ = self._update(worker)
        every = re.search(r"one each ([0-9]{5}\.[0-9]{3}) s", said)
        return self.get_silence(worker) > max(after, _MIN_MISSED_BEATS * float(every[1]) if every else 0.0)

    def read_heartbeat(self, worker: str) -> str:
        """Read the heartbeat file of a worker."""
        return self._update(worker)[0]

    def list_living(self) -> list[str]:
        """Return the workers that have not recorded their end."""
        self.refresh()
        return [worker for worker, (said, _) in self._seen.items() if said != _ENDED]

    def _update(self, worker: str) -> tuple[str, float]:
        try:
            said = read_input_text(self._folder / f"{worker}{_SUFFIX}", "utf-8").strip()
        except (OSError, UnicodeDecodeError):
            said = ""
        if worker not in self._seen or self._seen[worker][0] != said:
            self._seen[worker] = (said, self._clock())
        return self._seen[worker]
