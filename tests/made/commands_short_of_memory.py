"""Commands with increasing memory limits until one suffices.

Each run is a separate process. `python -m tests.made.commands_short_of_memory` reads command lines. For each
it writes a line of JSON: exit code and output of each run, by the number of bytes that the process could
allocate. Runs stop at the first sufficient limit. Libraries are imported once, before the first run. "{}" in
a word is replaced by the number of the run, so that each run has separate results.
"""

from __future__ import annotations

import io
import json
import os
import sys
import zlib
from contextlib import redirect_stdout

import numpy as np

from scanloom.cli.app import run_command
from scanloom.stages._open3d import import_without_threads
from tests.made.short_of_memory import limit_memory

# Every command first checks for 16 MiB, so all smaller limits end like 10 MB.
_MEGABYTES = (10, 20, 40, 60, 80, 100, 120, 150, 200, 400)
# Commands that take longer than all others run with every other limit; each of them skips different limits.
_SLOW_COMMANDS = ("bake", "compare", "depth", "fuse", "inspect", "register", "render", "run")
# Large enough to occupy all threads.
_WARM_UP_MATRIX = np.eye(400)


def run_limited_command(words: list[str], spare: int) -> tuple[int, str]:
    """Run a command in a child process with limited memory.

    Returns the exit code (negative: the signal that ended the command) and the output.
    """
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.dup2(writing, 1)
        os.dup2(writing, 2)
        code = 99
        try:
            # OpenBLAS restarts its threads after a fork. An ordinary process already has them from its
            # imports.
            np.dot(_WARM_UP_MATRIX, _WARM_UP_MATRIX)
            limit_memory(spare)
            code = run_command(words)
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            os._exit(code)
    os.close(writing)
    with os.fdopen(reading, errors="replace") as output:
        text = output.read()
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status), text


def main() -> None:
    # Libraries that commands import inside functions.
    import cv2  # noqa: F401
    import scipy.sparse
    import scipy.spatial  # noqa: F401
    import trimesh  # noqa: F401

    import_without_threads()
    # Load the modules that parsing any command line imports.
    with redirect_stdout(io.StringIO()):
        run_command(["--version"])
        run_command(["clean", "--help"])
    for line in sys.stdin:
        is_long = line.split()[0] in _SLOW_COMMANDS
        ends = {}
        for m in (0, *(_MEGABYTES[zlib.crc32(line.encode()) % 2 :: 2] if is_long else _MEGABYTES)):
            ends[f"{m} MiB"] = code, _ = run_limited_command(
                [word.format(m) for word in line.split()], m << 20
            )
            if code == 0:
                break
        sys.stdout.write(f"{json.dumps(ends)}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
