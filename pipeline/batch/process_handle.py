"""Worker side of a job process."""

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
from scanloom.stages.scans.model.threads import build_thread_environment

# Parent folder of the package: as working directory it is first on the import path of the subprocess.
_ROOT = Path(scanloom.__file__).parents[1]
_CODE = "from scanloom.pipeline.batch.job_process import main; main()"
# Seconds for an interrupted job to remove its drafts, and for the system to end a killed process.
_EXIT_TIMEOUT = 10.0

Message = Mapping[str, Any]


class JobProcess:
    """Subprocess that runs jobs and puts its messages into an inbox.

    A crash in native code, or the out-of-memory killer, only ends this subprocess, not the worker.

    Parameters
    ----------
    inbox : receives (process, message); the last message is {"gone": exit code}.
    threads : threads per job.
    log : file that output of libraries is appended to.
    """

    def __init__(self, inbox: queue.SimpleQueue[tuple[JobProcess, Message]], threads: int, log: Path) -> None:
        self._inbox = inbox
        self._is_interrupted = False
        with log.open("ab") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _CODE],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                cwd=_ROOT,
                env={**os.environ, **build_thread_environment(threads)},
                # New session: Ctrl-C must only reach the worker, which decides about the jobs.
                start_new_session=True,
            )
        self._listener = threading.Thread(target=self._listen, name="listen", daemon=True)
        self._listener.start()

    def send(self, message: Message) -> None:
        """Send a message; a dead process is reported by its "gone" message instead."""
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.write(json.dumps(message).encode() + b"\n")
                self._process.stdin.flush()

    def interrupt(self) -> None:
        """Interrupt the job, so that it removes its drafts.

        `end` waits for the process to exit.
        """
        self._is_interrupted = True
        with suppress(OSError):
            if sys.platform == "win32":
                self._process.kill()
            else:
                self._process.send_signal(signal.SIGINT)

    def end(self) -> None:
        """End the process, and kill it if it does not exit within some seconds."""
        if self._is_interrupted:
            # Wait before closing stdin: the process would exit at once and leave its drafts.
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_EXIT_TIMEOUT)
        self._close()
        try:
            self._process.wait(_EXIT_TIMEOUT)
            self._listener.join(_EXIT_TIMEOUT)
        except subprocess.TimeoutExpired:
            self.kill()

    def kill(self) -> bool:
        """Kill the process and its children; return False if the process did not exit.

        A process blocked on an unresponsive network drive dies only once the drive answers.
        """
        with suppress(OSError):
            if sys.platform == "win32":
                words = ["taskkill", "/F", "/T", "/PID", str(self._process.pid)]
                subprocess.run(words, capture_output=True, check=False)
            else:
                # The new session made the process leader of a process group.
                os.killpg(self._process.pid, signal.SIGKILL)
        self._close()
        try:
            self._process.wait(_EXIT_TIMEOUT)
        except subprocess.TimeoutExpired:
            return False
        self._listener.join(_EXIT_TIMEOUT)
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
                # A killed process may leave an incomplete line.
                with suppress(ValueError):
                    self._inbox.put((self, json.loads(line)))
        self._inbox.put((self, {"gone": self._process.wait()}))
