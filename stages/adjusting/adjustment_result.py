"""Result of the adjustment: frames, metrics, and the decision to accept it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.depth_calibration import DepthAgreement
from scanloom.stages.adjusting.silhouette_offset import PhotoOffset
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.scans.model.depth_correction import DepthCorrection
from scanloom.stages.scans.model.scan import Camera, Frame, SkippedFrame


@dataclass(frozen=True)
class TransferError:
    """Percentiles of the transfer error, pixels.

    The transfer error is the distance between a keypoint and its match, reprojected from another frame.
    """

    median: float
    p75: float
    p90: float

    @classmethod
    def from_errors(cls, errors: NDArray[np.float64]) -> TransferError | None:
        """Compute the percentiles of errors (n,); None if there are no errors."""
        return cls(*(float(value) for value in np.percentile(errors, (50, 75, 90)))) if len(errors) else None


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Adjusted frames of a scan, with metrics.

    Attributes
    ----------
    frames : all frames, in order. Adjusted frames have a new `world_from_camera`, and a `shutter_turn` if
        `is_shutter_adjusted`. If `is_camera_adjusted`, frames with colour, depth and a pose have a new
        `color_camera` and `color_from_depth`.
    adjusted_indices : indices of the frames whose poses were adjusted.
    accepted : the result is better and is used; otherwise `frames` are the given frames.
    reason : reason for the decision, a sentence.
    is_camera_adjusted : the colour camera was adjusted.
    is_shutter_adjusted : rolling-shutter rotations were adjusted.
    offset_before, offset_after : photo-to-depth offset at silhouettes; None if too few were found.
        `measure_offset` is also None if the colour camera did not change.
    error_before, error_after : transfer errors of held-out points. If no bundle adjustment ran,
        `error_before` is measured on a
        few frame pairs, and `error_after` is None.
    key_frame_count : number of frames in the bundle adjustment.
    point_count : number of tracks in the bundle adjustment, each seen in at least three key frames.
    unadjusted_count : number of frames that keep their given pose; 0 if no pose was adjusted.
    skipped : unusable frames, with reasons.
    camera_before, camera_after : colour camera of the first adjusted frame.
    translation_mm, rotation_deg : median and maximum change of the poses, millimetres and degrees.
    readout_rotation_deg : median and maximum rotation from the first to the last image row, degrees.
    seconds : run time.
    diagnostics : warnings.
    depth_correction : correction of depth that the frames have now; None if depth stays as given.
    depth_agreement : agreement of overlapping depth maps without and with a correction, used or not; None if
        none was fitted.
    """

    frames: tuple[Frame, ...]
    adjusted_indices: tuple[int, ...]
    accepted: bool
    reason: str
    is_camera_adjusted: bool
    is_shutter_adjusted: bool
    offset_before: PhotoOffset | None
    offset_after: PhotoOffset | None
    error_before: TransferError | None
    error_after: TransferError | None
    key_frame_count: int
    point_count: int
    unadjusted_count: int
    skipped: tuple[SkippedFrame, ...]
    camera_before: Camera | None
    camera_after: Camera | None
    translation_mm: tuple[float, float]
    rotation_deg: tuple[float, float]
    readout_rotation_deg: tuple[float, float]
    seconds: float
    diagnostics: tuple[Diagnostic, ...] = ()
    depth_correction: DepthCorrection | None = None
    depth_agreement: DepthAgreement | None = None

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return the metrics for the report, as JSON values."""
        return {
            "accepted": self.accepted,
            "why": self.reason,
            "frames": len(self.frames),
            "frames_adjusted": len(self.adjusted_indices),
            "frames_not_adjusted": self.unadjusted_count,
            "frames_unusable": [one.to_dict() for one in self.skipped],
            "key_frames": self.key_frame_count,
            "points": self.point_count,
            "outline_offset_before": self.offset_before and self.offset_before.to_dict(),
            "outline_offset_after": self.offset_after and self.offset_after.to_dict(),
            "transfer_before": self.error_before and _add_px_suffix(self.error_before),
            "transfer_after": self.error_after and _add_px_suffix(self.error_after),
            "color_camera_adjusted": self.is_camera_adjusted,
            "color_camera_before": self.camera_before and asdict(self.camera_before),
            "color_camera_after": self.camera_after and asdict(self.camera_after),
            "depth_corrected": self.depth_correction is not None,
            "depth_correction_percent": self.depth_correction
            and list(self.depth_correction.compute_range_percent()),
            "depth_distance_before_mm": self.depth_agreement and self.depth_agreement.before_mm,
            "depth_distance_after_mm": self.depth_agreement and self.depth_agreement.after_mm,
            "shutter_adjusted": self.is_shutter_adjusted,
            "shutter_rotation_median_deg": self.readout_rotation_deg[0],
            "shutter_rotation_max_deg": self.readout_rotation_deg[1],
            "translation_median_mm": self.translation_mm[0],
            "translation_max_mm": self.translation_mm[1],
            "rotation_median_deg": self.rotation_deg[0],
            "rotation_max_deg": self.rotation_deg[1],
        }


def _add_px_suffix(error: TransferError) -> dict[str, float]:
    return {f"{name}_px": value for name, value in asdict(error).items()}
