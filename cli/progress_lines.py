"""Progress of long work as lines, for logs and pipes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from scanloom.stages.progress import Progress

# Seconds between two lines. CI systems end jobs that print nothing for some minutes.
INTERVAL_S = 30.0


@contextmanager
def print_progress_lines(label: str, unit: str, write: Callable[[str], object]) -> Iterator[Progress]:
    """Write a line every 30 s while the block runs, even if the work reports no progress.

    Parameters
    ----------
    label : name of the work.
    unit : plural noun of the units that progress counts.
    write : writes one line; called from another thread.
    """
    start = time.monotonic()
    state = (0, 0)
    is_finished = threading.Event()

    def update(done: int, total: int) -> None:
        nonlocal state
        state = (done, total)

    def tell() -> None:
        while not is_finished.wait(INTERVAL_S):
            done, total = state
            counted = f", {done:,} of {total:,} {unit or 'steps'}" if total else ""
            write(f"{label}: running for {time.monotonic() - start:.0f} s{counted}")

    thread = threading.Thread(target=tell, name=f"progress of {label}", daemon=True)
    thread.start()
    try:
        yield update
    finally:
        is_finished.set()
        thread.join()
