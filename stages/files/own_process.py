"""Reading with third-party libraries in a subprocess.

Some C++ and Rust libraries abort or corrupt memory on damaged files, which cannot be caught in-process. The
subprocess also limits run time and memory.
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

# Bytes that the subprocess may allocate in addition to its size at start.
_MEMORY = 1 << 31
# Ratio of the wall clock limit to the CPU time limit: waiting for a disk or for other programs is not work.
_WAITING = 20
_START = """import sys
sys.path[:] = {path!r}
from importlib import import_module
import_module({module!r}).main()
"""


class DiedError(Exception):
    """Subprocess ended without an answer: its library crashed, failed or timed out."""


def asked(module: str, words: Sequence[str], seconds: float) -> dict[str, Any]:
    """Run `main` of a scanloom module in a subprocess and return its answer.

    Diagnostics of the subprocess are emitted in this process.

    Parameters
    ----------
    module : name of the module; its `main` calls `answer`.
    words : arguments of the subprocess, `sys.argv`.
    seconds : limit of CPU time.

    Raises
    ------
    InputError
        If the subprocess raised one.
    MemoryError
        If there was too little memory.
    DiedError
        If the subprocess ended without an answer.
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
        # A failure although the full memory budget is available is not caused by lack of memory.
        require_room(_MEMORY)
        raise DiedError(said["died"])
    if "error" in said:
        raise InputError.of(Diagnostic.from_figures(said["error"]))
    emit(*map(Diagnostic.from_figures, said["diagnostics"]))
    answer: dict[str, Any] = said["answer"]
    return answer


def started(module: str, words: Sequence[str]) -> subprocess.Popen[bytes]:
    """Start a subprocess that runs `main` of a module and serves requests.

    Requests and answers go through its pipes. The module calls `limit_memory` itself. The caller ends the
    process, also if an answer takes too long.
    """
    return subprocess.Popen(
        _command(module, words), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )


def _command(module: str, words: Sequence[str]) -> list[str]:
    return [sys.executable, "-c", _START.format(path=sys.path, module=module), *words]


def answer(work: Callable[[list[str]], Mapping[str, Any]]) -> None:
    """Run work in the subprocess within limits and write its result to stdout.

    Counterpart of `asked`: `work` receives the words that `asked` passed. Exceptions other than ScanloomError
    are reported like a crash.
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
    except BaseException as error:  # panics of Rust libraries derive from BaseException
        said = {"died": repr(error)}
    sys.stdout.write(json.dumps(said))


def _limit(seconds: float) -> None:
    """Limit CPU seconds and memory of this process, except on Windows."""
    if sys.platform != "win32":  # Windows has no such limits
        import resource

        _lower(resource.RLIMIT_CPU, int(seconds) + 1)
        limit_memory(_MEMORY)


def limit_memory(most: int) -> None:
    """Limit further memory of this process to `most` bytes, on Linux only."""
    if sys.platform != "win32":
        import resource

        _lower(resource.RLIMIT_CORE, 0)
        try:
            pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        except (OSError, ValueError, IndexError):  # the current size is unknown without /proc
            return
        _lower(resource.RLIMIT_AS, pages * resource.getpagesize() + most)


if sys.platform != "win32":

    def _lower(limit: int, most: int) -> None:
        import resource

        soft, hard = resource.getrlimit(limit)
        known = [value for value in (soft, hard, most) if value != resource.RLIM_INFINITY]
        resource.setrlimit(limit, (min(known), hard))
