"""Diagnostic codes of the adjustment, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

ADJUST_IMAGES_MISMATCH = Code(
    "adjust.images-mismatch",
    "Poses or images of another scan",
    """
A warning, and poses stay as given: points are recognised from frame to frame, but not where depth and
poses put them. The poses are of another scan, or paired with the wrong frames, or depth is of another
size or unit.
""",
    (
        "not adjusted: poses would move by 312 mm and 41.0° (median), far more than pose_deviation "
        "allows: they are of another scan, or taken the wrong way round"
    ),
)
