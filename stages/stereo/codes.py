"""Codes of the diagnostics of depth from pairs and views, with explanations."""

from __future__ import annotations

from stages.diagnostics.diagnostic import Code

DEPTH_NETWORK_NO_EFFECT = Code(
    "depth.network-no-effect",
    "A network of single images that fills in nothing",
    """
What it says of an image must fit the depth that was measured there, but for a scale and a shift. Where it
does not, measured depth
stays as it is, and nothing is added.
""",
    "… fills in nothing in some images: …",
)
DEPTH_NETWORK_UNUSABLE = Code(
    "depth.network-unusable",
    "A network of your own that cannot be run",
    """
The file of `depth.model` is no ONNX, is damaged, keeps its weights in other files, or takes more than it
may. What onnxruntime says follows in its own words: most
often an operation that its version does not know; export the network again with another opset, or install
a newer onnxruntime.
""",
    "…: networks are run by onnxruntime; install scanloom[network].",
)
DEPTH_NETWORK_UNIDENTIFIED = Code(
    "depth.network-unidentified",
    "A network that cannot be guessed",
    """
`probe` knows the usual ways alone. What a network's makers do to their images before it stands in their
example script.
""",
    "its inputs (…) are no image and no pair; write its sidecar by hand.",
)
DEPTH_RANGE_EMPTY = Code(
    "depth.range-empty",
    "A range of depth in which nothing can be matched",
    """
`depth.min_depth` and `depth.max_depth` are metres along the optical axis. The nearest depth decides how many
disparities are tried, and with that time and memory; what is nearer than it is lost.
""",
    "max_depth is … m, nearer than the rig's pairs can be matched (… m); give a larger one.",
)
DEPTH_COVERAGE_LOW = Code(
    "depth.coverage-low",
    "Depth covers little of what the views show",
    """
A warning, with what took the rest, the most first. What has *too little texture* is taken for a backdrop:
a plain wall,
a sky. Before a backdrop of one colour in all views, or with masks that cut the thing out, plain parts of
the thing itself
are measured; `depth.backdrop=0` measures plain parts of rooms, too. What *matched no other view surely*
wants more texture
or light, or views closer together: neighbours 5° to 15° apart suit best. What *is not sure, or is not
seen alike* by enough others is wrong, plain, or seen from too few sides: take more views, or lower
`depth.min_confidence` and
`depth.agreeing_views`.
""",
    "depth covers only … of …: …",
)
DEPTH_ALREADY_MEASURED = Code(
    "depth.already-measured",
    "Frames that need no matching",
    """
The scan has depth already: `fuse` takes it as it is.
""",
    "the scan has no stereo pairs; its depth maps need no matching.",
)
DEPTH_IMAGES_UNUSABLE = Code(
    "depth.images-unusable",
    "Images that are missing, of another size, or blurred",
    """
A frame without one of its images is skipped. Blurred frames give little depth and soft colours: move more
slowly, or
give more light ([capturing](../capturing.md)).
""",
    "frame … has no … image.",
)
DEPTH_PAIR_SWAPPED = Code(
    "depth.pair-swapped",
    "Left and right are exchanged, or the rows do not meet",
    """
A pair is matched along rows. If the cameras moved since they were calibrated, matching points lie on
different rows,
and less and less is found. Calibrate again; check that the images are in the size and the state (raw or
rectified) that
the calibration is for.
""",
    (
        "left and right images seem swapped: … of the corners found in both lie "
        "farther right in the right image. Exchange the images."
    ),
)
DEPTH_SCENE_INCOMPLETE = Code(
    "depth.scene-incomplete",
    "Much of a scene was not measured",
    """
A warning. Floors, walls and tops of tables without texture are filled between what was measured in and
around them, where that
lies on one plane and other views say the same. What is only nearly flat is made flat there. Confidence
maps have 1 there, so that
`scan.least_confidence=2` leaves it out.
""",
    (
        "… of the depth was measured by no view, and is that of planes on which "
        "measured depth around it lies (depth.on_planes=false leaves it out)"
    ),
)
DEPTH_OBJECT_INCOMPLETE = Code(
    "depth.object-incomplete",
    "Much of a thing was not measured",
    """
A warning. Where views stand all around a thing that masks or a backdrop cut out, what none of them
measured is where the
silhouettes end: right for what bulges, too far out for what is hollow. Confidence maps have 1 there, so that
`scan.least_confidence=2` leaves it out. More views, more light on dark parts, or neighbours 5° to 15°
apart measure more.
""",
    (
        "… of the thing's depth was measured by no view, and is that of the hull of "
        "its silhouettes (depth.on_hull=false leaves it out; more views measure more)"
    ),
)
DEPTH_NETWORK_SIDECAR_INVALID = Code(
    "depth.network-sidecar-invalid",
    "The page beside a network does not fit it",
    """
[A network of your own](../your-own-network.md) says what the page may hold.
""",
    "there is no … beside it, which says what it takes and gives; scanloom probe … --write guesses one.",
)
DEPTH_VIEW_WITHOUT_PARTNER = Code(
    "depth.view-without-partner",
    "Views that have no partner, or too few",
    """
Single views measure depth against others that see the same from 1° to 35° aside. Views of a camera that
only turns on
the spot have none; take more, closer together, from different places.
""",
    "one view alone has no depth",
)
DEPTH_IMAGES_CHANGED = Code(
    "depth.images-changed",
    "What was done to the images",
    """
Warnings, for information. `depth.max_side` is the longest side that is matched; `depth.turn_back=false`
leaves images
as they are.
""",
    "… images are upside down against their poses, the first …; they were turned back",
)
