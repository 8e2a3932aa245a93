"""Ctrl-C while nothing is under way yet, or any more: no traceback, only a sentence and its exit code.

While the program's imports run, Python would show where in them it was interrupted. There is nothing to put
away then, so the process may end on the spot. Once a command works, KeyboardInterrupt takes its usual way.
"""

from __future__ import annotations

import os
import signal
from types import FrameType

from scanloom.cli.exit_codes import INTERRUPTED

SENTENCE = "Interrupted; what was finished is kept."

_happened = False


def exit_on_interrupt() -> None:
    """From here on, Ctrl-C ends the process; unless whoever started it has switched Ctrl-C off."""
    _take(_leave)


def raise_interrupt() -> None:
    """From here on, Ctrl-C raises KeyboardInterrupt."""
    _take(_raise)


def was_interrupted() -> bool:
    """Return whether Ctrl-C was pressed: some libraries make an error of their own of KeyboardInterrupt."""
    return _happened


def _take(handler: signal._HANDLER) -> None:
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, handler)


def _leave(number: int, frame: FrameType | None) -> None:  # noqa: ARG001
    os.write(2, f"scanloom: {SENTENCE}\n".encode())
    os._exit(INTERRUPTED)


def _raise(number: int, frame: FrameType | None) -> None:  # noqa: ARG001
    global _happened
    _happened = True
    raise KeyboardInterrupt
