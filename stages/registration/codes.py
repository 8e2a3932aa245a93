"""Diagnostic codes of registration, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

SCAN_DEPTH_MOSTLY_EMPTY = Code(
    "scan.depth-mostly-empty",
    "Depth maps without depth",
    """
All pixels are 0, or have the value that marks missing depth (`depth_missing` in
[scan.json](../formats/scans.md), if it is not 0). The sensor was too close (most need 20 to 30 cm), or in
sunlight, or the files are previews scaled for display.
""",
    "no pixel of the sampled frames has a depth; all are 0 or missing",
)
CAMERA_FOCAL_ESTIMATED = Code(
    "camera.focal-estimated",
    "The focal length was estimated",
    """
A warning. The scan has no camera intrinsics, and the guessed focal length was replaced by the one that fits
the frames best ([details](../stages/register.md#a-camera-that-nobody-stated)). The estimate needs ten frame
pairs that show the same surfaces from different sides. The ± is the spread between frame pairs; it does not
include errors common to all pairs (lens distortion, or colour and depth that are not registered to each
other). If you know the camera, set `scan.intrinsics`.
""",
    (
        "the focal length is estimated to be 521.3 ± 2.1 px from 38 frame pairs (guess: 525 px); the "
        "principal point is assumed at the image centre. If the intrinsics are known, set "
        "scan.intrinsics=fx,fy,cx,cy"
    ),
)
REGISTER_TURNING_OBJECT = Code(
    "register.turning-object",
    "An object that turns",
    """
Exit code 1, and no mesh. An object that moves in front of a static camera is registered alone, but its poses
could not be estimated, or no such object was found. Features of the object must match from one step to the
next: turn it by at most 20° per step, give it texture, or put a sheet with dots or print below it. Such marks
match after any rotation. The object must be rigid, and must turn together with its support.
`register.subject=object` requests an object, `scene` the whole scene. A hand that holds the object often
hides too much of it. A mesh of one side needs no poses: use a single frame (`scan.first` and `scan.last` with
the same number).
""",
    (
        "scans/mug: an object moves in front of a static camera, but its poses cannot be estimated (no "
        "motion of a rigid object fits the frames). Turn the object in smaller steps, on printed paper, or "
        "use register.subject=scene to register the whole scene. A mesh of one side needs no poses: "
        "scan.first=103 with scan.last=103 uses a single frame."
    ),
)
REGISTER_OBJECT_UNMATCHED = Code(
    "register.object-unmatched",
    "Frames that do not match on the moving object",
    """
A warning, before the poses are estimated. An object moves in front of a static camera, but most frames have
too few features or marks on it that also appear in neighbouring frames. Their poses then depend on the shape
of the object alone: registration takes minutes, and often fails ([turntables](../capturing.md#turntables)).
The warning names the frames, and the longest sequence that matches. Causes: a plain or shiny object, a hand
that hides it, or steps of more than 20°.
""",
    (
        "183 of 207 frames match no other frame on the moving object (000000 to 000121, 000146 to 000206): "
        "only surfaces can give their poses, which may fail; scan.first=122 with scan.last=145 uses the "
        "longest sequence that matches. Texture on the object, or printed paper below it, makes all frames "
        "match."
    ),
)
REGISTER_FRAMES_UNUSABLE = Code(
    "register.frames-unusable",
    "Frames that are black, over-exposed or empty",
    """
Usually the first frames after the sensor was switched on. `scan.first` skips the beginning of a scan.
""",
    "4 colour images are black (first: frame 000000)",
)
REGISTER_FRAMES_REPEATED = Code(
    "register.frames-repeated",
    "Frames that were written twice",
    """
A warning. Recorders that are faster than the sensor store a frame again. Such frames add no information.
""",
    "12 frames are copies of the previous frame",
)
REGISTER_NOT_CONNECTED = Code(
    "register.not-connected",
    "Frames that could not be connected",
    """
A warning (exit code 0; 1 with `--strict`). The frames form several pieces (connected components). Each piece
is fused separately (`pieces/`); the largest is processed further, or the one that `register.piece` selects.
The chain breaks if the camera moves too far between two frames, sees only a flat wall, or is too close.
Record again more slowly, with more of the room in view. A smaller `register.max_depth` excludes far, noisy
surfaces.
""",
    (
        "the frames form 2 pieces that could not be connected; piece 1 is used (register.piece=2 selects "
        "another). The chain broke at frame 000153: only 4% of the surface overlaps with the other view"
    ),
)
REGISTER_AMBIGUOUS_PLACES = Code(
    "register.ambiguous-places",
    "Places that look the same",
    """
A warning. Loop closures were rejected because they do not fit the path of the camera. If the mesh has double
walls, the path has drifted: record again so that the camera returns to its start, and views the start from
the same side.
""",
    (
        "5 of 8 loop closures do not fit the path of the camera: the path has drifted, or different places "
        "look the same; see path.ply"
    ),
)
REGISTER_NOT_BETTER = Code(
    "register.not-better",
    "Refined poses that are not better",
    """
A warning. `register.refine` found no poses that are better on held-out points (one matched point in eight).
The poses of the scan stay, bit for bit; no action is needed. If these poses are known to be wrong,
`register.enabled=true` without `register.refine` estimates new ones.
""",
    (
        "refined poses are not better, so the given poses are kept: the median error of held-out points is "
        "0.61 px, with the given poses 0.60 px"
    ),
)
REGISTER_MOTION_UNCLEAR = Code(
    "register.motion-unclear",
    "Parts of the view move independently",
    """
A warning. The motion of most of the surface is used as the motion of the camera. An object that turns in
front of a static camera is registered alone by default ([capturing](../capturing.md#turntables)). This
warning appears if it is not: with `register.subject=scene`, or if hardly anything behind the object matches.
A person who walks by is no problem, unless the person fills the view.
""",
    (
        "in 14 of 60 steps parts of the view move differently: something moves independently (a person, a "
        "turntable), or colour and depth do not belong together. The motion of most of the surface is used "
        "as the motion of the camera"
    ),
)
REGISTER_CAMERA_STILL = Code(
    "register.camera-still",
    "The camera does not move",
    """
A warning. All frames show the scene from one position. If an object turns in front of the camera, register it
alone with `register.subject=object`. Otherwise record again, and walk around the scene.
""",
    (
        "the camera does not move: all frames show the scene from one position; if an object turns in front "
        "of the camera, use register.subject=object"
    ),
)
REGISTER_PAIR_NOT_ALIGNED = Code(
    "register.pair-not-aligned",
    "Two frames cannot be aligned",
    """
The reason for a broken chain. Surfaces that slide along themselves (a wall, a table top, a pipe) do not
constrain the motion: keep edges and corners in view. Little overlap means that the camera moved too fast.
""",
    "no keypoints match, and only 12% of the surface overlaps with the other view",
)
