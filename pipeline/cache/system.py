"""Platform-specific functions, from `posix` or `windows`."""

from __future__ import annotations

import sys

if sys.platform == "win32":
    from scanloom.pipeline.cache.windows import (
        flush,
        get_peak_bytes,
        lock,
        open_folder_lock,
        open_lock,
        reset_peak_bytes,
    )
else:
    from scanloom.pipeline.cache.posix import (
        flush,
        get_peak_bytes,
        lock,
        open_folder_lock,
        open_lock,
        reset_peak_bytes,
    )

__all__ = ["flush", "get_peak_bytes", "lock", "open_folder_lock", "open_lock", "reset_peak_bytes"]
