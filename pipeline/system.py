"""What each system does in its way: `pipeline.posix` and `pipeline.windows` have the same functions."""

from __future__ import annotations

import sys

if sys.platform == "win32":
    from pipeline.windows import flush, lock, open_folder_lock, open_lock, peak_bytes, reset_peak
else:
    from pipeline.posix import flush, lock, open_folder_lock, open_lock, peak_bytes, reset_peak

__all__ = ["flush", "lock", "open_folder_lock", "open_lock", "peak_bytes", "reset_peak"]
