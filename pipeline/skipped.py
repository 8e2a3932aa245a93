"""What is said of frames that a stage skipped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def said_of_skipped(skipped: Sequence[Mapping[str, Any]]) -> str:
    """Return the warning that stands among a stage's figures: how many frames, and why the first of them."""
    first = skipped[0]
    return f"{len(skipped)} frames were skipped; the first, {first['frame']}: {first['reason']}"
