"""Frames that could not be used, told of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cli.output import Output


def tell_skipped(out: Output, who: str, figures: Mapping[str, Any]) -> None:
    """Warn of frames that could not be used: how many, and why the first of them."""
    skipped = figures.get("frames_skipped")
    if skipped:
        first = skipped[0]
        count = f"{len(skipped)} frame{'s' * (len(skipped) != 1)}"
        out.warn(f"{who} left out {count}; the first is {first['frame']}: {first['reason']}")
