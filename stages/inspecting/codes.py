"""Diagnostic codes of inspection and coverage."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

POSE_INEXACT = Code(
    "pose.inexact",
    "Inexact poses",
    """
A warning. Whole patches of depth are offset between frames, which noise does not cause: the clock of the
tracker is delayed, or the tracker drifts. Walls become double, edges round. If the images have enough
texture, the stage [adjust](../stages/adjust.md) corrects the poses automatically, without this warning.
Otherwise, refine the poses by aligning the surfaces, as the message says.
""",
    (
        "the poses are inexact: surfaces of overlapping frames are offset by 0.8% of their distance "
        "(median); register.enabled=true with register.refine=true refines the poses"
    ),
)
POSE_CONVENTION_SUSPECT = Code(
    "pose.convention-suspect",
    "Poses in another convention",
    """
Depth was reprojected between frames with the poses as given, inverted, with flipped axes, and in reverse
order. For photos without depth, the epipolar distances of feature matches were compared. Another convention
fits clearly better. A run stops, because the mesh would be scattered.

`scan.pose_convention` sets the convention of the poses: `world-to-camera`, `y-up`
(camera axes with y up and z back, as in OpenGL), or `world-to-camera-y-up`. The message names the value.
Poses in reverse order must be brought into frame order. If the message names two conventions, both fit
equally well (uniform camera motion). If the check is wrong (a single flat wall fits every convention),
disable it with `scan.check_poses=false`.
""",
    (
        "scans/desk: the poses are probably world-to-camera: overlapping depth maps then agree to 4 mm; as "
        "given: 340 mm (compared: 340 mm as given; 4 mm world-to-camera). Set "
        "scan.pose_convention=world-to-camera, or provide camera-to-world poses with x right, y down, z "
        "forward, in frame order. To use the poses as given, use "
        "--set scan.check_poses=false."
    ),
)
CAMERA_DEPTH_BENT = Code(
    "camera.depth-bent",
    "Bent depth",
    """
A warning. Flat surfaces are bent in the depth maps, differently in each part of the image or at each range.
This is common for structured light and time of flight. Pairs of frames were aligned rigidly, so that inexact
poses do not count. A smooth correction of depth explains at least a fifth of the remaining squared distances
between the surfaces of other pairs. The stage [adjust](../stages/adjust.md) fits such a correction if colour
and depth do not agree already, and keeps it if held-out points agree clearly better; `adjust.depth` switches
it. `scan.depth_calibration=FILE` applies a correction from another scan of the same camera.
""",
    (
        "depth of overlapping frames differs by 0.6% of the distance, depending on the position in the image "
        "and the range; `scanloom run` and `scanloom adjust` estimate a correction, if the images allow it"
    ),
)
SCALE_DEPTH_UNIT_SUSPECT = Code(
    "scale.depth-unit-suspect",
    "Suspicious depth unit",
    """
A warning. The median depth is implausible in the declared unit, or depth and poses agree better in another
unit. `scan.depth_scale` is the number of depth units per metre: 1000 for millimetres, 5000 for TUM RGB-D,
1 for metres.
""",
    (
        "the median depth is implausible: 0.00152 m with 1000 depth units per metre; scan.depth_scale=1 "
        "(metres) would make it plausible"
    ),
)
SCAN_DEPTH_MARKER_UNDECLARED = Code(
    "scan.depth-marker-undeclared",
    "Undeclared marker for missing depth",
    """
A warning. Many pixels have the maximum value of the depth maps. Unless `depth_missing` in
[scan.json](../formats/scans.md) declares it as missing, these pixels become a distant wall.
""",
    "14% of the depth pixels have the maximum value 65535, which probably marks missing depth",
)
SCAN_IMAGES_UNREADABLE = Code(
    "scan.images-unreadable",
    "Unreadable images",
    """
A warning. A run skips the frames of these images. Copy the images again from their source.
""",
    "2 depth images cannot be read, the first is 000012.png",
)
SCAN_IMAGES_SIZES_DIFFER = Code(
    "scan.images-sizes-differ",
    "Images of different sizes",
    """
A warning. All images of a camera must have one size. Images of another size were scaled or cropped, or
belong to another recording.
""",
    "3 color images have another size (320×240), the first is 000007.png",
)
SCAN_FRAMES_BLURRED = Code(
    "scan.frames-blurred",
    "Blurred frames",
    """
A warning. Blurred frames give little depth and soft colours. Move the camera more slowly, or use more light
([capturing](../capturing.md)). `scan.first`, `scan.last` and `scan.every` exclude frames.
""",
    "2 of 40 sampled frames are blurred or show hardly any detail: 000007, 000020",
)
CAMERA_COLOR_UNREGISTERED = Code(
    "camera.color-unregistered",
    "Colour not registered to depth",
    """
A warning. Silhouettes in the photos are shifted relative to the depth maps, so that objects get colours of
the background. The extrinsics of the colour camera are wrong. If frames have poses, the stage
[adjust](../stages/adjust.md) estimates them.
""",
    (
        "colour is not registered to depth: judged by silhouettes, the photos are shifted 5.0 px to the "
        "right and 0.3 px up; if frames have poses, `scanloom run` corrects the colour camera, `scanloom "
        "adjust` does only that"
    ),
)
COVERAGE_MESH_UNMEASURED = Code(
    "coverage.mesh-unmeasured",
    "Frames did not measure the mesh",
    """
`coverage` requires the frames that the mesh was made from, with depth, and with poses in the world
coordinates of the mesh.
""",
    (
        "scans/desk: none of the 24 frames measured the mesh; check that poses and mesh are in the same "
        "coordinate system."
    ),
)
COVERAGE_LIMITED = Code(
    "coverage.limited",
    "Coverage of a run is unavailable or incomplete",
    """
`scanloom coverage OUT` continues the run that wrote OUT. The record in the cache of that run names the scan
and the parameters with which it was read. Pass `--scan` if the scan was moved, and `--cache` if the cache is
elsewhere. A run without a clean mesh must be finished first.

A warning: for a mesh of more than 5 million triangles, `coverage.ply` is written (MeshLab and CloudCompare
can open it), but no `coverage.glb`, and the page lists the defects only in its table.
""",
    (
        "out/desk: the scan that these results were made from is not there any more; say with --scan "
        "where it is."
    ),
)
