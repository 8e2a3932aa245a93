"""Selection of the depth and colour topics of a ROS recording.

Only images with a `camera_info` are used.

Depth is 16-bit in millimetres or float in metres, as ROS defines. Depth that is aligned to colour is
preferred; otherwise the extrinsics come from `/tf_static`.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import takewhile

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.codes import CAMERA_LENS_UNKNOWN, RECORDING_TOPIC_CHOSEN
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera
from scanloom.stages.scans.recordings.image_decoding import is_color, is_depth
from scanloom.stages.scans.recordings.image_topics import (
    ImageTopic,
    find_accelerometer,
    find_transform,
    has_camera_info,
    list_image_topics,
    read_camera_message,
)
from scanloom.stages.scans.recordings.recording import Recording
from scanloom.stages.scans.recordings.topic_images import wrap_topic_images
from scanloom.stages.scans.streams.timestamped_streams import (
    CameraStream,
    DepthColorStreams,
    create_extrinsics_warning,
    get_stated_depth_camera,
)

# Topic name parts that the drivers of RealSense, Kinect and ZED use for depth registered to the colour
# camera.
_ALIGNED_TOPIC_PARTS = ("aligned_depth", "depth_registered", "depth_to_rgb")
_OPENCV_MODELS = ("plumb_bob", "rational_polynomial", "none", "")
_FISHEYE_MODELS = ("equidistant", "fisheye")
_COEFFICIENT_COUNTS = (0, 4, 5, 8, 12, 14)
# A fisheye model without coefficients still distorts: its coefficients are 0.
_ZERO_DISTORTION = (0.0, 0.0, 0.0, 0.0)
# Encodings that always are depth. mono16 counts as depth only with a matching topic name: infrared images use
# it, too.
_DEPTH_ENCODINGS = ("16uc1", "32fc1")
_NON_DEPTH_TOPIC_PARTS = ("infra", "/ir", "confidence", "disparity")
_NON_COLOR_TOPIC_PARTS = (*_NON_DEPTH_TOPIC_PARTS, "depth")
# Topic of the Azure Kinect driver: colour resampled into the view of the depth camera.
_COLOR_IN_DEPTH_VIEW = "rgb_to_depth"


def select_topic_streams(recording: Recording, options: ReadingParams) -> DepthColorStreams | None:
    """Select the depth and colour topics of a ROS recording.

    Returns None if it has no depth images.

    Parameters
    ----------
    options : intrinsics, calibration and depth scale given by the user take precedence.

    Raises
    ------
    InputError
        If the calibration of the cameras is missing or invalid.
    """
    found = list_image_topics(recording)
    depths = [one for one in found if _is_depth_topic(one)]
    if not depths:
        return None
    depth = min(depths, key=lambda one: (not _is_aligned(one), "depth" not in one.name, one.is_compressed))
    if len(depths) > 1:
        emit(
            RECORDING_TOPIC_CHOSEN.warning(
                "{count} topics contain depth; {name} is used", count=len(depths), name=depth.name
            )
        )
    scale = options.depth_scale or (1.0 if depth.encoding.lower() == "32fc1" else 1000.0)
    maps = wrap_topic_images(depth.name, depth.topic)
    stated = get_stated_depth_camera(maps, recording.path.parent, options)
    depth_stream = CameraStream(maps, stated or _read_camera(recording, depth))
    colors = [one for one in found if _is_color_topic(one)]
    accelerometer = find_accelerometer(recording, depth.frame)
    if not colors:
        return DepthColorStreams(depth_stream, None, scale, None, accelerometer)
    color = min(colors, key=lambda one: _rank_color_topic(one, depth))
    color_from_depth = None
    is_one_view = _is_aligned(depth) or color.frame == depth.frame
    if not is_one_view:
        color_from_depth = find_transform(recording, depth.frame, color.frame)
        if color_from_depth is None:
            emit(create_extrinsics_warning(depth.name, color.name))
    return DepthColorStreams(
        depth_stream,
        CameraStream(
            wrap_topic_images(color.name, color.topic),
            depth_stream.camera
            if is_one_view and not has_camera_info(recording, color)
            else _read_camera(recording, color),
        ),
        scale,
        color_from_depth,
        accelerometer,
    )


def _is_aligned(depth: ImageTopic) -> bool:
    return any(word in depth.name for word in _ALIGNED_TOPIC_PARTS)


def _is_depth_topic(images: ImageTopic) -> bool:
    name = images.name.lower()
    is_named = "depth" in name.replace(_COLOR_IN_DEPTH_VIEW, "")
    is_other = any(word in name for word in _NON_DEPTH_TOPIC_PARTS)
    return is_depth(images.encoding) and (
        is_named or (images.encoding.lower() in _DEPTH_ENCODINGS and not is_other)
    )


def _is_color_topic(images: ImageTopic) -> bool:
    name = images.name.lower().replace(_COLOR_IN_DEPTH_VIEW, "")
    return is_color(images.encoding) and not any(word in name for word in _NON_COLOR_TOPIC_PARTS)


def _rank_color_topic(color: ImageTopic, depth: ImageTopic) -> tuple[object, ...]:
    """Return the sort key of colour topics for a depth topic.

    The topic that fits the depth best sorts first.
    """
    return (
        # With several cameras, topics of the same camera share a prefix.
        -_count_shared_parts(color.name.split("/"), depth.name.split("/")),
        color.frame != depth.frame,
        "right" in color.name,
        "gray" in color.name or "mono" in color.encoding,
        not color.is_rectified,
        color.is_compressed,
    )


def _count_shared_parts(name: list[str], other: list[str]) -> int:
    """Return the length of the common prefix of two split topic names."""
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(name, other, strict=False)))


def _read_camera(recording: Recording, images: ImageTopic) -> Camera:
    """Return the camera of a topic from its `camera_info`."""
    message = read_camera_message(recording, images)
    # K and D belong to the raw image, P to the rectified one.
    is_rectified = images.is_rectified and message.projection.any()
    matrix = message.projection if is_rectified else message.matrix
    distortion = () if is_rectified or not any(message.distortion) else message.distortion
    is_fisheye = message.model in _FISHEYE_MODELS and not is_rectified
    if distortion and message.model not in (*_OPENCV_MODELS, *_FISHEYE_MODELS):
        raise InputError(
            CAMERA_LENS_UNKNOWN,
            (
                "unknown lens model {model!r} of {images_name}; plumb_bob, rational_polynomial and "
                "equidistant are supported."
            ),
            recording.path,
            images_name=images.name,
            model=message.model[:40],
        )
    if is_fisheye:
        distortion = (message.distortion or _ZERO_DISTORTION)[: len(_ZERO_DISTORTION)]
    if len(distortion) not in ((len(_ZERO_DISTORTION),) if is_fisheye else _COEFFICIENT_COUNTS):
        raise InputError(
            CAMERA_LENS_UNKNOWN,
            "the lens model of {images_name} has {distortion_count} coefficients; 4, 5, 8, 12 or 14 "
            "are supported.",
            recording.path,
            images_name=images.name,
            distortion_count=len(distortion),
        )
    camera = calibration.create_camera_from_matrix(
        matrix, distortion, message.width, message.height, recording.path
    )
    return replace(camera, fisheye=is_fisheye)
