"""What adjustment gives: frames, figures, and whether they are better than what was given."""

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
    """How far from its match a point lands in another frame, pixels, at most: half, 3/4 and 9/10 of them."""

    median: float
    p75: float
    p90: float

    @classmethod
    def of(cls, errors: NDArray[np.float64]) -> Transfer | None:
        """Return it for errors (n,); None without any."""
        return cls(*(float(value) for value in np.percentile(errors, (50, 75, 90)))) if len(errors) else None


@dataclass(frozen=True, eq=False)
class Adjusted:
    """Frames of a scan with what was found.

    Attributes
    ----------
    frames : all of them, in order; those that were adjusted have another `world_from_camera`, if `has_turns`
        a `shutter_turn`; if `has_camera`, those with colour, depth and a pose have another
        `color_camera` and `color_from_depth`.
    places : of the frames whose poses were adjusted.
    accepted : what was found is better, and used; else the frames are as they were.
    why : the reason, a sentence.
    has_camera : the colour camera was adjusted, too.
    has_turns : so was how cameras turn while the rows of their images are read.
    offset_before, offset_after : where photos lie beside depth, by outlines; None where few tell, and of no
        `after` where that was not measured again.
    before, after : transfer errors of held-out points; of a few couples of frames, and no `after`, where that
        was enough.
    key_frames : frames that were adjusted together.
    points : that three of these or more show.
    unplaced : frames that keep the pose that was given.
    skipped : frames that cannot be used, and why.
    camera_before, camera_after : of the first frame's colour image.
    moved_mm, moved_deg : the median and the largest change of a pose.
    turns_deg : the median and the largest turn from the first row to the last.
    seconds : of the work.
    diagnostics : what is odd.
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
        """Return what a report says of it, as JSON values."""
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
