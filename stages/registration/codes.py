"""Diagnostic codes of registration, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

SCAN_DEPTH_MOSTLY_EMPTY = Code(
    "scan.depth-mostly-empty",
    "Depth maps without depth",
    """
All pixels are 0, or at the value that marks missing depth (`depth_missing` in
[scan.json](../formats/scans.md) names others than 0). The sensor was too near (most need 20 to 30 cm), in
sunlight, or the files are previews that were scaled for the eye.
""",
    "no pixel of the sampled frames has a depth; all are 0 or missing",
)
CAMERA_FOCAL_ESTIMATED = Code(
    "camera.focal-estimated",
    "The focal length was estimated",
    """
A warning. Nobody stated the intrinsics, and the guess was replaced by the focal length that fits the
frames best ([a camera that nobody stated](../stages/register.md#a-camera-that-nobody-stated)). It needs
ten pairs of frames that show the same from different sides. The ± is the spread between pairs of frames;
errors common to all (a lens, colour and depth that are not registered to each other) are not in it. State
the camera with `scan.intrinsics` if you know it.
""",
    (
        "the focal length is estimated to be 521.3 ± 2.1 px by 38 couples of views, in place of the 525 px "
        "that were guessed; the middle of the image is taken for its centre. What is known better: "
        "scan.intrinsics=fx,fy,cx,cy"
    ),
)
REGISTER_TURNING_OBJECT = Code(
    "register.turning-object",
    "An object that turns",
    """
Exit code 1, and no mesh: the background stands still and tells nothing, and the moving object could not
be put together. The object has to be recognised from one step to the next: turn it by 20° at most, give
it texture, or put a sheet with dots or print under it, whose marks are recognised however far it turns.
It must be rigid, and turn as one with its support. `register.subject=object` asks for this, `scene` for
the room.
""",
    (
        "scans/mug: a thing moves before a camera that stands still, and cannot be put together (no motion "
        "of it as one rigid thing fits what the frames show). Turn it in smaller steps, on printed paper; "
        "register.subject=scene takes all that is seen."
    ),
)
REGISTER_FRAMES_UNUSABLE = Code(
    "register.frames-unusable",
    "Frames that are black, over-exposed or empty",
    """
Most often the sensor's first frames after it was switched on. `scan.first` leaves out the beginning.
""",
    "4 colour images are black, the first is that of frame 000000",
)
REGISTER_FRAMES_REPEATED = Code(
    "register.frames-repeated",
    "Frames that were written twice",
    """
A warning. A recorder that is slower than the sensor writes a frame again. Such frames add nothing.
""",
    "12 frames are the same as the one before",
)
REGISTER_NOT_CONNECTED = Code(
    "register.not-connected",
    "Frames that could not be joined",
    """
A warning (exit code 0; 1 with `--strict`): connected pieces are fused apart (`pieces/`), and the largest
is processed further (`register.piece` names another). The chain breaks where the camera moved too far
between two frames, where the view held only a flat wall, or where it was too near. Record again more
slowly, with more of the room in view; `register.max_depth` can also leave out surfaces that are far and
noisy.
""",
    (
        "the frames fall into 2 pieces that could not be joined; piece 1 is used (register.piece=2 for "
        "another). The chain broke at 000153: only 4% of the surface meets the other view's"
    ),
)
REGISTER_AMBIGUOUS_PLACES = Code(
    "register.ambiguous-places",
    "Places that look the same",
    """
A warning. Loops were refused since they do not fit the path. If the mesh has double walls, the path has
drifted: record so that the camera comes back to where it began, and looks at it from the same side.
""",
    (
        "5 of 8 places that look as if they were seen before do not fit the path: it "
        "is bent, or the scene holds things that look the same; see path.ply"
    ),
)
REGISTER_NOT_BETTER = Code(
    "register.not-better",
    "Refined poses that are not better",
    """
A warning. `register.refine` found no poses that are better on held-out points (one recognised point in
eight is kept apart), so that the scan's own poses stay, to the bit. Nothing has to be done. If they are
known to be wrong, `register.enabled=true` without `register.refine` finds them anew.
""",
    (
        "the poses found are not better, those given are kept: points that are recognised land 0.61 px from "
        "their matches, 0.60 px with those given"
    ),
)
REGISTER_MOTION_UNCLEAR = Code(
    "register.motion-unclear",
    "Parts of the view move on their own",
    """
A warning. The motion of most of the surface is taken for the camera's motion. Where the camera stands
still and an object is turned before it, the object is registered alone without being asked
([capturing](../capturing.md#turntables)); this warning appears where it is not: with
`register.subject=scene`, or where hardly anything behind the object can be recognised. A person who walks
by is no problem, unless he fills the view.
""",
    (
        "in 14 of 60 steps parts of the view move differently: something moves on its "
        "own (a person, a turntable), or colour and depth do not belong together. "
        "What most of the surface does was taken for the camera's motion"
    ),
)
REGISTER_CAMERA_STILL = Code(
    "register.camera-still",
    "The camera does not move",
    """
A warning. All frames show the scene from one position. If an object was turned before the camera,
register it alone with `register.subject=object`; else record again, and walk around.
""",
    (
        "the camera does not move: all frames show the scene from one place; a thing that was turned in "
        "front of it is registered alone with register.subject=object"
    ),
)
REGISTER_PAIR_NOT_ALIGNED = Code(
    "register.pair-not-aligned",
    "Two frames cannot be placed to each other",
    """
The reason behind a broken chain. Surfaces that slide along themselves (a wall, a table top, a pipe) do
not constrain the motion: keep edges and corners in view. Little overlap means that the motion was too
fast.
""",
    "nothing is recognised in both, and only 12% of the surface meets the other view's",
)
