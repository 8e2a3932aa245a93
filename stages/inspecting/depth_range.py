"""Depth range, missing pixels and plausible unit of the sampled depth maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.files.images import read_raw_depth
from scanloom.stages.inspecting.codes import SCALE_DEPTH_UNIT_SUSPECT, SCAN_DEPTH_MARKER_UNDECLARED
from scanloom.stages.printing import format_by_fields
from scanloom.stages.registration.codes import SCAN_DEPTH_MOSTLY_EMPTY
from scanloom.stages.scans.codes import SCAN_DEPTH_MISSING
from scanloom.stages.scans.model.scan import DepthImage, Frame, Scan

_PLAUSIBLE_MEDIAN_M = (0.1, 20.0)
# Depth units per metre of known formats, for hints about implausible depth.
KNOWN_DEPTH_SCALES = {
    1000.0: "millimetres",
    10000.0: "0.1 mm",
    4000.0: "0.25 mm",
    5000.0: "TUM RGB-D",
    6553.5: "Replica",
    256.0: "KITTI depth",
    80000.0: "0.1 mm, bits rotated",
    1.0: "metres",
}


@dataclass(frozen=True)
class DepthRange:
    """Depth statistics of the sampled frames.

    Attributes
    ----------
    sampled_frames : number of sampled frames with a depth map.
    near_m, median_m, far_m : 2nd, 50th and 98th percentile of the depth, metres.
    missing_ratio : ratio of pixels without depth, 0 to 1.
    """

    sampled_frames: int
    near_m: float
    median_m: float
    far_m: float
    missing_ratio: float

    __repr__ = format_by_fields


def measure_depth_range(
    maps: Sequence[DepthImage | None], scan: Scan, *, with_hints: bool
) -> DepthRange | None:
    """Measure the depth range of the sampled depth maps.

    Emits a warning if the range is implausible or there is no depth.

    Parameters
    ----------
    maps : (h, w) depth maps in metres, or None.
    scan : scan that the maps belong to.
    with_hints : True to name units that would make the range plausible.

    Returns
    -------
    The range; None if no pixel has depth.
    """
    present = [depth for depth in maps if depth is not None]
    if not present:
        emit(SCAN_DEPTH_MISSING.warning("no sampled frame has a depth map"))
        return None
    values = np.concatenate([depth.ravel() for depth in present])
    valid = values[values > 0]
    if not valid.size:
        emit(
            SCAN_DEPTH_MOSTLY_EMPTY.warning("no pixel of the sampled frames has depth; all are 0 or missing")
        )
        return None
    near, median, far = (float(value) for value in np.percentile(valid, (2, 50, 98)))
    measured = DepthRange(len(present), near, median, far, 1 - valid.size / values.size)
    low, high = _PLAUSIBLE_MEDIAN_M
    if low <= median <= high or not scan.is_metric:
        return measured
    scale = scan.frames[0].depth_scale
    hints = [
        f"{other:g} ({name})"
        for other, name in KNOWN_DEPTH_SCALES.items()
        if other != scale and 0.3 <= median * scale / other <= 8
    ]
    emit(
        SCALE_DEPTH_UNIT_SUSPECT.warning(
            "the median depth is implausible: {median:.3g} m with {scale:g} depth units per metre",
            remedy="scan.depth_scale={hints} would make it plausible" if hints and with_hints else "",
            median=median,
            scale=scale,
            hints=" or ".join(hints),
        )
    )
    return measured


def report_markers(frames: Sequence[Frame]) -> None:
    """Warn about undeclared markers for missing depth.

    A marker is the maximum raw value if it fills more than 1 % of the pixels.
    """
    raw_maps = [(frame, read_raw_depth(frame.depth)) for frame in frames if isinstance(frame.depth, Path)]
    raw_maps = [(frame, raw) for frame, raw in raw_maps if raw.dtype.kind == "u"]
    if not raw_maps:
        return
    max_value = max(int(raw.max(initial=0)) for _, raw in raw_maps)
    share = sum(np.count_nonzero(raw == max_value) for _, raw in raw_maps) / sum(
        raw.size for _, raw in raw_maps
    )
    if share > 0.01 and max_value not in (0, *raw_maps[0][0].depth_missing):
        emit(
            SCAN_DEPTH_MARKER_UNDECLARED.warning(
                "{share:.0%} of the depth pixels have the maximum value {top}, which probably marks missing "
                "depth",
                share=share,
                top=max_value,
            )
        )
