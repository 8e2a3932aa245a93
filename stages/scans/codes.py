"""Codes of the diagnostics of reading scans, with explanations."""

from __future__ import annotations

from stages.diagnostics.diagnostic import Code

CAMERA_CALIBRATION_CONTRADICTORY = Code(
    "camera.calibration-contradictory",
    "A calibration that contradicts itself",
    """
Warnings, which begin with the file's name. One thing stands in it twice, and differently: often one part
was replaced by a
newer calibration, or scaled, and the other left. Find out which is right (a known distance in the result
tells the
baseline), and take the other out of the file.
""",
    "states more than one baseline, … (…) and …: the first is taken; scan.baseline=METRES states another",
)
CAMERA_CALIBRATION_MISMATCH = Code(
    "camera.calibration-mismatch",
    "A calibration that is for something else",
    """
Intrinsics count in pixels of one image size. A calibration that states another size of the same shape is
scaled, with a
warning; one that states none is taken for the images' own, and a warning says where its centre cannot be
theirs. Cropped
images need `cx` and `cy` less what was cut off, and turned ones a calibration of their own.
""",
    (
        "it is for images of …×…, but these are …×…, which is another shape: they "
        "are cropped or turned. Give the calibration of these images."
    ),
)
CAMERA_CALIBRATION_INVALID = Code(
    "camera.calibration-invalid",
    "A calibration whose numbers cannot be right",
    """
Compare the file with [the forms](../formats/calibrations.md). The usual slips: the two cameras are
swapped; T is that
of the other direction; the baseline is in millimetres without `unit: mm`; the file holds the matrices of
rectified
images, and the images are not.
""",
    "the lens model … is not supported; radial-tangential and equidistant are. Undistort the images first.",
)
CAMERA_ADJUSTED_MISMATCH = Code(
    "camera.adjusted-mismatch",
    "A cameras.json that is of another scan",
    """
`--adjusted` takes what `scanloom adjust`, or the stage of a run, wrote for this scan: frames are found by
name.
""",
    "a cameras.json of `scanloom adjust` is expected.",
)
CAMERA_PAIR_UNCALIBRATED = Code(
    "camera.pair-uncalibrated",
    "A pair without a calibration",
    """
Focal length times baseline is the scale of everything a pair shows, so nothing is guessed. Name a calibration
([forms](../formats/calibrations.md)), or for rectified images `--intrinsics` and `--baseline`.
""",
    (
        "calibration: … is missing…; name one with scan.calibration=FILE, or set "
        "scan.intrinsics=fx,fy,cx,cy and scan.baseline=METRES for a rectified pair"
    ),
)
POSE_INVALID = Code(
    "pose.invalid",
    "A pose that is none",
    """
Left-handed axes, a scale within the matrix, a matrix that is stored column by column, or quaternions in
the order w x y
z where x y z w is read. Camera-to-world is meant, x right, y down, z forward.
""",
    "…the last row of the pose is …, not 0 0 0 1; is it stored column-major?",
)
POSE_TRAJECTORY_UNREADABLE = Code(
    "pose.trajectory-unreadable",
    "A trajectory file that cannot be read",
    """
Twelve or sixteen numbers a line are matrices, eight are TUM's `t tx ty tz qx qy qz qw`, five lines each
are Open3D's
`.log`. Where a file has no times, it has to have a pose for every frame, in their order.
""",
    (
        "line … holds … numbers. Expected are 12 or 16 (a matrix), 8 (t tx ty tz qx "
        "qy qz qw), 7 (the same without t) or 3 (a .log header)."
    ),
)
POSE_INCONSISTENT_WITH_IMAGES = Code(
    "pose.inconsistent-with-images",
    "Colour, depth and poses do not agree",
    """
`scanloom run` adjusts poses and the colour camera where that helps ([adjust](../stages/adjust.md)). A
shift by more than ten
pixels (of photos 640 wide) is not found by outlines: give the colour camera's pose (`color_from_depth` in
[scan.json](../formats/scans.md)), or record depth that is aligned to colour.
""",
    (
        "colour, depth and poses are off by … px (median of … points that two frames "
        "show): `scanloom run` adjusts them, `scanloom adjust` does it alone"
    ),
)
SCALE_NOT_METRIC = Code(
    "scale.not-metric",
    "Lengths that are not metres",
    """
Models from images alone have no scale: COLMAP, nerfstudio, Blender's own scenes. All lengths are then in
an unknown
unit, and parameters in metres mean that unit. `scan.depth_scale=2.5` says that 2.5 units are one metre:
measure a known
distance on the first result, divide, and run again. A median depth of a few millimetres or of hundreds of
metres is a
wrong unit of the depth maps: 1000 is millimetres, 5000 TUM's, 1 metres. Tags must be printed in one size,
lie flat, and be seen sharp in two or more photos from different places; `--tag-size` is the edge of
the black square in metres. See [scale and up](../scale-and-up.md).
""",
    "the median depth is … m with … units a metre…",
)
CAMERA_LENS_UNKNOWN = Code(
    "camera.lens-unknown",
    "Lenses that are not known",
    """
Known are OpenCV's pinhole camera with up to 14 coefficients, the equidistant fisheye with four, and what
can be brought
to these. Undistort the images with the tool that calibrated them, and give the camera it writes.
""",
    (
        "the FOV lens (omega …) is … px off from what can be read; undistort the "
        "images with COLMAP's image_undistorter and give the folder it writes."
    ),
)
CAMERA_INTRINSICS_GUESSED = Code(
    "camera.intrinsics-guessed",
    "No intrinsics: a camera is guessed",
    """
A warning where a camera can be guessed, else an error. The mesh is bent and of the wrong size as far as
the guess is
off. State the camera as `--intrinsics fx,fy,cx,cy` (`scan.intrinsics`) in pixels of the depth map, or
name a file with
`--calibration` ([forms](../formats/calibrations.md)).

Where poses are missing, [register](../stages/register.md#a-camera-that-nobody-stated) estimates the focal
length with
them, and `scanloom inspect` tells the same. It needs ten couples of frames that show the same from
different sides. The
± is by how couples of frames differ; what is wrong in all alike (a lens, colour and depth that do not lie
on each other)
is not in it.
""",
    (
        "the folder has no intrinsics: …,…,…,… is guessed, …; for another camera set "
        "scan.intrinsics=fx,fy,cx,cy, or name its file with scan.calibration=FILE"
    ),
)
POSE_MISSING = Code(
    "pose.missing",
    "No poses",
    """
Frames with depth get their poses in a run: the stage `register` finds them. Pairs and single views need
them: name a
trajectory with `--poses FILE` (`scan.poses`; [forms](../formats/scans.md#trajectories)). Where every
frame has the same
pose, a tracker has written nothing.
""",
    "poses: lowres_wide.traj is missing; name a trajectory with scan.poses=FILE",
)
POSE_JUMPS = Code(
    "pose.jumps",
    "Poses that jump, or do not fit the images",
    """
Poses of views without depth that are off by more than a pixel, as telephones' are, are brought nearer by
themselves, held to where
they were given; what is left then is told. Tracking was lost, or poses belong to other frames. `scanloom
inspect --picture` draws the path. Leave the first or last
frames out with `scan.first` and `scan.last`, find poses anew with `register.enabled=true`, or give better
ones with
`--poses`.
""",
    (
        "the poses are brought nearer to what views recognise in each other: "
        "held-out points lie … px off, … px before (median)"
    ),
)
SCALE_UP_UNCERTAIN = Code(
    "scale.up-uncertain",
    "What is up is not known, or doubtful",
    """
Results stand on their side, or upside down, if what is up is wrong: `--set upright.up=+y` (an axis, or
three numbers) states it; see
[scale and up](../scale-and-up.md). Accelerometers are only used where the recording tells how they stand
to the camera, and
while they read about 9.81 m/s². A camera that was held sideways or upside down for most of a scan brings
the last warning.
""",
    "…; --up AXIS states it",
)
DEPTH_RANGE_UNKNOWN = Code(
    "depth.range-unknown",
    "Nothing tells where the scene is",
    """
The views recognise nothing in each other where the poses put it. Check the poses; or state the range of
depth.
""",
    (
        "no points are recognised from view to view where the poses say, and the "
        "views look past each other, so that nothing tells where the scene is; check "
        "the poses, or give the range of depth with depth.min_depth and "
        "depth.max_depth (metres)."
    ),
)
FILE_COLMAP_INVALID = Code(
    "file.colmap-invalid",
    "COLMAP's models",
    """
Both `cameras` and `images` have to be there, both as text or both binary, as COLMAP wrote them. A depth
map has to be
of the image's size: give the dense workspace's own model (`sparse/` beside `stereo/`).
""",
    "camera … claims to have …×… pixels.",
)
RECORDING_SEVERAL = Code(
    "recording.several",
    "A folder with several recordings, or parts of one",
    """
A recording in several files is a folder with its metadata.yaml; give the folder. Several recordings
beside each other
are several scans: give the one file.
""",
    "there is no recording (…)",
)
RECORDING_CLOCKS_DIFFER = Code(
    "recording.clocks-differ",
    "Clocks that do not agree",
    """
Streams are paired by the times in their messages. If these are of different clocks, they are paired by
when they were
recorded, which is less exact while the camera moves. A trajectory of another clock, or of frames that are
only counted,
goes with them in order: `--poses-by-order`, where it has one pose a frame.
""",
    "no … and … in it are of one moment….",
)
RECORDING_ENCODING_UNKNOWN = Code(
    "recording.encoding-unknown",
    "Encodings that are not known",
    """
Record with the driver's usual encodings: `rgb8` or `bgr8` for colour, `16UC1` for depth, or their
compressed transports
(JPEG or PNG; depth as `compressedDepth png`).
""",
    "colour is encoded as …, which is not known; record it as rgb8.",
)
RECORDING_WRONG_KIND = Code(
    "recording.wrong-kind",
    "Not the kind of file that its name says",
    """
The extension and the content differ: a renamed file, a database of another program, or a version that
this reader does
not know.
""",
    "a ROS bag of another version",
)
RECORDING_TOPIC_MISSING = Code(
    "recording.topic-missing",
    "The wrong topics",
    """
Needed are images of depth (16UC1 or 32FC1) with a `camera_info`, and colour; or a left and a right image
with theirs.
Of several, one is used, and a warning names it; no option chooses another: record, or filter, only what
is wanted.
""",
    (
        "there are no depth images in it (sensor_msgs/Image of 16UC1 or 32FC1, "
        "`depth` in the topic's name), and no left/ and right/, only …. Record the "
        "depth topic too."
    ),
)
SCAN_SELECTION_EMPTY = Code(
    "scan.selection-empty",
    "A selection that leaves nothing",
    """
Frames are counted from 0, and `scan.last` is the last one that is used. `scan.hold_out=10` needs ten
frames at least.
""",
    "first=…, last=… leaves no frame of the scan's ….",
)
SCAN_FILES_MISSING = Code(
    "scan.files-missing",
    "Files that a layout needs are missing",
    """
The folder looks like the named data set's, but a part of it is not there: often a folder that was not
unpacked or not
exported. Look for the name in the message; a layout's files are those that its own tools write.
""",
    "no images named like 41069021_305.377.png in lowres_depth/.",
)
SCAN_FRAMES_SKIPPED = Code(
    "scan.frames-skipped",
    "Frames that are left out",
    """
Each is named in `frames_skipped` of report.json with its reason. A frame needs a depth map, a pose and,
where others
have one, a colour image; times have to agree within a few hundredths of a second. A few are no matter; if
all go, the
times of images and poses are from different clocks, or counted instead of measured: give a trajectory
with one pose a
frame (KITTI's form has no times).
""",
    "its … is missing",
)
SCAN_IMAGES_UNPAIRED = Code(
    "scan.images-unpaired",
    "Images that do not pair up",
    """
Depth and colour, or left and right, are put together by the numbers in their names, or by their times.
Names that share
no numbers are paired in their order, with a warning: name both images of a moment alike if that is wrong.
Frames
without a partner are left out.
""",
    (
        "the names in … and … share no numbers: they are paired in their order; name "
        "the two images of a moment alike if that is wrong"
    ),
)
SCAN_TABLE_DAMAGED = Code(
    "scan.table-damaged",
    "Lists and tables of a data set that are damaged",
    """
The named line or value is not as the format has it. Get that file again from where it comes; if it was
edited, compare
it with the data set's description. [Formats](../formats/scans.md) has the forms of our own.
""",
    "it lists no images.",
)
SCAN_DEPTH_MISSING = Code(
    "scan.depth-missing",
    "No depth where depth is needed",
    """
Frames with poses but without depth are *single views*; only some layouts (COLMAP, nerfstudio, Polycam,
Middlebury's
multi-view) are read so. Export the depth too: on phones it needs a LiDAR sensor, and is a switch of the app.
""",
    "its views have no depth, and views of this layout alone cannot be read yet. …",
)
SCAN_PHONE_IMAGES = Code(
    "scan.phone-images",
    "Phones: confidence and cropped images",
    """
A phone says for each pixel how far it trusts its depth. By default only the lowest level is left out;
`scan.least_confidence` keeps more or less of it. Images that are cropped or turned no longer fit the
camera that was
written beside them: export them as they were taken.
""",
    (
        "depth of confidence … and more (of …) is kept: scan.least_confidence=… "
        "keeps the best only, scan.least_confidence=… all; a phone's depth past 5 m "
        "is a guess, which fuse.max_depth=5 leaves out"
    ),
)
SCAN_LAYOUT_UNKNOWN = Code(
    "scan.layout-unknown",
    "The folder is not recognised",
    """
Give the folder that holds the images' folders, not one above or below it; for `.bag`, `.db3`, `.mcap`,
`.sens` and
`.r3d` the file itself. Where two layouts would fit, `scan.layout=NAME` (`--layout NAME`) names one; it
also makes a
reader say what exactly it misses. What no layout fits is quickly brought into
[plain-rgbd](../formats/scans.md#plain-rgbd): folders `color/` and `depth/`, and a `scan.json`.
""",
    "this is a file, not a scan folder.",
)
SCAN_TIMES_IRREGULAR = Code(
    "scan.times-irregular",
    "Times that are odd",
    """
Warnings. Frames stay in the order of their files. Repeated times and times that go back come from
recorders that write
how long a frame took instead of when it was; gaps are frames that were dropped: there the camera has
moved far, and
`register` may lose its way.
""",
    "… timestamps are repeated",
)
SCAN_TOO_MANY_FRAMES_SKIPPED = Code(
    "scan.too-many-frames-skipped",
    "Too many frames cannot be used",
    """
A stage goes on without single frames, up to a share (`fuse.max_bad_share`, `depth.max_skipped`). Beyond
that, something
is wrong with all of them: the reason of the first or the last one is in the sentence, and is explained on
these pages.
""",
    "none of its … frames can be used….…",
)
SCAN_ASSUMED = Code(
    "scan.assumed",
    "What is assumed of a data set",
    """
Warnings: the reader had to choose, and says what it took. Nothing has to be done if it is right. Only an
axisAlignment
that was asked for and cannot be read ends the work.
""",
    "of … models, …/ is read: it has the most images (…). They have no common world",
)
SCAN_OPTION_UNUSED = Code(
    "scan.option-unused",
    "What is stated has no use",
    """
Nothing that is stated is ignored in silence. Where the layout's own files state what you want to state
otherwise, change
it there, or bring the images into one of the two plain layouts ([formats](../formats/scans.md)).
""",
    "scan.…=… has no use: the layout … takes none. Leave it out.",
)
USAGE_FRAME_INVALID = Code(
    "usage.frame-invalid",
    "Frames from arrays",
    """
Raised by `Frame.from_arrays` and `Scan.from_frames`; see [frames from arrays](../recipes/arrays.md). The
message names the frame. A colour
image is uint8: `np.rint(255 * image).astype(np.uint8)` converts values from 0 to 1. Depth that is stored
in millimetres needs
`depth_scale=1000`. A pose takes points of the camera to the world; the inverse of Open3D's `extrinsic`.
""",
    "a colour image must be (h, w, 3) RGB or (h, w) grey uint8, not … ….",
)
