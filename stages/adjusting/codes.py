"""Diagnostic codes of the adjustment, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

ADJUST_IMAGES_MISMATCH = Code(
    "adjust.images-mismatch",
    "Poses or images of another scan",
    """
A warning; poses stay as given. Keypoints match between frames, but their 3-D positions from depth and poses
disagree. The poses belong to another scan, are paired with the wrong frames or have another pose convention,
or the depth has another size or unit.
""",
    (
        "not adjusted: poses would move by 312 mm and 41.0° (median), far more than adjust.pose_sigma "
        "allows; they belong to another scan or have another pose convention"
    ),
)
