"""Warning about skipped frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.printing import format_count
from scanloom.stages.scans.codes import SCAN_FRAMES_SKIPPED


def warn_skipped_frames(skipped: Sequence[Mapping[str, Any]]) -> None:
    """Emit a warning if frames were skipped, with their number and the first reason."""
    if skipped:
        emit(
            SCAN_FRAMES_SKIPPED.warning(
                "{frames} skipped; the first is {first}: {reason}",
                frames=format_count(len(skipped), "frame"),
                first=skipped[0]["frame"],
                reason=skipped[0]["reason"],
            )
        )
