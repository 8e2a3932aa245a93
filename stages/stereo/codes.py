"""Diagnostic codes of depth from pairs and views, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

DEPTH_NETWORK_NO_EFFECT = Code(
    "depth.network-no-effect",
    "Monocular network without effect",
    """
The output of the network must fit the measured depth of the same image up to a scale and a shift. If it
does not fit, the depth map of the image is left unchanged.
""",
    ("midas.onnx: the network fills no depth in some images: its median error exceeds depth.model_error"),
)
DEPTH_NETWORK_UNUSABLE = Code(
    "depth.network-unusable",
    "Network cannot be run",
    """
The file of `depth.model` is not an ONNX file, is damaged, stores its weights in other files, or exceeds its
memory or time limit. The message quotes onnxruntime: most often it does not support an operation. Export
the network again with another opset, or install a newer onnxruntime.
""",
    "raft.onnx: onnxruntime is required to run networks; install scanloom[network].",
)
DEPTH_NETWORK_UNIDENTIFIED = Code(
    "depth.network-unidentified",
    "Network with unknown conventions",
    """
`scanloom lab probe` recognises common inputs and outputs only. Write the sidecar by hand: the example
script of the network's authors shows how images are prepared.
""",
    ("raft.onnx: its inputs (1 × 6 × 384 × 512) are neither an image nor a pair; write its sidecar by hand."),
)
DEPTH_NETWORK_SIDECAR_INVALID = Code(
    "depth.network-sidecar-invalid",
    "Sidecar does not match its network",
    """
The sidecar is a TOML file with the input and output conventions of a network; [a network of your
own](../your-own-network.md) lists its entries. A warning if almost no pixel passes the left–right check:
then unit, sign or range in the sidecar are probably wrong.
""",
    (
        "raft.onnx: its sidecar raft.toml with input and output conventions is missing; "
        "scanloom lab probe raft.onnx --write guesses one."
    ),
)
DEPTH_RANGE_EMPTY = Code(
    "depth.range-empty",
    "Empty depth range",
    """
`depth.min_depth` and `depth.max_depth` are metres along the optical axis. The minimum depth decides the
number of disparities, and thereby time and memory. Closer surfaces get no depth.
""",
    "depth.max_depth is 0.2 m, but the rig measures depth from 0.35 m only; increase it.",
)
DEPTH_FAR_LEFT_OUT = Code(
    "depth.far-left-out",
    "Depth beyond the range of depth files",
    """
A warning. Depth files have 16-bit values, which end at this distance. Depth beyond it, or beyond
`depth.max_depth` if given, is dropped.
""",
    "depth beyond 65.53 m is dropped (depth.max_depth)",
)
DEPTH_COVERAGE_LOW = Code(
    "depth.coverage-low",
    "Depth covers little of the views",
    """
A warning. It lists the reasons for missing depth, the most frequent one first.

- *Too little texture*: plain pixels are treated as background, such as a wall or the sky. With a backdrop
  of one colour in all views, or with masks, plain parts of the object are measured, too.
  `depth.max_backdrop_contrast=0`
  measures all plain pixels, such as the walls of rooms.
- *No reliable match in another view*: more texture or light helps, or a smaller distance between views.
  Angles of 5° to 15° between neighbours are best.
- *Low confidence, or not confirmed* by enough other views: such depth is wrong, plain, or observed from too
  few sides. Take more views, or lower `depth.min_confidence` and `depth.min_consistent_views`.
""",
    (
        "depth covers only 9% of the views' pixels: 71% have too little texture "
        "(depth.max_backdrop_contrast=0 keeps "
        "them), 18% have no reliable match in another view (depth.min_confidence=1 and "
        "depth.sgbm.uniqueness=0 keep more)"
    ),
)
DEPTH_ALREADY_MEASURED = Code(
    "depth.already-measured",
    "Scan already has depth",
    """
The scan has depth maps instead of stereo pairs. Run `fuse` directly.
""",
    "scans/desk: the scan has no stereo pairs, so there is nothing to match.",
)
DEPTH_PAIR_SWAPPED = Code(
    "depth.pair-swapped",
    "Left and right images are swapped",
    """
Points are farther right in the right image than in the left one, which is impossible for parallel cameras.
Swap the folders or files of both images.
""",
    (
        "scans/street: left and right images seem swapped: 98% of the corners found in both "
        "are farther right in the right image. Swap the images."
    ),
)
DEPTH_PAIR_ROWS_DIFFER = Code(
    "depth.pair-rows-differ",
    "Misaligned rows of a stereo pair",
    """
A warning. Pairs are matched along rows. If the cameras moved after the calibration, matching points are on
different rows, and depth gets holes. Calibrate again. Check that size and state of the images (raw or
rectified) match the calibration.
""",
    (
        "rows of the pair differ by 3.0 px (median of 412 corners), more than 0.5 px: the calibration is "
        "inaccurate, and depth will have holes"
    ),
)
DEPTH_SCENE_INCOMPLETE = Code(
    "depth.scene-incomplete",
    "Much of the scene is filled from planes",
    """
A warning. Floors, walls and table tops without texture have no measured depth. They are filled from a plane
through the depth in and around them if other views agree. Surfaces that are almost flat become flat. Filled
pixels have a confidence of 1, so that `scan.min_confidence=2` drops them.
""",
    (
        "31% of the depth is not measured, but filled from planes through the depth around it "
        "(depth.fill_from_planes=false drops it)"
    ),
)
DEPTH_OBJECT_INCOMPLETE = Code(
    "depth.object-incomplete",
    "Much of the object is filled from silhouettes",
    """
A warning. If views surround an object with masks or a backdrop, unmeasured surface is filled from the
visual hull of its silhouettes. It is right for convex parts, and too far out in concavities. Filled pixels
have a confidence of 1, so that `scan.min_confidence=2` drops them. More views, more light on dark parts,
or neighbours 5° to 15° apart increase the measured part.
""",
    (
        "24% of the object's depth is not measured, but filled from the visual hull of its silhouettes "
        "(depth.fill_from_visual_hull=false drops it; more views measure more)"
    ),
)
DEPTH_VIEW_WITHOUT_PARTNER = Code(
    "depth.view-without-partner",
    "Views without partner",
    """
Depth of a single view requires other views of the same surface, at an angle of 1° to 35°. Views of a camera
that rotates in place have no such partner. Take more views, closer together, from different positions.
""",
    (
        "no other view sees the same surface at an angle of 1 to 35 degrees; the other views are too close, "
        "too far apart, or look elsewhere"
    ),
)
DEPTH_VIEW_UNCONFIRMED = Code(
    "depth.view-unconfirmed",
    "Views without confirmed depth",
    """
No depth of the view agrees with enough other views (`depth.min_consistent_views`), and the view is skipped.
Its
pose may be wrong, its image blurred or without texture, or too few other views see the same surface.
""",
    "its depth does not agree with other views",
)
DEPTH_IMAGES_SMALLER = Code(
    "depth.images-smaller",
    "Images were downscaled",
    """
A warning. Large images take long to match, and a mesh does not need their resolution. `depth.max_side`
limits the longer side of matched images.
""",
    "24 images were downscaled to 1600 px (depth.max_side)",
)
DEPTH_IMAGES_TURNED = Code(
    "depth.images-turned",
    "Upside-down images were rotated",
    """
For information. Some data sets store images upside down relative to their poses. Feature matches reveal
these images, and they are rotated by 180°. `depth.fix_upside_down=false` keeps all images unchanged.
""",
    (
        "3 images are upside down relative to their poses and were rotated by 180 degrees; the first is "
        "templeR0042"
    ),
)
DEPTH_POSES_MOVED = Code(
    "depth.poses-moved",
    "Poses were refined",
    """
A warning. Poses with an error above one pixel, for example from phones, are refined from feature matches
between views (epipolar adjustment), with the given poses as prior. A remaining error is reported as well.
""",
    (
        "the poses were refined from feature matches: the median epipolar error of held-out matches is now "
        "0.6 px, 2.3 px before"
    ),
)
