"""Memory that is free, but that the allocator still holds."""

from __future__ import annotations

from scanloom.stages import _kernels


def give_back() -> None:
    """Give free pages back to the system: what comes next would else find holes that are too small for it."""
    _kernels.give_back()
