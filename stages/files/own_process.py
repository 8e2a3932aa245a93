"""Reading by a foreign library in a process of its own: what crashes, hangs or fills memory ends there.

Some libraries of C++ and Rust abort, or write where they must not, on a damaged file; nothing can catch that.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError, ScanloomError
from scanloom.stages.files.room import require_room

# What the process may take beyond what it has when it begins, bytes.
_MEMORY = 1 << 31
# Waiting for a disk or for other programs counts less than work does.
_WAITING = 20
_START = """import sys
sys.path[:] = {path!r}
from importlib import import_module
import_module({module!r}).main()
"""


class DiedError(Exception):
    """The process ended without an answer: its library crashed, failed, or took too much time."""


def asked(module: str, words: Sequence[str], seconds: float) -> dict[str, Any]:
    """Run `main` of one of our modules in another Python, with words in `sys.argv`, and return its answer.

    Diagnostics of that process are emitted here.

    Parameters
    ----------
    module : its `main` calls `answer`.
    seconds : of processor time that it may take.

    Raises
    ------
    InputError
        As it says, of the file that it was asked about.
    MemoryError
        If there was not enough memory for it.
    DiedError
        If it ended without an answer.
    """
    try:
        ran = subprocess.run(
            _command(module, [str(seconds), *words]),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=_WAITING * seconds,
            check=False,
        )
        said = json.loads(ran.stdout)
    except (subprocess.TimeoutExpired, ValueError) as error:
        said = {"died": repr(error)}
    if "died" in said:
        # With room for all that it may take, it was not memory that was missing.
        require_room(_MEMORY)
        raise DiedError(said["died"])
    if "error" in said:
        raise InputError.of(Diagnostic.from_figures(said["error"]))
    emit(*map(Diagnostic.from_figures, said["diagnostics"]))
    answer: dict[str, Any] = said["answer"]
    return answer


def started(module: str, words: Sequence[str]) -> subprocess.Popen[bytes]:
    """Start another Python that runs `main` of one of our modules, to be asked many times through its pipes.

    It calls `limit_memory` itself; whoever asks ends it, also where an answer takes too long.
    """
    return subprocess.Popen(
        _command(module, words), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )


def _command(module: str, words: Sequence[str]) -> list[str]:
    return [sys.executable, "-c", _START.format(path=sys.path, module=module), *words]


def answer(work: Callable[[list[str]], Mapping[str, Any]]) -> None:
    """Do some work with the words that `asked` passed on, within limits, and tell what came of it.

    What a library raises of its own is as good as its death.
    """
    seconds, words = float(sys.argv[1]), sys.argv[2:]
    _limit(seconds)
    said: dict[str, Any]
    try:
        with collecting(forward=False) as diagnostics:
            said = {"answer": dict(work(words))}
        said["diagnostics"] = [one.figures() for one in diagnostics]
    except ScanloomError as error:
        said = {"error": error.diagnostic.figures()}
    except BaseException as error:  # that of Rust is no Exception
        said = {"died": repr(error)}
    sys.stdout.write(json.dumps(said))


def _limit(seconds: float) -> None:
    """Take no more than so much time and memory from here on, where the system has such limits."""
    if sys.platform != "win32":  # which has none
        import resource

        _lower(resource.RLIMIT_CPU, int(seconds) + 1)
        limit_memory(_MEMORY)


def limit_memory(most: int) -> None:
    """Take no more than so many bytes from here on, where the system has such limits."""
    if sys.platform != "win32":
        import resource

        _lower(resource.RLIMIT_CORE, 0)
        try:
            pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        except (OSError, ValueError, IndexError):  # nothing tells how much it has
            return
        _lower(resource.RLIMIT_AS, pages * resource.getpagesize() + most)


if sys.platform != "win32":

    def _lower(limit: int, most: int) -> None:
        import resource

        soft, hard = resource.getrlimit(limit)
        known = [value for value in (soft, hard, most) if value != resource.RLIM_INFINITY]
        resource.setrlimit(limit, (min(known), hard))
