"""Diagnostic codes of reading scans, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

CAMERA_CALIBRATION_CONTRADICTORY = Code(
    "camera.calibration-contradictory",
    "A calibration that contradicts itself",
    """
The file states a value twice, with different numbers. Often one part was replaced by a newer calibration or
scaled, and the other part was not. Find out which value is right (a known distance in the result checks the
baseline), and remove the other one from the file.
""",
    (
        "room/calibration.yaml: it states different baselines, 120 (T) and 60 (P2); the first one is "
        "used; scan.baseline=METRES overrides it"
    ),
)
CAMERA_CALIBRATION_SCALED = Code(
    "camera.calibration-scaled",
    "A calibration for images of another size",
    """
Intrinsics are in pixels of a certain image size. A calibration for another size with the same aspect ratio
is scaled to the images. This is right if the images were downscaled after the calibration. If the images
were cropped, subtract the removed columns and rows from `cx` and `cy`.
""",
    "room/camera.json: it is for images of 1280×960 px; its camera is scaled to these images of 640×480 px",
)
CAMERA_CALIBRATION_MISMATCH = Code(
    "camera.calibration-mismatch",
    "A calibration that does not fit the images",
    """
Intrinsics are in pixels of a certain image size. A calibration without an image size is used as it is, with
a warning if its principal point is implausible for the images. If the images were cropped, subtract the
removed columns and rows from `cx` and `cy`. If they were rotated, calibrate the rotated camera.
""",
    (
        "room/calibration.json: it is for images of 1280×720 px, but these are 640×480 px. The aspect "
        "ratio differs, so the images were cropped or rotated. Give the calibration of these images."
    ),
)
CAMERA_CALIBRATION_INVALID = Code(
    "camera.calibration-invalid",
    "A calibration with invalid numbers",
    """
Compare the file with [the supported forms](../formats/calibrations.md). Common mistakes: the two cameras are
swapped; T has the opposite direction; the baseline is in millimetres without `unit: mm`; the file contains
the matrices of rectified images, but the images are not rectified.
""",
    (
        "room/calib.yaml: the second camera is not right of the first: T maps left-camera points to "
        "the right camera, so its x must be negative. Are the two cameras swapped?"
    ),
)
CAMERA_CALIBRATION_ASSUMED = Code(
    "camera.calibration-assumed",
    "A calibration that was chosen or interpreted",
    """
Several files or values were possible, or the file does not state what its numbers mean. The message states
the assumption. If it is wrong, give the file with `scan.calibration` ([forms](../formats/calibrations.md)),
the camera with `--intrinsics`, or the baseline with `scan.baseline`.
""",
    (
        "room/calib.yaml: the baseline 120 has no unit and is read as millimetres; if it is not in "
        "millimetres (in centimetres it would be 1.2 m), set scan.baseline=METRES"
    ),
)
CAMERA_ADJUSTED_MISMATCH = Code(
    "camera.adjusted-mismatch",
    "A cameras.json of another scan",
    """
`scan.adjusted_cameras` takes the file that `scanloom adjust`, or the stage `adjust`, wrote for this scan.
Frames are matched by name.
""",
    "room/cameras.json: a cameras.json of `scanloom adjust` is expected.",
)
CAMERA_PAIR_UNCALIBRATED = Code(
    "camera.pair-uncalibrated",
    "Stereo pairs without a calibration",
    """
Focal length × baseline scales every depth of a stereo pair, so scanloom does not guess them. Give a
calibration ([forms](../formats/calibrations.md)), or for rectified images `--intrinsics` and
`scan.baseline`.
""",
    (
        "street: no calibration: calibration.json is missing; name a calibration with "
        "scan.calibration=FILE, or for rectified pairs set scan.intrinsics=fx,fy,cx,cy and "
        "scan.baseline=METRES"
    ),
)
POSE_INVALID = Code(
    "pose.invalid",
    "An invalid pose",
    """
Common causes: left-handed axes, a scale in the matrix, a column-major matrix, or quaternions in the order w x
y z where x y z w is expected. Poses are camera-to-world, with x right, y down, z forward.
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
Lines of 12 or 16 numbers are matrices, lines of 8 numbers are TUM's `t tx ty tz qx qy qz qw`, and blocks of
five lines are Open3D's `.log`. A file without timestamps needs one pose per frame, in frame order.
""",
    (
        "room/poses.txt: line 3 holds 5 numbers; expected are 12 or 16 (a matrix), 8 (t tx ty tz qx qy "
        "qz qw), 7 (the same without t) or 3 (a .log header)."
    ),
)
POSE_ASSUMED = Code(
    "pose.assumed",
    "Poses that were chosen or matched by assumption",
    """
No trajectory was given, or the file has more poses than the scan has frames. The message states which poses
are used. If they are wrong, give a trajectory with `--poses FILE` (`scan.poses`;
[forms](../formats/scans.md#trajectories)).
""",
    "the poses are read from slam.txt, which was found in the scan folder",
)
POSE_INCONSISTENT_WITH_IMAGES = Code(
    "pose.inconsistent-with-images",
    "Colour, depth and poses do not agree",
    """
`scanloom run` adjusts poses and colour camera if that reduces the error ([adjust](../stages/adjust.md)). An
offset between colour and depth of more than ten pixels (at 640 pixels image width) is too large for the
adjustment. In that case give the pose of the colour camera (`color_from_depth` in
[scan.json](../formats/scans.md)), or record depth that is aligned to colour.
""",
    (
        "colour, depth and poses are misaligned by 3.1 px (median of 1,204 points seen in two frames): "
        "`scanloom run` corrects them, `scanloom adjust` does only that"
    ),
)
SCALE_NOT_METRIC = Code(
    "scale.not-metric",
    "Lengths that are not metres",
    """
Models from images alone have an arbitrary scale: COLMAP, nerfstudio, Blender scenes. All lengths are then in
an unknown unit, including parameters in metres. To fix the scale, measure a known distance in the first
result, and run again with `scan.known_distance='MEASURED METRES'`, or set `scan.scale`, the metres per unit.
A median depth of a few millimetres or of hundreds of metres means that the unit of the depth maps is wrong:
`scan.depth_scale` is the number of units per metre, 1000 for millimetres, 5000 for TUM, 1 for metres. See
[scale and up](../scale-and-up.md).
""",
    (
        "this scan has no metric scale: its unit is treated as a metre, so lengths of all results are "
        "in that unit; scan.scale=METRES_PER_UNIT, scan.known_distance='MEASURED METRES' or "
        "scan.tag_size=METRES converts to metres"
    ),
)
SCALE_DEPTH_UNIT_ASSUMED = Code(
    "scale.depth-unit-assumed",
    "Depth maps with an unknown unit",
    """
The files do not state the unit of the depth maps, or they contradict each other. The message states which
unit is used. If all lengths of the result are wrong by one factor, set `scan.depth_scale`, the units per
metre: 1000 for millimetres, 5000 for TUM, 1 for metres.
""",
    (
        "depth is assumed to have TUM's 5000 units per metre; if it is in millimetres, set "
        "scan.depth_scale=1000"
    ),
)
SCALE_TAGS_UNRELIABLE = Code(
    "scale.tags-unreliable",
    "Tags that give no scale, or an inaccurate one",
    """
All tags must be printed in the same size and lie flat. Each tag must be sharp in two or more photos from
different positions. `scan.tag_size` is the edge length of the black square in metres. See
[scale and up](../scale-and-up.md).
""",
    "the scale from tags is only accurate to 2.3%, because their measured sizes differ",
)
CAMERA_LENS_UNKNOWN = Code(
    "camera.lens-unknown",
    "Unsupported lens models",
    """
Supported models are OpenCV's pinhole camera with up to 14 distortion coefficients, the equidistant fisheye
with four, and models that can be converted to these. For other models, undistort the images with the tool
that calibrated them, and give the camera of the undistorted images.
""",
    (
        "scene/sparse: the FOV lens (omega 0.9) cannot be converted to OpenCV's fisheye model: the "
        "error is 4.2 px. Undistort the images with COLMAP's image_undistorter and give the folder it "
        "writes."
    ),
)
CAMERA_INTRINSICS_GUESSED = Code(
    "camera.intrinsics-guessed",
    "No intrinsics: a camera is guessed",
    """
A warning if the camera can be guessed, else an error. A wrong guess bends the mesh and scales it; floors and
walls then appear several times. Name the camera with `--intrinsics d435` (`scan.intrinsics`;
[names](../formats/calibrations.md#cameras-by-name)), give `--intrinsics fx,fy,cx,cy` in pixels of the depth
map, or give a file with `scan.calibration` ([forms](../formats/calibrations.md)). A run repeats the warning
at its end if the guess was not replaced by an estimate.

If poses are missing, too, [register](../stages/register.md#a-camera-that-nobody-stated) estimates the focal
length together with the poses, and `scanloom inspect` reports the estimate. The estimate needs ten frame
pairs that see the same surface from different directions. Its ± is the spread between frame pairs. It does
not include errors that all pairs share, such as lens distortion, or colour that is not aligned to depth.
""",
    (
        "the folder has no intrinsics; 525,525,319.5,239.5 is guessed (the field of view of a Kinect); "
        "for another camera set scan.intrinsics=NAME (such as d435, azure or kinect2), "
        "scan.intrinsics=fx,fy,cx,cy or scan.calibration=FILE"
    ),
)
POSE_MISSING = Code(
    "pose.missing",
    "No poses",
    """
For frames with depth, the stage `register` of a run estimates the poses, for photos alone the stage
`structure`. Stereo pairs require poses: give a trajectory with `--poses FILE` (`scan.poses`;
[forms](../formats/scans.md#trajectories)). If all frames have the same pose, the recorder had no tracking.
""",
    "40753679: no poses: lowres_wide.traj is missing; name a trajectory with scan.poses=FILE",
)
POSE_JUMPS = Code(
    "pose.jumps",
    "Poses that jump, or do not fit the images",
    """
Either tracking was lost, or the poses belong to other frames. `scanloom inspect --picture` draws the path.
Exclude the first or last frames with `scan.first` and `scan.last`, estimate the poses again with
`register.enabled=true`, or give better ones with `--poses`.

Poses of views without depth are refined if they are wrong by more than a pixel, which is common for phones.
The given poses are the prior of the refinement. The message reports the error before and after.
""",
    (
        "the poses are brought nearer to what views recognise in each other: held-out points lie 0.6 "
        "px off, 2.4 px before (median)"
    ),
)
SCALE_UP_UNCERTAIN = Code(
    "scale.up-uncertain",
    "The up direction is unknown or uncertain",
    """
With a wrong up direction, results lie on their side or upside down. `--set upright.up=+y` (an axis, or three
numbers) sets it; see [scale and up](../scale-and-up.md). Accelerometers are only used if the recording
states their orientation to the camera, and if they read about 9.81 m/s². There is also a warning if the
camera was held sideways or upside down for most of a scan.
""",
    "imu0 reads 3.2 m/s² (median), which is not gravity: it is not used",
)
DEPTH_RANGE_UNKNOWN = Code(
    "depth.range-unknown",
    "The distance of the scene is unknown",
    """
No feature matches between views are consistent with the poses, so the depth range cannot be estimated. Check
the poses, or set the depth range with `depth.min_depth` and `depth.max_depth`.
""",
    (
        "no points are recognised from view to view where the poses say, and the views look past each "
        "other, so that nothing tells where the scene is; check the poses, or give the range of depth "
        "with depth.min_depth and depth.max_depth (metres)."
    ),
)
FILE_COLMAP_INVALID = Code(
    "file.colmap-invalid",
    "Invalid COLMAP models",
    """
A model needs both `cameras` and `images`, in the same format (text or binary), as COLMAP wrote them. A depth
map must have the size of its image: give the model of the dense workspace (`sparse/` next to `stereo/`).
""",
    "scene/sparse/0/cameras.bin: camera 1 states an invalid size of 0×480 pixels.",
)
RECORDING_SEVERAL = Code(
    "recording.several",
    "A folder with several recordings, or parts of one",
    """
If a recording consists of several files, give its folder, which contains metadata.yaml. Several recordings
in a folder are several scans: give one of the files.
""",
    "bags: the folder has 3 recordings; give the recording to read.",
)
RECORDING_CLOCKS_DIFFER = Code(
    "recording.clocks-differ",
    "Clocks that do not agree",
    """
Streams are synchronised by the timestamps in their messages. If these come from different clocks, the
recording times are used instead, which are less accurate while the camera moves. A trajectory with another
clock, or with frame numbers instead of times, can be matched by order with `scan.poses_by_order=true`, if
it has one pose per frame.
""",
    "room.bag: no depth map and colour image were captured at the same time.",
)
RECORDING_ENCODING_UNKNOWN = Code(
    "recording.encoding-unknown",
    "Unsupported image encodings",
    """
Record with the usual encodings of the driver: `rgb8` or `bgr8` for colour, `16UC1` for depth, or their
compressed transports (JPEG or PNG; depth as `compressedDepth png`).
""",
    "room.bag: unknown colour encoding 'yuv420'; record colour as rgb8.",
)
RECORDING_WRONG_KIND = Code(
    "recording.wrong-kind",
    "A file whose content does not match its extension",
    """
The file was renamed, is a database of another program, or has a version that scanloom does not support.
""",
    "room.bag: this is a ROS bag of another version; the file must begin with `#ROSBAG V2.0`.",
)
RECORDING_TOPIC_MISSING = Code(
    "recording.topic-missing",
    "Missing topics",
    """
A recording needs depth images (16UC1 or 32FC1) with a `camera_info`, and colour images; or left and right
images with a `camera_info` each.
""",
    (
        "room.bag: the recording has neither depth images (sensor_msgs/Image with 16UC1 or 32FC1, `depth` "
        "in the topic name) nor a left and a right image topic, only /camera/color/image_raw. Record the "
        "depth topic as well."
    ),
)
RECORDING_TOPIC_CHOSEN = Code(
    "recording.topic-chosen",
    "One of several topics is used",
    """
The recording has several topics of the same kind; the message states which one is used. There is no option
to choose another one: record only the required topics, or filter the recording.
""",
    "2 topics contain depth; /camera/aligned_depth_to_color/image_raw is used",
)
SCAN_SELECTION_EMPTY = Code(
    "scan.selection-empty",
    "A selection without frames",
    """
Frames are counted from 0, and `scan.last` is included. `scan.hold_out=10` requires at least ten frames.
""",
    "scan.first=200, scan.last=None selects none of the scan's 120 frames.",
)
SCAN_FILES_MISSING = Code(
    "scan.files-missing",
    "Files that a layout requires are missing",
    """
The folder looks like the given data set, but a part is missing. Often a folder was not unpacked or not
exported. The message names the missing part. Each layout requires the files that its own tools write.
""",
    "40753679: lowres_depth/ has no images named like 41069021_305.377.png.",
)
SCAN_FRAMES_SKIPPED = Code(
    "scan.frames-skipped",
    "Skipped frames",
    """
`frames_skipped` in report.json lists each frame with its reason. A few skipped frames are harmless. If all
frames are skipped, the times of images and poses come from different clocks, or are frame numbers. Then give
a trajectory with one pose per frame (KITTI's format has no times).
""",
    "2 frames have no mask in masks/: 000003, 000004",
)
FRAME_IMAGE_MISSING = Code(
    "frame.image-missing",
    "A frame without one of its images",
    """
A frame needs a depth map or a second image, and a colour image if other frames have one. Their timestamps
must agree within a few hundredths of a second. If all frames are skipped, the timestamps come from different
clocks.
""",
    "frame 000012: its depth map is missing",
)
FRAME_POSE_MISSING = Code(
    "frame.pose-missing",
    "A frame without a pose",
    """
Tracking was lost, or the trajectory has no pose near the time of the frame. If all frames are skipped, the
times of images and poses come from different clocks, or are frame numbers. Then give a trajectory with one
pose per frame (KITTI's format has no times).
""",
    "frame 000012: tracking was lost: it has no pose",
)
SCAN_PREDICTION_INVALID = Code(
    "scan.prediction-invalid",
    "Predictions with missing or unsuitable arrays",
    """
Predicted scans are archives of NumPy arrays, as `np.savez` writes them, with one item per view. `depth`,
`intrinsic` and `extrinsic` (or `camera_poses`) are required ([predictions](../formats/scans.md#predictions)).
""",
    "room/predictions.npz: the array extrinsic is (12, 4); (12, 3, 4) is expected.",
)
SCAN_DEPTH_ALIGNED = Code(
    "scan.depth-aligned",
    "Predicted depth was made consistent between views",
    """
A network predicts the depth of each view with a slightly different scale and offset. Both are corrected so
that overlapping views agree. The poses are not changed; the stage `adjust` does that.
""",
    (
        "predicted depth of 24 views is multiplied by 0.94 to 1.07, with an offset: overlapping views then "
        "differ by 0.81% instead of 3.40% (median)"
    ),
)
SCAN_IMAGES_UNPAIRED = Code(
    "scan.images-unpaired",
    "Images that cannot be paired",
    """
Depth and colour images, or left and right images, are paired by the numbers in their names, or by their
timestamps. If their names share no numbers, they are paired by order, with a warning. If that is wrong, give
both images of a frame the same name. Images without a counterpart are skipped.
""",
    (
        "the names in color/ and depth/ share no numbers: the images are paired by position; if that is "
        "wrong, give the two images of a frame the same number"
    ),
)
SCAN_TABLE_DAMAGED = Code(
    "scan.table-damaged",
    "Damaged lists and tables of a data set",
    """
A line or value does not follow the format. Download or copy the file again; if it was edited, compare it with
the description of the data set. [Formats](../formats/scans.md) describes scanloom's own formats.
""",
    "room/rgb.txt: the file lists no images.",
)
SCAN_DEPTH_MISSING = Code(
    "scan.depth-missing",
    "Missing depth",
    """
Frames with poses but without depth are *single views*, which only some layouts support (COLMAP, nerfstudio,
Polycam, Middlebury's multi-view). Export the depth, too. Phones need a LiDAR sensor for this, and often a
setting of the app.
""",
    (
        "room: the views have no depth, and this layout requires depth. Record3D writes depth/ if the "
        "export includes EXR files."
    ),
)
SCAN_PHONE_IMAGES = Code(
    "scan.phone-images",
    "Phones: cropped images, and images as they were tracked",
    """
Cropped or rotated images no longer fit the camera in the export: export the original images. Poses from live
tracking, before the correction of the app, drift.
""",
    (
        "room/cameras/1.json: the size of the images is 1920×1080 pixels, but the camera has another aspect"
        " ratio (1920×1440). Export the images again without cropping."
    ),
)
SCAN_CONFIDENCE = Code(
    "scan.confidence",
    "Depth of low confidence",
    """
Phones store a confidence for each depth value. By default, only depth of the lowest confidence is ignored;
`scan.min_confidence` changes the threshold.
""",
    (
        "depth of confidence 1 or higher (levels 0, 1, 2) is used: scan.min_confidence=2 keeps only the "
        "highest level, scan.min_confidence=0 keeps everything. Depth of phones is unreliable beyond 5 m;"
        " fuse.max_depth=5 ignores it"
    ),
)
SCAN_LAYOUT_UNKNOWN = Code(
    "scan.layout-unknown",
    "The layout of the folder is not recognised",
    """
Give the folder that contains the image folders. A folder that holds exactly one scan is replaced by that
scan, with a notice. The message names the next step for archives, meshes, photos without poses, and
pairs of images under unknown names. For `.bag`, `.db3`, `.mcap`,
`.sens`, `.r3d` and videos, give the file itself. If several layouts would fit, `scan.layout=NAME`
selects one; its reader then reports which file is missing. Any other folder can be converted to
[plain-rgbd](../formats/scans.md#plain-rgbd): folders `color/` and `depth/`, and a `scan.json`.
""",
    "photos: the folder is empty.",
)
SCAN_TIMES_IRREGULAR = Code(
    "scan.times-irregular",
    "Irregular timestamps",
    """
Frames stay in file order. Repeated or decreasing timestamps come from recorders that write the duration of a
frame instead of its time. Gaps are dropped frames: the camera has moved far in between, so `register` may
fail to connect the frames.
""",
    "12 timestamps are repeated",
)
SCAN_TOO_MANY_FRAMES_SKIPPED = Code(
    "scan.too-many-frames-skipped",
    "Too many frames cannot be used",
    """
A stage skips single unusable frames, up to a ratio of all frames (`fuse.max_skipped_ratio`,
`depth.max_skipped_ratio`).
With more, there is a problem with the whole scan. The message has the reason of the first or last skipped
frame, which these pages explain.
""",
    "room: none of its 120 frames can be used (frame 000000: its depth map is missing).",
)
SCAN_ASSUMED = Code(
    "scan.assumed",
    "Assumptions about a data set",
    """
The reader had several options; the message states which one it used.
""",
    (
        "the folder has 2 models without a common world frame: 0/ is read, which has the most images (0/ "
        "(120), 1/ (14))"
    ),
)
SCAN_ALIGNMENT_MISSING = Code(
    "scan.alignment-missing",
    "ScanNet's axisAlignment cannot be read",
    """
`scan.align_axes` rotates the world by the axisAlignment in scene*.txt of the data set. Download that file
again, or remove the option.
""",
    "scene0000_00: the folder has no scene*.txt with an axisAlignment; leave out scan.align_axes.",
)
SCAN_OPTION_UNUSED = Code(
    "scan.option-unused",
    "An option that has no effect",
    """
Options without effect are errors. If the files of the layout already contain the value, change it
there, or convert the images to one of the two plain layouts ([formats](../formats/scans.md)).
""",
    (
        "scan.calibration=camera.json has no effect: the layout scannet-sens does not use it. Remove the "
        "option."
    ),
)
USAGE_FRAME_INVALID = Code(
    "usage.frame-invalid",
    "Invalid frames from arrays",
    """
Raised by `Frame.from_arrays` and `Scan.from_frames`; see [frames from arrays](../recipes/arrays.md). The
message names the frame. Colour images are uint8: `np.rint(255 * image).astype(np.uint8)` converts values from
0 to 1. Depth in millimetres needs `depth_scale=1000`. A pose maps points from camera to world coordinates; it
is the inverse of Open3D's `extrinsic`.
""",
    "frame 3: a colour image must be (h, w, 3) RGB or (h, w) grey uint8, not (480, 640, 3) float64.",
)
SCAN_VIDEO_TOO_LONG = Code(
    "scan.video-too-long",
    "Videos with too many frames",
    """
Exit code 3. Videos of up to 108,000 frames are read, an hour at 30 frames per second. The message contains a
command that cuts a part without encoding it again. A few minutes suffice for a room or an object.
""",
    "walk.mp4: the video has more than 108,000 frames.",
)
