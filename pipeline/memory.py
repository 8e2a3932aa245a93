"""The peak memory of this process since a chosen moment."""

from __future__ import annotations

import resource
import sys
from pathlib import Path

_KILOBYTE = 1024


def reset_peak() -> None:
    """Forget the peak so far, where the system can (Linux: proc(5), clear_refs)."""
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return


def peak_bytes() -> int:
    """Return the largest resident size since `reset_peak`, or since the process began."""
    try:
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * _KILOBYTE
    except OSError:
        pass
    # macOS counts bytes, the others kilobytes.
    unit = 1 if sys.platform == "darwin" else _KILOBYTE
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
