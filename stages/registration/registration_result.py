"""Result of registration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.registration.focal_length import FocalEstimate
from scanloom.stages.scans.model.scan import Frame, SkippedFrame


@dataclass(frozen=True, eq=False)
class Registration:
    """Posed frames of a scan, with metrics.

    Attributes
    ----------
    frames : posed frames of the selected component. The world is the first frame's camera, or the world of
        the refined poses.
    frame_indices : indices of these frames in the scan.
    skipped : all other frames, with reasons.
    pieces : frame names of each connected component, the largest first. Poses of different components are
        unrelated.
    other_pieces : frames by index of each other component, by its number from 1, posed in separate worlds.
    edges : accepted and rejected motions: source, target (indices in the scan), fitness, rmse_m (None if the
        motion comes from matched points alone), points, is_loop, is_used.
    breaks : frames that could not be aligned to their predecessor, with reasons.
    key_frames : indices of the key frames in the scan.
    focal_estimate : estimated focal length of the depth camera, as in `frames`; None if it was not estimated.
    subject : `scene`, or `object`: frames then have masks of the object, and the world moves with the object.
    seconds : run time.
    diagnostics : warnings.
    """

    frames: tuple[Frame, ...]
    frame_indices: tuple[int, ...]
    skipped: tuple[SkippedFrame, ...]
    pieces: tuple[tuple[str, ...], ...]
    other_pieces: dict[int, dict[int, Frame]]
    edges: tuple[dict[str, Any], ...]
    breaks: tuple[SkippedFrame, ...]
    key_frames: tuple[int, ...]
    subject: str = "scene"
    focal_estimate: FocalEstimate | None = None
    seconds: float = 0.0
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return the metrics for the report, as JSON values."""
        used = [edge for edge in self.edges if edge["is_used"]]
        centres = np.array(
            [pose[:3, 3] for frame in self.frames if (pose := frame.world_from_camera) is not None]
        )
        return {
            "subject": self.subject,
            "focal": self.focal_estimate and self.focal_estimate.to_dict(),
            "frames": len(self.frames),
            "frames_skipped": [one.to_dict() for one in self.skipped],
            "pieces": [len(piece) for piece in self.pieces],
            "key_frames": len(self.key_frames),
            "edges": len(used),
            "loops": sum(edge["is_loop"] for edge in used),
            "loops_rejected": sum(not edge["is_used"] for edge in self.edges),
            "median_fitness": _compute_median([edge["fitness"] for edge in used]),
            "median_rmse_m": _compute_median([edge["rmse_m"] for edge in used if edge["rmse_m"] is not None]),
            "path_length_m": float(np.linalg.norm(np.diff(centres, axis=0), axis=1).sum())
            if len(centres)
            else 0.0,
            "breaks": [one.to_dict() for one in self.breaks],
        }


def _compute_median(values: Sequence[float]) -> float:
    return float(np.median(values)) if len(values) else 0.0
