"""Result of the adjustment: frames, metrics, and the decision to accept it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.offset import Offset
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.printing import by_figures, table
from scanloom.stages.scans.model.scan import Camera, Frame, SkippedFrame


@dataclass(frozen=True)
class Transfer:
    """Percentiles of the transfer error, pixels.

    The transfer error is the distance between a keypoint and its match, reprojected from another frame.
    """

    median: float
    p75: float
    p90: float

    @classmethod
    def of(cls, errors: NDArray[np.float64]) -> Transfer | None:
        """Compute the percentiles of errors (n,); None if there are no errors."""
        return cls(*(float(value) for value in np.percentile(errors, (50, 75, 90)))) if len(errors) else None


@dataclass(frozen=True, eq=False)
class Adjusted:
    """Adjusted frames of a scan, with metrics.

    Attributes
    ----------
    frames : all frames, in order. Adjusted frames have a new `world_from_camera`, and a `shutter_turn` if
        `has_turns`. If `has_camera`, frames with colour, depth and a pose have a new `color_camera` and
        `color_from_depth`.
    places : indices of the frames whose poses were adjusted.
    accepted : the result is better and is used; otherwise `frames` are the given frames.
    why : reason for the decision, a sentence.
    has_camera : the colour camera was adjusted.
    has_turns : rolling-shutter rotations were adjusted.
    offset_before, offset_after : photo-to-depth offset at silhouettes; None if too few were found.
        `offset_after` is also None if the colour camera did not change.
    before, after : transfer errors of held-out points. If no bundle adjustment ran, `before` is measured on a
        few frame pairs, and `after` is None.
    key_frames : number of frames in the bundle adjustment.
    points : number of tracks in the bundle adjustment, each seen in at least three key frames.
    unplaced : number of frames that keep their given pose; 0 if no pose was adjusted.
    skipped : unusable frames, with reasons.
    camera_before, camera_after : colour camera of the first adjusted frame.
    moved_mm, moved_deg : median and maximum change of the poses, millimetres and degrees.
    turns_deg : median and maximum rotation from the first to the last image row, degrees.
    seconds : run time.
    diagnostics : warnings.
    """

    frames: tuple[Frame, ...]
    places: tuple[int, ...]
    accepted: bool
    why: str
    has_camera: bool
    has_turns: bool
    offset_before: Offset | None
    offset_after: Offset | None
    before: Transfer | None
    after: Transfer | None
    key_frames: int
    points: int
    unplaced: int
    skipped: tuple[SkippedFrame, ...]
    camera_before: Camera | None
    camera_after: Camera | None
    moved_mm: tuple[float, float]
    moved_deg: tuple[float, float]
    turns_deg: tuple[float, float]
    seconds: float
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return the metrics for the report, as JSON values."""
        return {
            "accepted": self.accepted,
            "why": self.why,
            "frames": len(self.frames),
            "frames_adjusted": len(self.places),
            "frames_unplaced": self.unplaced,
            "frames_unusable": [one.figures() for one in self.skipped],
            "key_frames": self.key_frames,
            "points": self.points,
            "outlines_off_before": self.offset_before and self.offset_before.figures(),
            "outlines_off_after": self.offset_after and self.offset_after.figures(),
            "transfer_before": self.before and _in_px(self.before),
            "transfer_after": self.after and _in_px(self.after),
            "color_camera_adjusted": self.has_camera,
            "color_camera_before": self.camera_before and asdict(self.camera_before),
            "color_camera_after": self.camera_after and asdict(self.camera_after),
            "shutter_adjusted": self.has_turns,
            "shutter_turn_median_deg": self.turns_deg[0],
            "shutter_turn_most_deg": self.turns_deg[1],
            "moved_median_mm": self.moved_mm[0],
            "moved_most_mm": self.moved_mm[1],
            "turned_median_deg": self.moved_deg[0],
            "turned_most_deg": self.moved_deg[1],
        }


def _in_px(transfer: Transfer) -> dict[str, float]:
    return {f"{name}_px": value for name, value in asdict(transfer).items()}
