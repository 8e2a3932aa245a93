"""Directions all around."""

from __future__ import annotations

import numpy as np

from scanloom.stages.inspecting.coverage.views import Floats


def all_around(count: int) -> Floats:
    """Return `count` directions (count, 3) of length 1, spread evenly."""
    # Along a spiral, by the golden angle.
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.arange(count) * np.pi * (3 - 5**0.5)
    level = np.sqrt(1 - z * z)
    return np.stack([level * np.cos(angle), level * np.sin(angle), z], axis=1)
