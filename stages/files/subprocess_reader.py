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
from scanloom.stages.files.memory_check import check_memory_available

# Bytes that the subprocess may allocate in addition to its size at start.
_MAX_MEMORY_BYTES = 1 << 31
# Ratio of the wall clock limit to the CPU time limit: waiting for a disk or for other programs is not work.
_WALL_TO_CPU_RATIO = 20
_BOOTSTRAP_CODE = """import sys
sys.path[:] = {path!r}
from importlib import import_module
import_module({module!r}).main()
"""


class SubprocessDiedError(Exception):
    """Subprocess ended without an answer: its library crashed, failed or timed out."""


def run_reader_subprocess(module: str, arguments: Sequence[str], cpu_seconds: float) -> dict[str, Any]:
    """Run `main` of a scanloom module in a subprocess and return its answer.

    Diagnostics of the subprocess are emitted in this process.

    Parameters
    ----------
    module : name of the module; its `main` calls `serve_request`.
    arguments : arguments of the subprocess, `sys.argv`.
    cpu_seconds : limit of CPU time.

    Raises
    ------
    InputError
        If the subprocess raised one.
    MemoryError
        If there was too little memory.
    SubprocessDiedError
        If the subprocess ended without an answer.
    """
    try:
        process = subprocess.run(
            _build_command(module, [str(cpu_seconds), *arguments]),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=_WALL_TO_CPU_RATIO * cpu_seconds,
            check=False,
        )
        reply = json.loads(process.stdout)
    except (subprocess.TimeoutExpired, ValueError) as error:
        reply = {"died": repr(error)}
    if "died" in reply:
        # A failure although the full memory budget is available is not caused by lack of memory.
        check_memory_available(_MAX_MEMORY_BYTES)
        raise SubprocessDiedError(reply["died"])
    if "error" in reply:
        raise InputError.from_diagnostic(Diagnostic.from_dict(reply["error"]))
    emit(*map(Diagnostic.from_dict, reply["diagnostics"]))
    answer: dict[str, Any] = reply["answer"]
    return answer


def start_reader_subprocess(module: str, arguments: Sequence[str]) -> subprocess.Popen[bytes]:
    """Start a subprocess that runs `main` of a module and serves requests.

    Requests and answers go through its pipes. The module calls `limit_memory` itself. The caller ends the
    process, also if an answer takes too long.
    """
    return subprocess.Popen(
        _build_command(module, arguments),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )


def _build_command(module: str, arguments: Sequence[str]) -> list[str]:
    return [sys.executable, "-c", _BOOTSTRAP_CODE.format(path=sys.path, module=module), *arguments]


def serve_request(work: Callable[[list[str]], Mapping[str, Any]]) -> None:
    """Run work in the subprocess within limits and write its result to stdout.

    Counterpart of `run_reader_subprocess`: `work` receives the words that `run_reader_subprocess` passed.
    Exceptions other than ScanloomError are reported like a crash.
    """
    seconds, words = float(sys.argv[1]), sys.argv[2:]
    _limit_resources(seconds)
    reply: dict[str, Any]
    try:
        with collecting(forward=False) as diagnostics:
            reply = {"answer": dict(work(words))}
        reply["diagnostics"] = [one.to_dict() for one in diagnostics]
    except ScanloomError as error:
        reply = {"error": error.diagnostic.to_dict()}
    except BaseException as error:  # panics of Rust libraries derive from BaseException
        reply = {"died": repr(error)}
    sys.stdout.write(json.dumps(reply))


def _limit_resources(seconds: float) -> None:
    """Limit CPU seconds and memory of this process, except on Windows."""
    if sys.platform != "win32":  # Windows has no such limits
        import resource

        _lower_limit(resource.RLIMIT_CPU, int(seconds) + 1)
        limit_memory(_MAX_MEMORY_BYTES)


def limit_memory(max_bytes: int) -> None:
    """Limit further memory of this process to `max_bytes` bytes, on Linux only."""
    if sys.platform != "win32":
        import resource

        _lower_limit(resource.RLIMIT_CORE, 0)
        try:
            pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        except (OSError, ValueError, IndexError):  # the current size is unknown without /proc
            return
        _lower_limit(resource.RLIMIT_AS, pages * resource.getpagesize() + max_bytes)


if sys.platform != "win32":

    def _lower_limit(limit: int, most: int) -> None:
        import resource

        soft, hard = resource.getrlimit(limit)
        known = [value for value in (soft, hard, most) if value != resource.RLIM_INFINITY]
        resource.setrlimit(limit, (min(known), hard))
