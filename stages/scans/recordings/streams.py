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
from scanloom.stages.scans.recordings.images import topic_images
from scanloom.stages.scans.recordings.pixels import is_color, is_depth
from scanloom.stages.scans.recordings.recording import Recording
from scanloom.stages.scans.recordings.topics import (
    ImageTopic,
    accelerometer_beside,
    between,
    camera_message,
    has_camera,
    image_topics,
)
from scanloom.stages.scans.streams.clocked_streams import (
    Stream,
    Streams,
    extrinsics_unknown,
    stated_depth_camera,
)

# Topic name parts that the drivers of RealSense, Kinect and ZED use for depth registered to the colour
# camera.
_ALIGNED = ("aligned_depth", "depth_registered", "depth_to_rgb")
_LIKE_OPENCV = ("plumb_bob", "rational_polynomial", "none", "")
_FISHEYE = ("equidistant", "fisheye")
_COEFFICIENTS = (0, 4, 5, 8, 12, 14)
# A fisheye model without coefficients still distorts: its coefficients are 0.
_UNBENT = (0.0, 0.0, 0.0, 0.0)
# Encodings that always are depth. mono16 counts as depth only with a matching topic name: infrared images use
# it, too.
_SURELY_DEPTH = ("16uc1", "32fc1")
_NOT_DEPTH = ("infra", "/ir", "confidence", "disparity")
_NOT_COLOR = (*_NOT_DEPTH, "depth")
# Topic of the Azure Kinect driver: colour resampled into the view of the depth camera.
_COLOR_IN_DEPTH = "rgb_to_depth"


def topic_streams(recording: Recording, options: ReadingParams) -> Streams | None:
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
    found = image_topics(recording)
    depths = [one for one in found if _is_depth(one)]
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
    maps = topic_images(depth.name, depth.topic)
    stated = stated_depth_camera(maps, recording.path.parent, options)
    seen = Stream(maps, stated or _recorded_camera(recording, depth))
    colors = [one for one in found if _is_color(one)]
    accelerometer = accelerometer_beside(recording, depth.frame)
    if not colors:
        return Streams(seen, None, scale, None, accelerometer)
    color = min(colors, key=lambda one: _unlikeness(one, depth))
    color_from_depth = None
    is_one_view = _is_aligned(depth) or color.frame == depth.frame
    if not is_one_view:
        color_from_depth = between(recording, depth.frame, color.frame)
        if color_from_depth is None:
            emit(extrinsics_unknown(depth.name, color.name))
    return Streams(
        seen,
        Stream(
            topic_images(color.name, color.topic),
            seen.camera
            if is_one_view and not has_camera(recording, color)
            else _recorded_camera(recording, color),
        ),
        scale,
        color_from_depth,
        accelerometer,
    )


def _is_aligned(depth: ImageTopic) -> bool:
    return any(word in depth.name for word in _ALIGNED)


def _is_depth(images: ImageTopic) -> bool:
    name = images.name.lower()
    is_named = "depth" in name.replace(_COLOR_IN_DEPTH, "")
    is_other = any(word in name for word in _NOT_DEPTH)
    return is_depth(images.encoding) and (
        is_named or (images.encoding.lower() in _SURELY_DEPTH and not is_other)
    )


def _is_color(images: ImageTopic) -> bool:
    name = images.name.lower().replace(_COLOR_IN_DEPTH, "")
    return is_color(images.encoding) and not any(word in name for word in _NOT_COLOR)


def _unlikeness(color: ImageTopic, depth: ImageTopic) -> tuple[object, ...]:
    """Return the sort key of colour topics for a depth topic.

    The topic that fits the depth best sorts first.
    """
    return (
        # With several cameras, topics of the same camera share a prefix.
        -_shared(color.name.split("/"), depth.name.split("/")),
        color.frame != depth.frame,
        "right" in color.name,
        "gray" in color.name or "mono" in color.encoding,
        not color.is_rectified,
        color.is_compressed,
    )


def _shared(name: list[str], other: list[str]) -> int:
    """Return the length of the common prefix of two split topic names."""
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(name, other, strict=False)))


def _recorded_camera(recording: Recording, images: ImageTopic) -> Camera:
    """Return the camera of a topic from its `camera_info`."""
    message = camera_message(recording, images)
    # K and D belong to the raw image, P to the rectified one.
    is_rectified = images.is_rectified and message.projection.any()
    matrix = message.projection if is_rectified else message.matrix
    distortion = () if is_rectified or not any(message.distortion) else message.distortion
    is_fisheye = message.model in _FISHEYE and not is_rectified
    if distortion and message.model not in (*_LIKE_OPENCV, *_FISHEYE):
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
        distortion = (message.distortion or _UNBENT)[: len(_UNBENT)]
    if len(distortion) not in ((len(_UNBENT),) if is_fisheye else _COEFFICIENTS):
        raise InputError(
            CAMERA_LENS_UNKNOWN,
            "the lens model of {images_name} has {distortion_count} coefficients; 4, 5, 8, 12 or 14 "
            "are supported.",
            recording.path,
            images_name=images.name,
            distortion_count=len(distortion),
        )
    camera = calibration.matrix_camera(matrix, distortion, message.width, message.height, recording.path)
    return replace(camera, fisheye=is_fisheye)
