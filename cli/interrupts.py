"""Handling of Ctrl-C before and after a command: a message and an exit code, no traceback.

During imports Python would print a traceback. There is nothing to clean up then, so the process exits
immediately. While a command works, KeyboardInterrupt is raised as usual.
"""

from __future__ import annotations

import os
import signal
from types import FrameType

from scanloom.cli.exit_codes import INTERRUPTED

SENTENCE = "Interrupted; finished results are kept."

_happened = False


def exit_on_interrupt() -> None:
    """Let Ctrl-C exit the process, unless the parent process has disabled Ctrl-C."""
    _take(_leave)


def raise_interrupt() -> None:
    """Let Ctrl-C raise KeyboardInterrupt."""
    _take(_raise)


def was_interrupted() -> bool:
    """Check if Ctrl-C was pressed; some libraries replace KeyboardInterrupt with another error."""
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
