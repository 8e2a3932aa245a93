"""What a person may say about a scan folder: which layout it is of, and what every layout may be told."""

from __future__ import annotations

from dataclasses import dataclass

from stages.params import param
from stages.scans.reading.params import ReadingParams
from stages.scans.table import LAYOUTS


@dataclass(frozen=True, kw_only=True)
class ScanParams(ReadingParams):
    """How to read a scan folder; everything is found in the folder when not given."""

    layout: str | None = param(
        None,
        "Read the folder as this layout; by default it is recognised.",
        choices=tuple(layout.name for layout in LAYOUTS),
    )
