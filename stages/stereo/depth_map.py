"""Depth map with confidence and camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.scans.model.scan import Camera, ColorImage, DepthImage
from scanloom.stages.stereo.opencv_matching import SearchRange


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Depth of a rectified left image, or of a single view.

    Attributes
    ----------
    depth : (h, w) float32 metres along the optical axis; 0 where missing or rejected.
    confidence : (h, w) uint8, 0 (no measurement) to 255.
    disparity : (h, w) float32 pixels, x of the left minus x of the right image; NaN where missing.
    color : (h, w, 3) uint8 RGB, the rectified left image.
    camera : camera of the rectified left image.
    rectified_from_left : (3, 3) float64, rotation from the calibrated to the rectified left camera.
    search : disparities that were tried.
    min_depth, max_depth : metres, range of measurable depth. It follows from the search range, the expected
        error and the parameters.
    filled : (h, w) bool, pixels filled by a monocular network, from silhouettes or from planes, with a
        confidence of 1; None if all depth is measured.
    diagnostics : warnings about this image. Warnings about the whole scan are only emitted.
    """

    depth: DepthImage
    confidence: NDArray[np.uint8]
    disparity: NDArray[np.float32]
    color: ColorImage
    camera: Camera
    rectified_from_left: NDArray[np.float64]
    search: SearchRange
    min_depth: float
    max_depth: float
    filled: NDArray[np.bool_] | None = None
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return JSON-ready statistics for reports, with units in the keys."""
        used = self.depth > 0
        return {
            "width_px": self.camera.width,
            "height_px": self.camera.height,
            "min_disparity_px": self.search.lowest,
            "disparities_px": self.search.count,
            "min_depth_m": self.min_depth,
            "max_depth_m": self.max_depth,
            "matched_ratio": float(np.count_nonzero(self.confidence) / self.confidence.size),
            "used_ratio": float(np.count_nonzero(used) / used.size),
            **({} if self.filled is None else {"filled_ratio": float(self.filled.mean())}),
            "median_depth_m": float(np.median(self.depth[used])) if used.any() else None,
        }
