"""Stream selection and calibration of RealSense recordings.

Common to the `.bag` and `.db3` files of librealsense, which use the same names.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration import rig_calibration
from scanloom.stages.scans.calibration.realsense import is_opencv_model
from scanloom.stages.scans.codes import (
    CAMERA_INTRINSICS_GUESSED,
    CAMERA_LENS_UNKNOWN,
    CAMERA_PAIR_UNCALIBRATED,
    RECORDING_TOPIC_CHOSEN,
    RECORDING_TOPIC_MISSING,
    SCALE_DEPTH_UNIT_ASSUMED,
)
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Pose
from scanloom.stages.scans.recordings.image_topics import read_topic_acceleration
from scanloom.stages.scans.recordings.messages import CameraMessage
from scanloom.stages.scans.recordings.recording import Recording, TopicMessages
from scanloom.stages.scans.streams.stereo_rigs import read_stated_rig
from scanloom.stages.scans.streams.timestamped_streams import (
    Accelerometer,
    CameraStream,
    DepthColorStreams,
    StereoStreams,
    TimestampedImages,
    create_extrinsics_warning,
    get_stated_depth_camera,
)

# Maximum number of recorded option values to read: users change an option rarely, a damaged file may claim
# millions.
MAX_OPTION_VALUES = 100
# Metres. Millimetres are the default of nearly all models.
_DEFAULT_DEPTH_UNIT_M = 0.001
# Metres. Depth units outside this range are damaged.
_DEPTH_UNIT_RANGE_M = (1e-9, 1e3)


_ACCELEROMETER_TOPIC = re.compile(r"(/device_\d+/sensor_\d+/(?:Accel|Motion)_\d+)/imu/data")


@dataclass(frozen=True, eq=False)
class RealSenseStream:
    """An image stream of a RealSense recording.

    Attributes
    ----------
    kind : `depth`, `color`, `infrared`, ….
    sensor : topic name prefix that all streams of one sensor share.
    """

    kind: str
    sensor: str
    images: TimestampedImages


@dataclass(frozen=True, eq=False)
class RealSenseRecording:
    """Contents of a RealSense recording, independent of the file format.

    The callables raise InputError if the file is damaged.

    Attributes
    ----------
    streams : image streams, by name.
    read_camera : return the camera message of a stream, or None.
    read_depth_units : return all depth units, in metres, that the sensor of a stream had during the
        recording.
    read_extrinsics : return the transforms (4, 4) from reference frames to the camera of a stream, by name of
        the
        reference.
    accelerometers : accelerometer topics, by name of the stream.
    """

    path: Path
    streams: Mapping[str, RealSenseStream]
    read_camera: Callable[[str], CameraMessage | None]
    read_depth_units: Callable[[RealSenseStream], Sequence[float]]
    read_extrinsics: Callable[[str], Mapping[str, Pose]]
    accelerometers: Mapping[str, TopicMessages]


def find_accelerometers(recording: Recording) -> dict[str, TopicMessages]:
    """Return the accelerometer topics of a recording, by name of the stream."""
    found = ((_ACCELEROMETER_TOPIC.fullmatch(name), topic) for name, topic in recording.topics.items())
    return {matched[1]: topic for matched, topic in found if matched is not None}


def select_realsense_streams(
    recording: RealSenseRecording, options: ReadingParams
) -> DepthColorStreams | StereoStreams:
    """Select the depth and colour streams, or the infrared pair, of a recording.

    The infrared pair is used if there is no depth.

    Parameters
    ----------
    options : intrinsics, calibration, depth scale and baseline given by the user take precedence.

    Raises
    ------
    InputError
        If there is neither depth nor an infrared pair, or the calibration is missing or invalid.
    """
    streams = [recording.streams[name] for name in sorted(recording.streams)]
    depth = next((one for one in streams if one.kind == "depth"), None)
    if depth is None:
        return _select_infrared_pair(recording, streams, options)
    name, folder = depth.images.name, recording.path.parent
    stated = get_stated_depth_camera(depth.images, folder, options)
    depth_stream = CameraStream(depth.images, stated or _read_camera(recording, name))
    scale = _resolve_depth_scale(recording, depth, options)
    accelerometer = _find_accelerometer(recording, name)
    # The depth of RealSense cameras is in the frame of the left infrared camera, so its images are aligned
    # with depth.
    grey = [one for one in streams if one.kind == "infrared" and one.sensor == depth.sensor]
    color = next((one for one in (*(one for one in streams if one.kind == "color"), *grey)), None)
    if color is None:
        return DepthColorStreams(depth_stream, None, scale, None, accelerometer)
    if color.kind != "color":
        emit(
            RECORDING_TOPIC_CHOSEN.warning(
                "the recording has no colour stream: infrared images are used instead"
            )
        )
    color_from_depth = _find_extrinsics(recording, name, color.images.name)
    if color_from_depth is None:
        emit(create_extrinsics_warning(name, color.images.name))
    color_camera = _read_camera(recording, color.images.name)
    return DepthColorStreams(
        depth_stream, CameraStream(color.images, color_camera), scale, color_from_depth, accelerometer
    )


def _select_infrared_pair(
    recording: RealSenseRecording, streams: Sequence[RealSenseStream], options: ReadingParams
) -> StereoStreams:
    """Return the infrared stereo pair of the depth sensor.

    The name of the left stream sorts first.
    """
    grey = [one for one in streams if one.kind == "infrared"]
    if len(grey) < 2 or grey[0].sensor != grey[1].sensor:
        names = ", ".join(one.images.name for one in streams)
        raise InputError(
            RECORDING_TOPIC_MISSING,
            "the recording has no depth stream, only {names}.",
            recording.path,
            remedy="Record the depth stream as well.",
            names=names,
        )
    left, right = (one.images for one in grey[:2])
    stated = read_stated_rig(left, recording.path.parent, options)
    if stated is not None:
        return StereoStreams(left, right, stated, _find_accelerometer(recording, left.name))
    cameras = [_read_camera(recording, one.name) for one in (left, right)]
    right_from_left = _find_extrinsics(recording, left.name, right.name)
    if right_from_left is None and options.baseline is None:
        raise InputError(
            CAMERA_PAIR_UNCALIBRATED,
            "the recording does not contain the extrinsics between {left_name} and {right_name}",
            recording.path,
            remedy="set scan.baseline=METRES.",
            left_name=left.name,
            right_name=right.name,
        )
    extrinsics = np.eye(4) if right_from_left is None else right_from_left
    document: dict[str, Any] = {"unit": "m", "R": extrinsics[:3, :3], "T": extrinsics[:3, 3]}
    for side, camera in zip(("1", "2"), cameras, strict=True):
        document |= {f"K{side}": camera.matrix, f"D{side}": camera.distortion}
    rig = rig_calibration.read_rig(
        recording.path, cameras[0].width, cameras[0].height, document=document, baseline=options.baseline
    )
    return StereoStreams(left, right, rig, _find_accelerometer(recording, left.name))


def _read_camera(recording: RealSenseRecording, name: str) -> Camera:
    """Return the camera of a stream as recorded."""
    message = recording.read_camera(name)
    if message is None:
        raise InputError(
            CAMERA_INTRINSICS_GUESSED,
            "the recording has no intrinsics (camera_info) for {name}",
            recording.path,
            remedy="set scan.intrinsics=fx,fy,cx,cy.",
            name=name,
        )
    distortion = message.distortion[:5] if any(message.distortion) else ()
    if distortion and not is_opencv_model(message.model):
        raise InputError(
            CAMERA_LENS_UNKNOWN,
            "unknown lens model {model!r} of {name}; only Brown-Conrady models are supported.",
            recording.path,
            name=name,
            model=message.model[:40],
        )
    return calibration.create_camera_from_matrix(
        message.matrix, distortion, message.width, message.height, recording.path
    )


def _resolve_depth_scale(
    recording: RealSenseRecording, depth: RealSenseStream, options: ReadingParams
) -> float:
    """Return the depth scale (units per metre), stated or recorded."""
    if options.depth_scale is not None:
        return options.depth_scale
    units = recording.read_depth_units(depth)
    if not units or not units[-1]:
        units = [_DEFAULT_DEPTH_UNIT_M]
        emit(
            SCALE_DEPTH_UNIT_ASSUMED.warning(
                "the recording does not state its depth unit: millimetres are assumed",
                remedy="set scan.depth_scale=UNITS_PER_METRE if that is wrong",
            )
        )
    last = units[-1]
    if len(set(units)) > 1:
        emit(
            SCALE_DEPTH_UNIT_ASSUMED.warning(
                "the depth unit changes within the recording: the last value, {last:g} m, is used for all "
                "frames.",
                remedy="Set scan.depth_scale=UNITS_PER_METRE if that is wrong.",
                last=last,
            )
        )
    if not _DEPTH_UNIT_RANGE_M[0] <= last <= _DEPTH_UNIT_RANGE_M[1]:
        raise InputError(
            SCALE_DEPTH_UNIT_ASSUMED,
            "the depth unit is {last:g} m, outside the valid range (1 nm to 1 km)",
            recording.path,
            remedy="set scan.depth_scale=UNITS_PER_METRE.",
            last=last,
        )
    return 1 / last


def _find_accelerometer(recording: RealSenseRecording, camera: str) -> Accelerometer | None:
    """Return the accelerometer relative to the camera of a stream, or None."""
    name = min(recording.accelerometers, default=None)
    if name is None:
        return None
    try:
        extrinsics = _find_extrinsics(recording, name, camera)
    except InputError:
        extrinsics = None
    # Without extrinsics the axes are taken as equal: librealsense rotates readings to the axes of the depth
    # camera before recording.
    turn = np.eye(3) if extrinsics is None else extrinsics[:3, :3]
    topic = recording.accelerometers[name]
    return Accelerometer(name, topic.record_times_ns, partial(read_topic_acceleration, topic), turn)


def _find_extrinsics(recording: RealSenseRecording, depth: str, color: str) -> Pose | None:
    """Return color_from_depth (4, 4), or None without a common reference frame."""
    of_depth, of_color = recording.read_extrinsics(depth), recording.read_extrinsics(color)
    shared = min(of_depth.keys() & of_color.keys(), default=None)
    return None if shared is None else np.asarray(of_color[shared] @ invert_pose(of_depth[shared]))
