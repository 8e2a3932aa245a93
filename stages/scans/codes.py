"""Codes of the diagnostics of reading scans, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

CAMERA_CALIBRATION_CONTRADICTORY = Code(
    "camera.calibration-contradictory",
    "A calibration that contradicts itself",
    """
The file states one thing twice, and differently: often one part was replaced by a newer calibration, or
scaled, and the other part was left. Find out which of the two is right (a known distance in the result
checks the baseline), and remove the other from the file.
""",
    (
        "room/calibration.yaml: it states more than one baseline, 120 (T) and 60 (P2): the first is "
        "taken; scan.baseline=METRES states another"
    ),
)
CAMERA_CALIBRATION_SCALED = Code(
    "camera.calibration-scaled",
    "A calibration for images of another size",
    """
Intrinsics count in pixels of one image size. A calibration that states another size of the same shape is
scaled to the images. Nothing has to be done if the images were made smaller after the calibration.
Cropped images need `cx` and `cy` less the columns and rows that were cut off.
""",
    "room/camera.json: it is for images of 1280×960: its camera is scaled to these of 640×480",
)
CAMERA_CALIBRATION_MISMATCH = Code(
    "camera.calibration-mismatch",
    "A calibration that is for something else",
    """
Intrinsics count in pixels of one image size. A calibration that states no size is used for the images as
they are, and a warning says where its principal point cannot be theirs. Cropped images need `cx` and `cy`
less the columns and rows that were cut off, and turned ones a calibration of their own.
""",
    (
        "room/calibration.json: it is for images of 1280×720, but these are 640×480, which is another "
        "shape: they are cropped or turned. Give the calibration of these images."
    ),
)
CAMERA_CALIBRATION_INVALID = Code(
    "camera.calibration-invalid",
    "A calibration whose numbers cannot be right",
    """
Compare the file with [the forms](../formats/calibrations.md). The usual slips: the two cameras are
swapped; T is that of the other direction; the baseline is in millimetres without `unit: mm`; the file
holds the matrices of rectified images, and the images are not rectified.
""",
    (
        "room/calib.yaml: the second camera is not right of the first: T maps left-camera points to "
        "the right camera, so its x must be negative. Are the two cameras swapped?"
    ),
)
CAMERA_CALIBRATION_ASSUMED = Code(
    "camera.calibration-assumed",
    "A calibration that had to be chosen or interpreted",
    """
Several files or values were possible, or the file does not say what its numbers mean. The message says
which one is used. Nothing has to be done if that is right. Otherwise name the file with `scan.calibration`
([forms](../formats/calibrations.md)), state the camera with `--intrinsics`, or the baseline with
`scan.baseline`.
""",
    (
        "room/calib.yaml: the baseline is 120 without a unit, taken as millimetres; where it is not "
        "(in centimetres it were 1.2 m), set scan.baseline=METRES"
    ),
)
CAMERA_ADJUSTED_MISMATCH = Code(
    "camera.adjusted-mismatch",
    "A cameras.json of another scan",
    """
`scan.adjusted` takes the file that `scanloom adjust`, or the stage of a run, wrote for this scan: frames are
found by name.
""",
    "room/cameras.json: a cameras.json of `scanloom adjust` is expected.",
)
CAMERA_PAIR_UNCALIBRATED = Code(
    "camera.pair-uncalibrated",
    "A pair without a calibration",
    """
Focal length times baseline is the scale of everything a pair shows, so nothing is guessed. Name a
calibration ([forms](../formats/calibrations.md)), or for rectified images `--intrinsics` and
`scan.baseline`.
""",
    (
        "street: no calibration: calibration.json is missing; name one with scan.calibration=FILE, or "
        "set scan.intrinsics=fx,fy,cx,cy and scan.baseline=METRES for a rectified pair"
    ),
)
POSE_INVALID = Code(
    "pose.invalid",
    "A pose that is not one",
    """
Left-handed axes, a scale within the matrix, a matrix that is stored column by column, or quaternions in
the order w x y z where x y z w is read. Poses are camera-to-world, x right, y down, z forward.
""",
    (
        "room/pose/000012.txt: the last row of the pose is 0.2 1.1 0.4 1, not 0 0 0 1; is it stored "
        "column-major?"
    ),
)
POSE_TRAJECTORY_UNREADABLE = Code(
    "pose.trajectory-unreadable",
    "A trajectory file that cannot be read",
    """
Twelve or sixteen numbers a line are matrices, eight are TUM's `t tx ty tz qx qy qz qw`, five lines each
are Open3D's `.log`. A file without times needs a pose for every frame, in their order.
""",
    (
        "room/poses.txt: line 3 holds 5 numbers. Expected are 12 or 16 (a matrix), 8 (t tx ty tz qx qy "
        "qz qw), 7 (the same without t) or 3 (a .log header)."
    ),
)
POSE_ASSUMED = Code(
    "pose.assumed",
    "Poses that had to be chosen or paired",
    """
No file of poses was named, or the file has more poses than there are frames. The message says which poses
are used. Nothing has to be done if they are right. Otherwise name a trajectory with `--poses FILE`
(`scan.poses`; [forms](../formats/scans.md#trajectories)).
""",
    "the poses are read from slam.txt, which lies beside the images",
)
POSE_INCONSISTENT_WITH_IMAGES = Code(
    "pose.inconsistent-with-images",
    "Colour, depth and poses do not agree",
    """
`scanloom run` adjusts poses and the colour camera where that helps ([adjust](../stages/adjust.md)). A
shift by more than ten pixels (of photos 640 wide) is not found by outlines: give the colour camera's pose
(`color_from_depth` in [scan.json](../formats/scans.md)), or record depth that is aligned to colour.
""",
    (
        "colour, depth and poses are off by 3.1 px (median of 1,204 points that two frames show): "
        "`scanloom run` adjusts them, `scanloom adjust` does it alone"
    ),
)
SCALE_NOT_METRIC = Code(
    "scale.not-metric",
    "Lengths that are not metres",
    """
Models from images alone have no scale: COLMAP, nerfstudio, Blender's own scenes. All lengths are then in
an unknown unit, and parameters in metres mean that unit. `scan.depth_scale=2.5` says that 2.5 units are
one metre: measure a known distance on the first result, divide, and run again. A median depth of a few
millimetres or of hundreds of metres is a wrong unit of the depth maps: 1000 is millimetres, 5000 TUM's, 1
metres. See [scale and up](../scale-and-up.md).
""",
    (
        "this scan has no metric scale: a unit of its world is taken for a metre, and lengths of all "
        "results are such units; scan.scale=METRES_PER_UNIT, scan.known_distance='MEASURED METRES' or "
        "scan.tag_size=METRES give metres"
    ),
)
SCALE_DEPTH_UNIT_ASSUMED = Code(
    "scale.depth-unit-assumed",
    "A unit of depth that nothing states",
    """
The files do not say how many units of a depth map are one metre, or they say it differently. The message
says which unit is used. If all lengths of the result are wrong by one factor, state the unit with
`scan.depth_scale`: 1000 is millimetres, 5000 TUM's, 1 metres.
""",
    "depth is taken as TUM's 5000 units a metre; where it is in millimetres set scan.depth_scale=1000",
)
SCALE_TAGS_UNRELIABLE = Code(
    "scale.tags-unreliable",
    "Tags that give no scale, or an inaccurate one",
    """
Tags must be printed in one size, lie flat, and be seen sharp in two or more photos from different
positions. `scan.tag_size` is the edge of the black square in metres. See [scale and up](../scale-and-up.md).
""",
    "the scale by tags is known to 2.3% only: so far their sizes differ",
)
CAMERA_LENS_UNKNOWN = Code(
    "camera.lens-unknown",
    "Lenses that are not known",
    """
Known are OpenCV's pinhole camera with up to 14 coefficients, the equidistant fisheye with four, and
models that can be converted to these. Undistort the images with the tool that calibrated them, and give
the camera that it writes.
""",
    (
        "scene/sparse: the FOV lens (omega 0.9) is 4.2 px off from what can be read; undistort the "
        "images with COLMAP's image_undistorter and give the folder it writes."
    ),
)
CAMERA_INTRINSICS_GUESSED = Code(
    "camera.intrinsics-guessed",
    "No intrinsics: a camera is guessed",
    """
A warning where a camera can be guessed, else an error. A wrong guess bends the mesh and makes it too
large or too small. State the camera as `--intrinsics fx,fy,cx,cy` (`scan.intrinsics`) in pixels of the
depth map, or name a file with `scan.calibration` ([forms](../formats/calibrations.md)).

Where poses are missing, [register](../stages/register.md#a-camera-that-nobody-stated) estimates the focal
length with them, and `scanloom inspect` reports the same. It needs ten frame pairs that show the same
surface from different sides. The ± is by how much frame pairs differ; an error that all of them share (a
lens, colour and depth that are not aligned) is not in it.
""",
    (
        "the folder has no intrinsics: 525,525,319.5,239.5 is guessed, a Kinect's view; for another "
        "camera set scan.intrinsics=fx,fy,cx,cy, or name its file with scan.calibration=FILE"
    ),
)
POSE_MISSING = Code(
    "pose.missing",
    "No poses",
    """
Frames with depth get their poses in a run: the stage `register` finds them. Pairs and single views need
poses: name a trajectory with `--poses FILE` (`scan.poses`; [forms](../formats/scans.md#trajectories)).
Where every frame has the same pose, the tracker has written nothing.
""",
    "40753679: no poses: lowres_wide.traj is missing; name a trajectory with scan.poses=FILE",
)
POSE_JUMPS = Code(
    "pose.jumps",
    "Poses that jump, or do not fit the images",
    """
Poses of views without depth that are off by more than a pixel, as those of phones are, are improved, and
held to the given ones; the error that remains is reported. Tracking was lost, or the poses belong to
other frames. `scanloom inspect --picture` draws the path. Leave the first or last frames out with
`scan.first` and `scan.last`, find poses anew with `register.enabled=true`, or give better ones with
`--poses`.
""",
    (
        "the poses are brought nearer to what views recognise in each other: held-out points lie 0.6 "
        "px off, 2.4 px before (median)"
    ),
)
SCALE_UP_UNCERTAIN = Code(
    "scale.up-uncertain",
    "The up direction is not known, or doubtful",
    """
Results lie on their side, or upside down, if the up direction is wrong: `--set upright.up=+y` (an axis,
or three numbers) states it; see [scale and up](../scale-and-up.md). Accelerometers are only used where
the recording says how they are mounted to the camera, and while they read about 9.81 m/s². A camera that
was held sideways or upside down for most of a scan causes a warning, too.
""",
    "imu0 reads 3.2 m/s² (median), which is not gravity: it is not used",
)
DEPTH_RANGE_UNKNOWN = Code(
    "depth.range-unknown",
    "The distance of the scene is not known",
    """
The views recognise no points in each other where the poses say. Check the poses; or state the range of
depth.
""",
    (
        "no points are recognised from view to view where the poses say, and the views look past each "
        "other, so that nothing tells where the scene is; check the poses, or give the range of depth "
        "with depth.min_depth and depth.max_depth (metres)."
    ),
)
FILE_COLMAP_INVALID = Code(
    "file.colmap-invalid",
    "COLMAP's models",
    """
Both `cameras` and `images` have to be there, both as text or both binary, as COLMAP wrote them. A depth
map has to be of the image's size: give the dense workspace's own model (`sparse/` beside `stereo/`).
""",
    "scene/sparse/0/cameras.bin: camera 1 claims to have 0×480 pixels.",
)
RECORDING_SEVERAL = Code(
    "recording.several",
    "A folder with several recordings, or parts of one",
    """
A recording in several files is a folder with its metadata.yaml; give the folder. Several recordings
beside each other are several scans: give the one file.
""",
    "bags: there are 3 recordings in it; give the one to read.",
)
RECORDING_CLOCKS_DIFFER = Code(
    "recording.clocks-differ",
    "Clocks that do not agree",
    """
Streams are paired by the times in their messages. If these are of different clocks, they are paired by
the times at which they were recorded, which is less exact while the camera moves. A trajectory of another
clock, or of frames that are only counted, is paired in order: `scan.poses_by_order=true`, where it has
one pose a frame.
""",
    "room.bag: no depth map and colour image in it are of one moment.",
)
RECORDING_ENCODING_UNKNOWN = Code(
    "recording.encoding-unknown",
    "Encodings that are not known",
    """
Record with the driver's usual encodings: `rgb8` or `bgr8` for colour, `16UC1` for depth, or their
compressed transports (JPEG or PNG; depth as `compressedDepth png`).
""",
    "room.bag: colour is encoded as yuv420, which is not known; record it as rgb8.",
)
RECORDING_WRONG_KIND = Code(
    "recording.wrong-kind",
    "Not the kind of file that its name says",
    """
The extension and the content differ: a renamed file, a database of another program, or a version that
this reader does not know.
""",
    "room.bag: this is a ROS bag of another version than 2.0.",
)
RECORDING_TOPIC_MISSING = Code(
    "recording.topic-missing",
    "The wrong topics",
    """
Needed are images of depth (16UC1 or 32FC1) with a `camera_info`, and colour; or a left and a right image
with theirs.
""",
    (
        "room.bag: there are no depth images in it (sensor_msgs/Image of 16UC1 or 32FC1, `depth` in "
        "the topic's name), and no left/ and right/, only /camera/color/image_raw. Record the depth "
        "topic too."
    ),
)
RECORDING_TOPIC_CHOSEN = Code(
    "recording.topic-chosen",
    "One of several topics is used",
    """
Of several topics one is used, and the message names it; no option chooses another: record, or filter,
only those that are wanted.
""",
    "of 2 topics of depth, /camera/aligned_depth_to_color/image_raw is used",
)
SCAN_SELECTION_EMPTY = Code(
    "scan.selection-empty",
    "A selection that leaves nothing",
    """
Frames are counted from 0, and `scan.last` is the last one that is used. `scan.hold_out=10` needs ten
frames at least.
""",
    "first=200, last=none leaves no frame of the scan's 120.",
)
SCAN_FILES_MISSING = Code(
    "scan.files-missing",
    "Files that a layout needs are missing",
    """
The folder looks like the named data set's, but a part of it is not there: often a folder that was not
unpacked or not exported. Look for the name in the message; a layout's files are those that its own tools
write.
""",
    "40753679: no images named like 41069021_305.377.png in lowres_depth/.",
)
SCAN_FRAMES_SKIPPED = Code(
    "scan.frames-skipped",
    "Frames that are left out",
    """
Each is named in `frames_skipped` of report.json with its reason. A few are harmless. If all frames are
left out, the times of images and poses are from different clocks, or counted instead of measured: give a
trajectory with one pose a frame (KITTI's form has no times).
""",
    "2 frames have no mask in masks/: 000003, 000004",
)
FRAME_IMAGE_MISSING = Code(
    "frame.image-missing",
    "A frame without one of its images",
    """
A frame needs a depth map or a second image, and where other frames have one a colour image. Times of both
have to agree within a few hundredths of a second. If all frames are left out, the times of the images are
from different clocks.
""",
    "frame 000012: its depth map is missing",
)
FRAME_POSE_MISSING = Code(
    "frame.pose-missing",
    "A frame without a pose",
    """
Tracking was lost, or the trajectory has no pose near the time of the frame. If all frames are left out,
the times of images and poses are from different clocks, or counted instead of measured: give a trajectory
with one pose a frame (KITTI's form has no times).
""",
    "frame 000012: tracking was lost: it has no pose",
)
SCAN_IMAGES_UNPAIRED = Code(
    "scan.images-unpaired",
    "Images that do not pair up",
    """
Depth and colour, or left and right, are paired by the numbers in their names, or by their times. Names
that share no numbers are paired in their order, with a warning: name both images of a moment alike if
that is wrong. Frames without a partner are left out.
""",
    (
        "the names in color/ and depth/ share no numbers: they are paired in their order; name the two "
        "images of a moment alike if that is wrong"
    ),
)
SCAN_TABLE_DAMAGED = Code(
    "scan.table-damaged",
    "Lists and tables of a data set that are damaged",
    """
The named line or value is not as the format has it. Get that file again from its source; if it was
edited, compare it with the data set's description. [Formats](../formats/scans.md) has the forms of our
own.
""",
    "room/rgb.txt: it lists no images.",
)
SCAN_DEPTH_MISSING = Code(
    "scan.depth-missing",
    "No depth where depth is needed",
    """
Frames with poses but without depth are *single views*; only some layouts (COLMAP, nerfstudio, Polycam,
Middlebury's multi-view) are read so. Export the depth too: on phones it needs a LiDAR sensor, and is a
switch of the app.
""",
    (
        "room: its views have no depth, and views of this layout alone cannot be read yet. Record3D "
        "writes it to depth/ when it exports with EXR files."
    ),
)
SCAN_PHONE_IMAGES = Code(
    "scan.phone-images",
    "Phones: cropped images, and images as they were tracked",
    """
Images that are cropped or turned no longer fit the camera that was written beside them: export them as
they were taken. Poses before the app's own correction drift.
""",
    (
        "room/cameras/1.json: the images are 1920×1080, which is not the shape of the camera's "
        "1920×1440. Export them again without cropping."
    ),
)
SCAN_CONFIDENCE = Code(
    "scan.confidence",
    "Depth of low confidence",
    """
A phone says for each pixel how far its depth can be trusted. By default only the lowest level is left
out; `scan.least_confidence` keeps more or less of it.
""",
    (
        "depth of confidence 1 and more (of 0, 1, 2) is kept: scan.least_confidence=2 keeps the best "
        "only, scan.least_confidence=0 all; a phone's depth past 5 m is a guess, which "
        "fuse.max_depth=5 leaves out"
    ),
)
SCAN_LAYOUT_UNKNOWN = Code(
    "scan.layout-unknown",
    "The folder is not recognised",
    """
Give the folder that holds the images' folders, not one above or below it; for `.bag`, `.db3`, `.mcap`,
`.sens` and `.r3d` the file itself. Where two layouts would fit, `scan.layout=NAME`
names one; its reader then says exactly which file is missing. A folder of no layout is quickly converted
to [plain-rgbd](../formats/scans.md#plain-rgbd): folders `color/` and `depth/`, and a `scan.json`.
""",
    "photos: the folder is empty.",
)
SCAN_TIMES_IRREGULAR = Code(
    "scan.times-irregular",
    "Times that are odd",
    """
Frames stay in the order of their files. Repeated times and times that go back come from recorders that
write how long a frame took instead of when it was; gaps are frames that were dropped: there the camera
has moved far, and `register` may fail to connect the frames.
""",
    "12 timestamps are repeated",
)
SCAN_TOO_MANY_FRAMES_SKIPPED = Code(
    "scan.too-many-frames-skipped",
    "Too many frames cannot be used",
    """
A stage goes on without single frames, up to a share (`fuse.max_bad_share`, `depth.max_skipped`). Beyond
that, something is wrong with all of them: the message has the reason of the first or the last one, and
these pages explain it.
""",
    "room: none of its 120 frames can be used (frame 000000: its depth map is missing).",
)
SCAN_ASSUMED = Code(
    "scan.assumed",
    "Assumptions about a data set",
    """
The reader had to choose, and says what it chose. Nothing has to be done if it is right.
""",
    "of 2 models, 0/ is read: it has the most images (0/ (120), 1/ (14)). They have no common world",
)
SCAN_ALIGNMENT_MISSING = Code(
    "scan.alignment-missing",
    "ScanNet's axisAlignment cannot be read",
    """
`scan.align_axes` turns the world by the axisAlignment in scene*.txt of the data set. Get that file again,
or leave the option out.
""",
    "scene0000_00: there is no scene*.txt with an axisAlignment; leave scan.align_axes out.",
)
SCAN_OPTION_UNUSED = Code(
    "scan.option-unused",
    "An option that has no effect",
    """
No option is ignored silently. Where the layout's own files already state the value, change it there, or
bring the images into one of the two plain layouts ([formats](../formats/scans.md)).
""",
    "scan.calibration=camera.json has no use: the layout scannet-sens takes none. Leave it out.",
)
USAGE_FRAME_INVALID = Code(
    "usage.frame-invalid",
    "Frames from arrays",
    """
Raised by `Frame.from_arrays` and `Scan.from_frames`; see [frames from arrays](../recipes/arrays.md). The
message names the frame. A colour image is uint8: `np.rint(255 * image).astype(np.uint8)` converts values
from 0 to 1. Depth that is stored in millimetres needs `depth_scale=1000`. A pose takes points of the
camera to the world; the inverse of Open3D's `extrinsic`.
""",
    "frame 3: a colour image must be (h, w, 3) RGB or (h, w) grey uint8, not (480, 640, 3) float64.",
)
