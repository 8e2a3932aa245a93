"""Commands with less and less memory, each time in a process of its own.

`python -m tests.made.commands_short_of_memory` reads command lines, and answers each with a line of JSON: the
exit code and the output of each run, by how much the process was allowed to grow. Libraries are imported
before, once. "{}" in a word stands for the number of the run, whose results then are no other's.
"""

from __future__ import annotations

import json
import os
import sys
import zlib

import numpy as np

from cli.app import run_command
from stages._open3d import imported
from tests.made.short_of_memory import limit

_MEGABYTES = (400, 200, 150, 120, 100, 80, 60, 40, 20, 10, 5, 4, 3, 2)
# Commands that take longer than all others meet every other limit; which ones differs between them.
_LONG = ("bake", "compare", "depth", "fuse", "inspect", "register", "render", "run")
# Large enough for all threads to be at it.
_FACTOR = np.eye(400)


def ran(words: list[str], spare: int) -> tuple[int, str]:
    """Return exit code (negative: the signal that ended it) and output of a command."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.dup2(writing, 1)
        os.dup2(writing, 2)
        code = 99
        try:
            # OpenBLAS begins its threads again after a fork; a command has them from its imports.
            np.dot(_FACTOR, _FACTOR)
            limit(spare)
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
    # The libraries that commands import where they use them.
    import cv2  # noqa: F401
    import scipy.sparse
    import scipy.spatial  # noqa: F401
    import trimesh  # noqa: F401

    imported()
    for line in sys.stdin:
        is_long = line.split()[0] in _LONG
        limits = (*(_MEGABYTES[zlib.crc32(line.encode()) % 2 :: 2] if is_long else _MEGABYTES), 0)
        ends = {f"{m} MiB": ran([word.format(m) for word in line.split()], m << 20) for m in limits}
        sys.stdout.write(f"{json.dumps(ends)}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
