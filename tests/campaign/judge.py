"""Run cases in a child process, which is replaced when a case ends it."""

from __future__ import annotations

import json
import select
import signal
import subprocess
import sys
import tempfile
from types import TracebackType
from typing import IO, Any

from tests.campaign.verdict import FAILED, Verdict

# Processor time of a case by kind, seconds.
SECONDS = {"readers": 10.0, "kernels": 120.0, "fusion": 120.0}
# Factor from processor time to elapsed time; on a busy machine, only a blocked case exceeds it.
_PATIENCE = 12


class Judge:
    """Child process with its pipes; after a crash or a timeout, the next case gets a new process."""

    def __init__(self) -> None:
        self._child: subprocess.Popen[str] | None = None
        self._errors: IO[str] = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115

    def __enter__(self) -> Judge:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self._end()
        self._errors.close()

    def judge(self, case: dict[str, Any]) -> Verdict:
        """Run one case; a crash or a timeout of the child process is a failure."""
        seconds = SECONDS[case["kind"]]
        child = self._get_child()
        assert child.stdin is not None
        assert child.stdout is not None
        child.stdin.write(json.dumps({**case, "seconds": seconds}) + "\n")
        child.stdin.flush()
        ready, _, _ = select.select([child.stdout], [], [], _PATIENCE * seconds)
        answer = child.stdout.readline() if ready else ""
        if answer:
            return Verdict(**json.loads(answer))
        message = self._explain_end(child, bool(ready), seconds)
        self._end()
        return Verdict(FAILED, message)

    def _get_child(self) -> subprocess.Popen[str]:
        if self._child is None:
            self._errors.truncate(0)
            self._child = subprocess.Popen(
                [sys.executable, "-m", "tests.campaign.child"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                text=True,
            )
            # Its imports are no part of a case, and take minutes on a machine with much to do.
            assert self._child.stdout is not None
            self._child.stdout.readline()
        return self._child

    def _explain_end(self, child: subprocess.Popen[str], ended: bool, seconds: float) -> str:
        if not ended:
            return f"no answer within {_PATIENCE * seconds:g} s"
        code = child.wait()
        if code == -signal.SIGPROF:
            return f"more than {seconds:g} s of processor time"
        self._errors.seek(0)
        output = self._errors.read()[-2000:]
        name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return f"the process ended with {name}\n{output}"

    def _end(self) -> None:
        child, self._child = self._child, None
        if child is not None:
            child.kill()
            child.communicate()
