"""Codes of the diagnostics of registration, with explanations."""

from __future__ import annotations

from stages.diagnostics.diagnostic import Code

SCAN_DEPTH_MOSTLY_EMPTY = Code(
    "scan.depth-mostly-empty",
    "Depth maps of which nothing, or little, is left",
    """
All pixels are 0, or at the value that marks missing depth (`depth_missing` in
[scan.json](../formats/scans.md) names
others than 0). The sensor was too near (most need 20 to 30 cm), in sunlight, or the files are previews
that were scaled
for the eye.
""",
    "no pixel of the sampled frames has a depth; all are 0 or missing",
)
REGISTER_TURNING_OBJECT = Code(
    "register.turning-object",
    "A thing that turns",
    """
Exit code 1, and no mesh: what is behind stands still and tells nothing, and what moves could not be put
together. The
thing has to be recognised from one step to the next: turn it by 20° at most, give it texture, or put a
sheet with dots
or print under it, whose marks are recognised however far it turns. It must be rigid, and turn as one with
what it
stands on. `register.subject=object` asks for this, `scene` for the room.
""",
    (
        "…a thing moves before a camera that stands still, and cannot be put "
        "together: … Turn it in smaller steps, on printed paper; "
        "register.subject=scene takes all that is seen."
    ),
)
REGISTER_FRAMES_UNUSABLE = Code(
    "register.frames-unusable",
    "Frames that are black, equal or empty",
    """
The sensor's first frames after it was switched on, or a recorder that wrote a frame twice. `scan.first`
leaves out the
beginning.
""",
    "… colour images are black, the first is that of frame …",
)
REGISTER_NOT_CONNECTED = Code(
    "register.not-connected",
    "Frames that could not be joined",
    """
A warning (exit code 0; 1 with `--strict`): pieces are fused apart (`pieces/`), and the largest goes on
(`register.piece` names another). The chain
breaks where the camera moved too far between two frames, where the view held only a flat wall, or where
it was too
near. Record again more slowly, with more of the room in view; `register.max_depth` can also leave out
what is far and
noisy.
""",
    (
        "no two of its … frames can be placed to each other (frame …: …). If poses "
        "are known, name them with scan.poses=FILE."
    ),
)
REGISTER_AMBIGUOUS_PLACES = Code(
    "register.ambiguous-places",
    "Places that look the same",
    """
Loops were refused since they do not fit the path. If the mesh has double walls, the path has drifted:
record so that
the camera comes back to where it began, and looks at it from the same side.
""",
    (
        "… of … places that look as if they were seen before do not fit the path: it "
        "is bent, or the scene holds things that look the same; see path.ply"
    ),
)
REGISTER_NOT_BETTER = Code(
    "register.not-better",
    "Refined poses that are not better",
    """
`register.refine` found nothing that is better on points it was not found by (one recognised point in
eight is kept
apart), so that the scan's own poses stay, to the bit. Nothing has to be done. If they are known to be wrong,
`register.enabled=true` without `register.refine` finds them anew.
""",
    "the poses found are not better, those given are kept: …",
)
REGISTER_MOTION_UNCLEAR = Code(
    "register.motion-unclear",
    "Something moves on its own, or the camera does not move",
    """
What most of the surface does is taken for the camera's motion. Where the camera stands still and a thing
is turned
before it, that thing is registered alone without being asked ([capturing](../capturing.md#turntables));
these are said
where it is not: with `register.subject=scene`, or where hardly anything behind the thing can be
recognised. A person
who walks by is no matter, unless he fills the view.
""",
    (
        "in … of … steps parts of the view move differently: something moves on its "
        "own (a person, a turntable), or colour and depth do not belong together. "
        "What most of the surface does was taken for the camera's motion"
    ),
)
REGISTER_PAIR_NOT_ALIGNED = Code(
    "register.pair-not-aligned",
    "Why two frames cannot be placed to each other",
    """
The reason behind a broken chain. Surfaces that slide along themselves (a wall, a table top, a pipe) hold
no motion:
keep edges and corners in view. Little overlap is too fast a motion.
""",
    "…only … of the surface meets the other view's",
)
