"""Entry point of the installed program; handles Ctrl-C before the slow imports."""

from __future__ import annotations

import os
import sys

from scanloom.cli import interrupts

# OpenBLAS threads spin for about 20 ms after each matrix product and delay working threads. 2⁴ iterations
# are the minimum setting. OpenBLAS reads the setting when NumPy is imported.
_SPIN = ("OPENBLAS_THREAD_TIMEOUT", "4")
# OpenCV prints lines about damaged images, which are reported as diagnostics as well.
_QUIET = ("OPENCV_LOG_LEVEL", "OFF")


def main() -> None:
    """Run the command line and leave with its exit code."""
    interrupts.exit_on_interrupt()
    if sys.argv[1:] == ["--version"]:
        # Importing the command line takes a second.
        from scanloom.cli.version import describe_version

        print(describe_version())  # noqa: T201
        return
    os.environ.setdefault(*_SPIN)
    os.environ.setdefault(*_QUIET)
    from scanloom.cli.app import main as run

    run()
