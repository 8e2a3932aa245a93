"""Whether a normal mesh is as close to its input as was asked for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def unmet(max_error: float | None, figures: Mapping[str, Any]) -> tuple[str, ...]:
    """Return a sentence if the finest level is farther from the input than `max_error`, metres.

    Parameters
    ----------
    figures : of the result, as `NormalMesh.figures` returns them.
    """
    reached = figures["by_level"][-1].get("max_distance_m")
    if max_error is None or reached is None or reached <= max_error:
        return ()
    return (too_far(reached, max_error),)


def too_far(reached: float, max_error: float) -> str:
    """Say that the finest level is so far from the input, metres, and what to do."""
    return (
        f"the finest level is up to {reached:.4g} m from the input, more than max_error ({max_error:g} m); "
        "give more levels or a finer base."
    )
