"""Release of unused memory from the allocator to the operating system."""

from __future__ import annotations

from scanloom.stages import _kernels


def release_free_memory() -> None:
    """Return free pages to the operating system.

    Otherwise fragmentation of the heap adds to the peak memory of later steps.
    """
    _kernels.release_free_memory()
