"""What registration finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.printing import by_figures, table
from scanloom.stages.registration.focal import Focal
from scanloom.stages.scans.model.scan import Frame, SkippedFrame


@dataclass(frozen=True, eq=False)
class Registration:
    """Poses of a scan's frames.

    Attributes
    ----------
    frames : those of the piece that is used, each with a pose. The world is the first one's camera, or that
        of the poses that were refined.
    places : of these frames in the scan.
    skipped : all others, and why.
    pieces : names of the frames of each piece, the largest first: poses of different pieces say nothing
        about each other.
    apart : the other pieces by their numbers from 1: frames by their places, with poses in their own world.
    edges : motions that were used or found wrong: source, target (places in the scan), fitness, rmse_m (None
        where recognised points alone tell the motion), points, is_loop, is_used.
    breaks : where a frame could not be placed to the one before: its name, and why.
    key_frames : places in the scan.
    focal : that of the depth camera, where nobody stated it and the frames tell it: theirs has it.
    subject : `scene`, or `object`: the frames then have masks of it, and the world is its own.
    seconds : of the work.
    diagnostics : what is odd.
    """

    frames: tuple[Frame, ...]
    places: tuple[int, ...]
    skipped: tuple[SkippedFrame, ...]
    pieces: tuple[tuple[str, ...], ...]
    apart: dict[int, dict[int, Frame]]
    edges: tuple[dict[str, Any], ...]
    breaks: tuple[SkippedFrame, ...]
    key_frames: tuple[int, ...]
    subject: str = "scene"
    focal: Focal | None = None
    seconds: float = 0.0
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return what a report says of it, as JSON values."""
        used = [edge for edge in self.edges if edge["is_used"]]
        centres = np.array(
            [pose[:3, 3] for frame in self.frames if (pose := frame.world_from_camera) is not None]
        )
        return {
            "subject": self.subject,
            "focal": self.focal and self.focal.figures(),
            "frames": len(self.frames),
            "frames_skipped": [one.figures() for one in self.skipped],
            "pieces": [len(piece) for piece in self.pieces],
            "key_frames": len(self.key_frames),
            "edges": len(used),
            "loops": sum(edge["is_loop"] for edge in used),
            "loops_refused": sum(not edge["is_used"] for edge in self.edges),
            "median_fitness": _median([edge["fitness"] for edge in used]),
            "median_rmse_m": _median([edge["rmse_m"] for edge in used if edge["rmse_m"] is not None]),
            "path_m": float(np.linalg.norm(np.diff(centres, axis=0), axis=1).sum()) if len(centres) else 0.0,
            "breaks": [one.figures() for one in self.breaks],
        }


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if len(values) else 0.0
