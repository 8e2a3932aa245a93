"""Codes of the diagnostics of inspection and coverage, with explanations."""

from __future__ import annotations

from stages.diagnostics.diagnostic import Code

POSE_INEXACT = Code(
    "pose.inexact",
    "Poses that are inexact",
    """
Whole patches of depth lie off, which noise does not do: the clock of a tracker was behind, or it drifts.
Walls come out double,
edges round. Where the stage [adjust](../stages/adjust.md) recognises enough in the images it puts that
right by itself, and nothing is
said; things without texture are brought nearer by their surfaces.
""",
    (
        "by the poses, surfaces of one frame lie … of their distance off another's "
        "(median): they are inexact; register.enabled=true with register.refine=true "
        "brings them nearer by the surfaces"
    ),
)
POSE_CONVENTION_SUSPECT = Code(
    "pose.convention-suspect",
    "Poses that seem to be meant another way",
    """
Depth of one frame was carried into another by the poses as given, inverted, with flipped axes, and the
last pose first; of single
views, points that two photos show were looked for on each other's epipolar lines. Another way fits
clearly better. A run stops
at that, since the mesh would be scattered. `--pose-convention` (`scan.pose_convention`) takes the poses
as they are meant:
`world-to-camera`, `y-up` (of a camera with y up and z back, as OpenGL has it), or `world-to-camera-y-up`;
the sentence says which.
Poses in another order have to be brought into that of the frames; where two ways are named, they fit
alike (a camera that moves evenly). If the check is wrong (a scene of one flat wall fits every way),
`--no-check-poses` goes on.
""",
    "the poses are probably …: so taken, the depth of one frame meets another's to … mm, as given to …",
)
COVERAGE_LIMITED = Code(
    "coverage.limited",
    "What is missing",
    """
`scanloom coverage OUT` goes on with the run that left OUT: the record in that run's cache says which scan
it was, and how it
was read. Name a scan that was moved with `--scan`, a cache that is elsewhere with `--cache`, and finish a
run that has no clean
mesh yet. Frames tell what is missing by their depth, in the world that the mesh is in.

A warning: of a mesh of more than 5 million triangles there is `coverage.ply`, which MeshLab and
CloudCompare read, and no `coverage.glb`,
and the page tells the places in its table alone.

These are no errors: they stand beside a frame in the list of [what is missing](../what-is-missing.md),
and say what it saw of a
place, or what kept it from that.
""",
    "the scan that these results were made from is not there any more; say with --scan where it is.",
)
