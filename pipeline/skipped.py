"""Warning about frames that could not be used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def said_of_skipped(skipped: Sequence[Mapping[str, Any]]) -> str:
    """Return the warning: how many frames were left out, and why the first of them."""
    first = skipped[0]
    count = f"{len(skipped)} frame{'s' * (len(skipped) != 1)}"
    return f"left out {count}; the first is {first['frame']}: {first['reason']}"


def warn_of_skipped(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Add a warning to the figures of a stage if it skipped frames."""
    warnings = list(figures.get("warnings", ()))
    skipped = figures["frames_skipped"]
    if skipped:
        warnings.append(said_of_skipped(skipped))
    return {**figures, "warnings": warnings}
