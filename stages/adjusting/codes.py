"""Codes of the diagnostics of adjustment, with explanations."""

from __future__ import annotations

from stages.diagnostics.diagnostic import Code

ADJUST_NOT_BETTER = Code(
    "adjust.not-better",
    "Adjusting found nothing better",
    """
No error: poses stay as they were given, and the camera if it is not said to be moved; `why` in the
figures of `adjust` says so. Nothing has to be
done, unless colours on the mesh are doubled; then look at the poses and at the place of the colour camera.
""",
    "fewer than two frames have colour, depth and a pose",
)
ADJUST_IMAGES_MISMATCH = Code(
    "adjust.images-mismatch",
    "Poses or images of something else",
    """
A warning: points are recognised from frame to frame, but not where depth and poses put them. Poses of
another scan,
poses that are paired with the wrong frames, or depth of another size or unit.
""",
    (
        "poses would move by … mm and …° (median), far more than pose_deviation "
        "allows: they are of another scan, or taken the wrong way round"
    ),
)
