"""Parameters that several methods have, so that one option, one key and one keyword stand for all of them."""

from __future__ import annotations

import math
from typing import Any, TypedDict

from stages.diagnostics.codes import USAGE_VALUE_INVALID
from stages.diagnostics.errors import UsageError

# Heading of the help for whatever says how far a method goes.
HOW_FAR = "How far: a number, bounds or both"


class GoalKeywords(TypedDict, total=False):
    """What every method is told, as keywords."""

    triangles: int | None
    ratio: float | None
    drop_below: float | None
    keep_uv: bool
    bake: bool | None
    threads: int | None


class BoundKeywords(TypedDict, total=False):
    """Bounds on shape (metres) and colour (8-bit levels), as keywords."""

    max_shape: float | None
    max_color: float | None


class ScaleKeywords(TypedDict, total=False):
    """Metres that weigh as much as one level of colour, as a keyword."""

    attribute_scale: float | None


class FitKeywords(TypedDict, total=False):
    """Whether there is a fit at the end, as a keyword."""

    fit: bool


def require_finite(params: Any, *names: str) -> None:
    """Raise UsageError for the first of these parameters that is infinite."""
    for name in names:
        if getattr(params, name) == math.inf:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "{name} is infinite",
                remedy="leave it out, and give triangles or ratio instead.",
                name=name,
            )
