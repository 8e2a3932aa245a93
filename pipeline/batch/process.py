"""A process that runs jobs, as the worker that started it sees it."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import scanloom
from scanloom.stages.scans.model.threads import environment_of

# The folder that scanloom is imported from, installed or not: Python searches it first.
_ROOT = Path(scanloom.__file__).parents[1]
_CODE = "from scanloom.pipeline.batch.child import main; main()"
# Seconds that an interrupted job gets to put its drafts away, and the system to end a process.
_PATIENCE = 10.0

Message = Mapping[str, Any]


class Process:
    """Runs jobs in a process of its own; what it says goes into an inbox, together with who says it.

    A crash in native code, or the system where memory ends, takes this process alone.

    Parameters
    ----------
    inbox : gets (process, message); the last message is {"gone": exit code}.
    threads : that a job uses.
    log : file that what libraries print is added to.
    """

    def __init__(self, inbox: queue.SimpleQueue[tuple[Process, Message]], threads: int, log: Path) -> None:
        self._inbox = inbox
        self._is_interrupted = False
        with log.open("ab") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _CODE],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                cwd=_ROOT,
                env={**os.environ, **environment_of(threads)},
                # Ctrl-C is the worker's: it says what becomes of the job.
                start_new_session=True,
            )
        self._listener = threading.Thread(target=self._listen, name="listen", daemon=True)
        self._listener.start()

    def say(self, message: Message) -> None:
        """Send a line; a process that is gone tells so by itself."""
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.write(json.dumps(message).encode() + b"\n")
                self._process.stdin.flush()

    def interrupt(self) -> None:
        """Have it end, and its job put away what it was writing; `end` waits for that."""
        self._is_interrupted = True
        with suppress(OSError):
            if sys.platform == "win32":
                self._process.kill()
            else:
                self._process.send_signal(signal.SIGINT)

    def end(self) -> None:
        """Have it end if it has not; it is not waited for long."""
        if self._is_interrupted:
            # Where its stdin ends, it puts nothing away.
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_PATIENCE)
        self._close()
        try:
            self._process.wait(_PATIENCE)
            self._listener.join(_PATIENCE)
        except subprocess.TimeoutExpired:
            self.kill()

    def kill(self) -> bool:
        """End it and its children, whatever they are at; return whether that could be done.

        Where a drive does not answer, the system ends who waits for it only when it does.
        """
        with suppress(OSError):
            if sys.platform == "win32":
                words = ["taskkill", "/F", "/T", "/PID", str(self._process.pid)]
                subprocess.run(words, capture_output=True, check=False)
            else:
                # It began a session, and with it a group of its own.
                os.killpg(self._process.pid, signal.SIGKILL)
        self._close()
        try:
            self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            return False
        self._listener.join(_PATIENCE)
        return True

    def _close(self) -> None:
        with suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.close()

    def _listen(self) -> None:
        stdout = self._process.stdout
        assert stdout is not None
        with stdout:
            for line in stdout:
                # A process that is killed may leave half a line.
                with suppress(ValueError):
                    self._inbox.put((self, json.loads(line)))
        self._inbox.put((self, {"gone": self._process.wait()}))
