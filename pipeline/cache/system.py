"""Platform-specific functions, from `posix` or `windows`."""

from __future__ import annotations

import sys

if sys.platform == "win32":
    from scanloom.pipeline.cache.windows import (
        flush,
        lock,
        open_folder_lock,
        open_lock,
        peak_bytes,
        reset_peak,
    )
else:
    from scanloom.pipeline.cache.posix import flush, lock, open_folder_lock, open_lock, peak_bytes, reset_peak

__all__ = ["flush", "lock", "open_folder_lock", "open_lock", "peak_bytes", "reset_peak"]
