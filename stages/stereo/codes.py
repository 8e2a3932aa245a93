"""Codes of the diagnostics of depth from pairs and views, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

DEPTH_NETWORK_NO_EFFECT = Code(
    "depth.network-no-effect",
    "A network of single images that fills in nothing",
    """
The network's depth must fit the depth that was measured in the same image, up to a scale and a shift.
Where it does not fit, measured depth stays as it is, and nothing is added.
""",
    (
        "midas.onnx: the network fills in nothing in some images: it differs by more than "
        "depth.model_error allows"
    ),
)
DEPTH_NETWORK_UNUSABLE = Code(
    "depth.network-unusable",
    "A network of your own that cannot be run",
    """
The file of `depth.model` is no ONNX file, is damaged, keeps its weights in other files, or needs more
memory or time than it may take. The words of onnxruntime follow: most often it does not know an
operation. Export the network again with another opset, or install a newer onnxruntime.
""",
    "raft.onnx: networks are run by onnxruntime; install scanloom[network].",
)
DEPTH_NETWORK_UNIDENTIFIED = Code(
    "depth.network-unidentified",
    "A network that cannot be guessed",
    """
`scanloom lab probe` knows the usual inputs and outputs only. The example script of the network's makers shows
how they prepare their images.
""",
    ("raft.onnx: its inputs (1 × 6 × 384 × 512) are no image and no pair; write its sidecar by hand."),
)
DEPTH_NETWORK_SIDECAR_INVALID = Code(
    "depth.network-sidecar-invalid",
    "The page beside a network does not fit it",
    """
The page (sidecar) states the inputs and outputs of a network; [a network of your
own](../your-own-network.md) lists its entries. A warning where left and right agree on hardly any pixel:
then unit, sign or range on the page are wrong, rather than the network.
""",
    (
        "raft.onnx: there is no raft.json beside it, which says what it takes and gives; "
        "scanloom lab probe raft.onnx --write guesses one."
    ),
)
DEPTH_RANGE_EMPTY = Code(
    "depth.range-empty",
    "A range of depth in which nothing can be matched",
    """
`depth.min_depth` and `depth.max_depth` are metres along the optical axis. The nearest depth decides how
many disparities are tried, and with that time and memory; surfaces nearer than it are lost.
""",
    "depth.max_depth is 0.2 m, nearer than the rig's pairs can be matched (0.35 m); give a larger one.",
)
DEPTH_FAR_LEFT_OUT = Code(
    "depth.far-left-out",
    "Depth beyond the limit of depth maps",
    """
A warning. Depth maps are kept in steps of 16 bits, which end at this distance unless `depth.max_depth`
states another one.
""",
    "depth beyond 65.53 m is left out (depth.max_depth)",
)
DEPTH_COVERAGE_LOW = Code(
    "depth.coverage-low",
    "Depth covers little of the views",
    """
A warning, with the reasons for the rest, the largest share first.

- *Too little texture*: such pixels are taken for a backdrop: a plain wall, a sky. Before a backdrop of
  one colour in all views, or with masks of the object, plain parts of the object itself are measured;
  `depth.backdrop=0` measures plain parts of rooms, too.
- *Matched no other view surely*: more texture or light helps, or views closer together; neighbours 5° to
  15° apart suit best.
- *Is not sure, or is not seen alike* by enough other views: such depth is wrong, plain, or seen from too
  few sides. Take more views, or lower `depth.min_confidence` and `depth.agreeing_views`.
""",
    (
        "depth covers only 9% of the views' pixels: 71% has too little texture (depth.backdrop=0 keeps it), "
        "18% matched no other view surely (depth.min_confidence=1 and depth.sgbm.uniqueness=0 ask less)"
    ),
)
DEPTH_ALREADY_MEASURED = Code(
    "depth.already-measured",
    "Frames that need no matching",
    """
The scan has depth already: `fuse` takes it as it is.
""",
    "scans/desk: the scan has no stereo pairs; its depth maps need no matching.",
)
DEPTH_PAIR_SWAPPED = Code(
    "depth.pair-swapped",
    "Left and right are exchanged",
    """
Points lie farther right in the right image than in the left one, which no pair of parallel cameras shows.
Exchange the folders or files of the two images.
""",
    (
        "scans/street: left and right images seem swapped: 98% of the corners found in both "
        "lie farther right in the right image. Exchange the images."
    ),
)
DEPTH_PAIR_ROWS_DIFFER = Code(
    "depth.pair-rows-differ",
    "Rows of a pair that do not correspond",
    """
A warning. A pair is matched along rows. If the cameras moved since they were calibrated, matching points
lie on different rows, and less and less is found. Calibrate again; check that the images are in the size
and the state (raw or rectified) that the calibration is for.
""",
    (
        "rows of the pair differ by 3.0 px (median of 412 corners), more than 0.5 px: the calibration does "
        "not fit the images well, and depth will have holes"
    ),
)
DEPTH_SCENE_INCOMPLETE = Code(
    "depth.scene-incomplete",
    "Much of a scene was not measured",
    """
A warning. Floors, walls and tops of tables without texture are filled from the depth measured in and
around them, where that lies on one plane and other views agree. Surfaces that are only nearly flat become
flat there. Confidence maps are 1 in such places, so that `scan.least_confidence=2` leaves them out.
""",
    (
        "31% of the depth was measured by no view, and is that of planes on which measured depth around it "
        "lies (depth.on_planes=false leaves it out)"
    ),
)
DEPTH_OBJECT_INCOMPLETE = Code(
    "depth.object-incomplete",
    "Much of an object was not measured",
    """
A warning. Where views stand all around an object with masks or a backdrop, unmeasured surface is placed
on the visual hull of its silhouettes: right for convex parts, too far out for hollows. Confidence maps
are 1 in such places, so that `scan.least_confidence=2` leaves them out. More views, more light on dark
parts, or neighbours 5° to 15° apart measure more.
""",
    (
        "24% of the thing's depth was measured by no view, and is that of the hull of "
        "its silhouettes (depth.on_hull=false leaves it out; more views measure more)"
    ),
)
DEPTH_VIEW_WITHOUT_PARTNER = Code(
    "depth.view-without-partner",
    "Views that have no partner, or too few",
    """
Single views measure depth against others that see the same from 1° to 35° aside. Views of a camera that
only turns on the spot have none; take more, closer together, from different places.
""",
    (
        "no other view sees the same from a little aside (1 to 35 degrees); others stand too near, too far "
        "aside, or look elsewhere"
    ),
)
DEPTH_VIEW_UNCONFIRMED = Code(
    "depth.view-unconfirmed",
    "Views whose depth no other view confirms",
    """
The depth of such a view is dropped, and the view is skipped. Its pose may be wrong, its image blurred or
without texture, or too few others see the same; `depth.agreeing_views` states how many have to.
""",
    "no depth of it agrees with that of other views",
)
DEPTH_IMAGES_SMALLER = Code(
    "depth.images-smaller",
    "Images that were made smaller",
    """
A warning. Images of many megapixels take long to match, and a mesh needs fewer; `depth.max_side` is the
longest side that is matched.
""",
    "24 images were made smaller, to 1600 px (depth.max_side)",
)
DEPTH_IMAGES_TURNED = Code(
    "depth.images-turned",
    "Images that were turned back",
    """
For information. Some data sets store images that are upside down against their poses. Recognised points
show which; `depth.turn_back=false` leaves images as they are.
""",
    "3 images are upside down against their poses, the first templeR0042; they were turned back",
)
DEPTH_POSES_MOVED = Code(
    "depth.poses-moved",
    "Poses of views that were corrected",
    """
A warning. Poses that are off by more than a pixel, as telephones' are, are moved towards the points that
views recognise in each other (epipolar adjustment), and held to where they were given. If some error
remains, that is reported as well.
""",
    (
        "the poses are brought nearer to what views recognise in each other: held-out points lie 0.6 px off, "
        "2.3 px before (median)"
    ),
)
