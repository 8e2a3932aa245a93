"""Frames that could not be used, told of by commands of one stage; a run has them among its warnings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from cli.output import Output
from pipeline.skipped import said_of_skipped


def tell_skipped(out: Output, who: str, skipped: Sequence[Mapping[str, Any]]) -> None:
    """Warn of frames that could not be used, if there are any."""
    if skipped:
        out.warn(f"{who}: {said_of_skipped(skipped)}")
