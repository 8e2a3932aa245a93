"""Codes of the diagnostics of inspection and coverage, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

POSE_INEXACT = Code(
    "pose.inexact",
    "Poses that are inexact",
    """
A warning. Whole patches of depth lie off, which noise does not cause: the clock of a tracker was behind,
or the tracker drifts. Walls come out double, edges round. Where the stage [adjust](../stages/adjust.md)
recognises enough in the images it corrects the poses by itself, without this warning; scenes without
texture are corrected by their surfaces.
""",
    (
        "by the poses, surfaces of one frame lie 0.8% of their distance off another's (median): they are "
        "inexact; register.enabled=true with register.refine=true brings them nearer by the surfaces"
    ),
)
POSE_CONVENTION_SUSPECT = Code(
    "pose.convention-suspect",
    "Poses of another convention",
    """
Depth of one frame was carried into another by the poses as given, inverted, with flipped axes, and in
reverse order; of single views, points that two photos show were looked for on each other's epipolar
lines. Another convention fits clearly better. A run stops at that, since the mesh would be scattered.

`scan.pose_convention` names the convention of the poses: `world-to-camera`, `y-up`
(a camera with y up and z back, as OpenGL has it), or `world-to-camera-y-up`; the message says which.
Poses in another order have to be brought into that of the frames. Where two conventions are named, they
fit alike (a camera that moves evenly). If the check is wrong (a scene of one flat wall fits every
convention), `scan.check_poses=false` goes on.
""",
    (
        "scans/desk: the poses are probably world-to-camera: so taken, the depth of one frame meets "
        "another's to 4 mm, as given to 340 mm (compared: 340 mm as given; 4 mm world-to-camera). Give "
        "--set scan.pose_convention=world-to-camera, or give them camera-to-world with x right, y down, "
        "z forward, in the frames' order, or use them as they are with --set scan.check_poses=false."
    ),
)
SCALE_DEPTH_UNIT_SUSPECT = Code(
    "scale.depth-unit-suspect",
    "Depth in another unit",
    """
A warning. The median depth cannot be right for the unit that is declared, or depth and poses fit together
in another unit. `scan.depth_scale` states how many units are one metre: 1000 is millimetres, 5000 TUM's,
1 metres.
""",
    (
        "the median depth is 0.00152 m with 1000 units a metre; scan.depth_scale=1 (metres) would make it "
        "plausible"
    ),
)
SCAN_DEPTH_MARKER_UNDECLARED = Code(
    "scan.depth-marker-undeclared",
    "A depth value that probably marks missing depth",
    """
A warning. Many pixels hold the largest value of the depth maps. Give it in `depth_missing` of
[scan.json](../formats/scans.md), or these pixels become a wall far away.
""",
    "14% of the depth pixels hold the largest value, 65535; probably it marks a missing one",
)
SCAN_IMAGES_UNREADABLE = Code(
    "scan.images-unreadable",
    "Images that cannot be read",
    """
A warning. Their frames are left out by a run. Copy them again from their source.
""",
    "2 depth images cannot be read, the first is 000012.png",
)
SCAN_IMAGES_SIZES_DIFFER = Code(
    "scan.images-sizes-differ",
    "Images of several sizes",
    """
A warning. A camera has one image size; images of another one were scaled, cropped, or belong to another
recording.
""",
    "3 color images have another size (320×240), the first is 000007.png",
)
SCAN_FRAMES_BLURRED = Code(
    "scan.frames-blurred",
    "Frames that are blurred",
    """
A warning. Blurred frames give little depth and soft colours: move more slowly, or give more light
([capturing](../capturing.md)). `scan.first`, `scan.last` and `scan.every` leave frames out.
""",
    "blurred, or with next to nothing to see: 000007, 000020 (2 of the 40 frames looked at)",
)
CAMERA_COLOR_UNREGISTERED = Code(
    "camera.color-unregistered",
    "Colour that is not registered to depth",
    """
A warning. Silhouettes in the photos lie beside those in the depth maps, so that colours of the background
end up on objects. The colour camera stands or looks elsewhere than the scan states. The stage
[adjust](../stages/adjust.md) finds its position where frames have poses.
""",
    (
        "colour is not registered to depth: by the outlines of things photos lie 5.0 px to the right and 0.3 "
        "px up; where frames have poses, `scanloom run` moves the colour camera there, `scanloom adjust` "
        "does it alone"
    ),
)
COVERAGE_MESH_UNMEASURED = Code(
    "coverage.mesh-unmeasured",
    "Frames that did not measure the mesh",
    """
`coverage` needs the frames that the mesh was made of, with poses and depth, in the world of the mesh.
Depth of other frames, or poses of another world, say nothing about it.
""",
    "scans/desk: none of the 24 frames measured the mesh: do poses and mesh belong together?",
)
COVERAGE_LIMITED = Code(
    "coverage.limited",
    "Gaps of a run that cannot be found again, or not shown in full",
    """
`scanloom coverage OUT` continues the run that wrote OUT: the record in that run's cache says which scan
it was, and how it was read. Name a scan that was moved with `--scan`, a cache that is elsewhere with
`--cache`, and finish a run that has no clean mesh yet.

A warning: of a mesh of more than 5 million triangles there is `coverage.ply`, which MeshLab and
CloudCompare read, and no `coverage.glb`, and the page lists the gaps in its table only.
""",
    (
        "out/desk: the scan that these results were made from is not there any more; say with --scan "
        "where it is."
    ),
)
