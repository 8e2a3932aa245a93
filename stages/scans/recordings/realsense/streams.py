"""Which streams of a RealSense recording make up the scan, and how its cameras stand: the file says it all.

The maker's library has written two kinds of file, with the same names for the same things.
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
from scanloom.stages.scans.calibration.realsense import is_like_opencv
from scanloom.stages.scans.codes import (
    CAMERA_INTRINSICS_GUESSED,
    CAMERA_LENS_UNKNOWN,
    CAMERA_PAIR_UNCALIBRATED,
    RECORDING_TOPIC_CHOSEN,
    RECORDING_TOPIC_MISSING,
    SCALE_DEPTH_UNIT_ASSUMED,
)
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Pose
from scanloom.stages.scans.recordings.messages import CameraMessage
from scanloom.stages.scans.recordings.recording import Messages, Recording
from scanloom.stages.scans.recordings.topics import acceleration
from scanloom.stages.scans.streams.clocked_streams import (
    Accelerometer,
    Images,
    Pair,
    Stream,
    Streams,
    extrinsics_unknown,
    stated_depth_camera,
)
from scanloom.stages.scans.streams.stereo_rigs import stated_rig

# A person changes an option now and then, a damaged file a million times: so many values are read.
MOST_OPTIONS = 100
# Millimetres are by far the most frequent, but not what every model records.
_USUAL_UNITS = 0.001
# Metres; a unit of less than a nanometre or more than a kilometre is damaged.
_UNITS = (1e-9, 1e3)


_ACCELEROMETER = re.compile(r"(/device_\d+/sensor_\d+/(?:Accel|Motion)_\d+)/imu/data")


@dataclass(frozen=True, eq=False)
class RealSenseStream:
    """A stream of images in a recording.

    Attributes
    ----------
    kind : `depth`, `color`, `infrared`, ….
    sensor : the part of the topics' names that streams of one sensor share.
    """

    kind: str
    sensor: str
    images: Images


@dataclass(frozen=True, eq=False)
class RealSense:
    """What a recording says, in whichever kind of file; all of it raises InputError where it is damaged.

    Attributes
    ----------
    streams : by name.
    camera : returns that of a stream, or None.
    units : returns the depth units, in metres, that a stream's sensor had one after the other; or none.
    places : returns what takes points of a reference to a stream's camera, by the reference's name.
    accelerometers : the topics of their readings, by name of the stream.
    """

    path: Path
    streams: Mapping[str, RealSenseStream]
    camera: Callable[[str], CameraMessage | None]
    units: Callable[[RealSenseStream], Sequence[float]]
    places: Callable[[str], Mapping[str, Pose]]
    accelerometers: Mapping[str, Messages]


def accelerometers_of(recording: Recording) -> dict[str, Messages]:
    """Return the topics of accelerometers' readings in either kind of file, by the name of the stream."""
    found = ((_ACCELEROMETER.fullmatch(name), topic) for name, topic in recording.topics.items())
    return {matched[1]: topic for matched, topic in found if matched is not None}


def realsense_streams(recording: RealSense, options: ReadingParams) -> Streams | Pair:
    """Return depth and colour of a recording, or its infrared pair if it holds no depth.

    Raises
    ------
    InputError
        If it holds neither, or what it says of its cameras is missing or wrong.
    """
    streams = [recording.streams[name] for name in sorted(recording.streams)]
    depth = next((one for one in streams if one.kind == "depth"), None)
    if depth is None:
        return _infrared_pair(recording, streams, options)
    name, folder = depth.images.name, recording.path.parent
    stated = stated_depth_camera(depth.images, folder, options)
    seen = Stream(depth.images, stated or _recorded_camera(recording, name))
    scale = _depth_scale(recording, depth, options)
    beside = _accelerometer(recording, name)
    # The left infrared camera is the one that depth is seen from.
    grey = [one for one in streams if one.kind == "infrared" and one.sensor == depth.sensor]
    color = next((one for one in (*(one for one in streams if one.kind == "color"), *grey)), None)
    if color is None:
        return Streams(seen, None, scale, None, beside)
    if color.kind != "color":
        emit(
            RECORDING_TOPIC_CHOSEN.warning(
                "there is no colour stream: the infrared camera's images stand for it"
            )
        )
    color_from_depth = _between(recording, name, color.images.name)
    if color_from_depth is None:
        emit(extrinsics_unknown(name, color.images.name))
    color_camera = _recorded_camera(recording, color.images.name)
    return Streams(seen, Stream(color.images, color_camera), scale, color_from_depth, beside)


def _infrared_pair(recording: RealSense, streams: Sequence[RealSenseStream], options: ReadingParams) -> Pair:
    """Return the images that the maker's depth is computed from; the left camera's come first by name."""
    grey = [one for one in streams if one.kind == "infrared"]
    if len(grey) < 2 or grey[0].sensor != grey[1].sensor:
        names = ", ".join(one.images.name for one in streams)
        raise InputError(
            RECORDING_TOPIC_MISSING,
            "the recording holds no depth, only {names}.",
            recording.path,
            remedy="Record the depth stream too.",
            names=names,
        )
    left, right = (one.images for one in grey[:2])
    stated = stated_rig(left, recording.path.parent, options)
    if stated is not None:
        return Pair(left, right, stated, _accelerometer(recording, left.name))
    cameras = [_recorded_camera(recording, one.name) for one in (left, right)]
    right_from_left = _between(recording, left.name, right.name)
    if right_from_left is None and options.baseline is None:
        raise InputError(
            CAMERA_PAIR_UNCALIBRATED,
            "how {left_name} and {right_name} stand to each other is not in it",
            recording.path,
            remedy="set scan.baseline=METRES.",
            left_name=left.name,
            right_name=right.name,
        )
    stands = np.eye(4) if right_from_left is None else right_from_left
    document: dict[str, Any] = {"unit": "m", "R": stands[:3, :3], "T": stands[:3, 3]}
    for side, camera in zip(("1", "2"), cameras, strict=True):
        document |= {f"K{side}": camera.matrix, f"D{side}": camera.distortion}
    rig = rig_calibration.read_rig(
        recording.path, cameras[0].width, cameras[0].height, document=document, baseline=options.baseline
    )
    return Pair(left, right, rig, _accelerometer(recording, left.name))


def _recorded_camera(recording: RealSense, name: str) -> Camera:
    """Return the camera of a stream as the recording states it."""
    said = recording.camera(name)
    if said is None:
        raise InputError(
            CAMERA_INTRINSICS_GUESSED,
            "the recording does not say what camera {name} is of (no camera_info)",
            recording.path,
            remedy="set scan.intrinsics=fx,fy,cx,cy.",
            name=name,
        )
    distortion = said.distortion[:5] if any(said.distortion) else ()
    if distortion and not is_like_opencv(said.model):
        raise InputError(
            CAMERA_LENS_UNKNOWN,
            "the lens of {name} is described as {model!r}, which is not known; Brown-Conrady's models are.",
            recording.path,
            name=name,
            model=said.model[:40],
        )
    return calibration.matrix_camera(said.matrix, distortion, said.width, said.height, recording.path)


def _depth_scale(recording: RealSense, depth: RealSenseStream, options: ReadingParams) -> float:
    """Return the depth units a metre, as stated or as recorded."""
    if options.depth_scale is not None:
        return options.depth_scale
    units = recording.units(depth)
    if not units or not units[-1]:
        units = [_USUAL_UNITS]
        emit(
            SCALE_DEPTH_UNIT_ASSUMED.warning(
                "the recording does not say its depth unit: millimetres are assumed",
                remedy="scan.depth_scale=VALUE states how many units are one metre",
            )
        )
    last = units[-1]
    if len(set(units)) > 1:
        emit(
            SCALE_DEPTH_UNIT_ASSUMED.warning(
                "the depth unit changes within the recording; the last, {last:g} m, is used for all of it.",
                remedy="scan.depth_scale=VALUE states another, in units a metre",
                last=last,
            )
        )
    if not _UNITS[0] <= last <= _UNITS[1]:
        raise InputError(
            SCALE_DEPTH_UNIT_ASSUMED,
            "its depth unit is {last:g} m, which cannot be right",
            recording.path,
            remedy="scan.depth_scale=VALUE states how many units are one metre.",
            last=last,
        )
    return 1 / last


def _accelerometer(recording: RealSense, camera: str) -> Accelerometer | None:
    """Return the accelerometer of a recording, beside the camera of a stream."""
    name = min(recording.accelerometers, default=None)
    if name is None:
        return None
    try:
        stands = _between(recording, name, camera)
    except InputError:
        stands = None
    # The maker's library turns readings to the axes of the depth camera before it records them.
    turn = np.eye(3) if stands is None else stands[:3, :3]
    topic = recording.accelerometers[name]
    return Accelerometer(name, topic.times, partial(acceleration, topic), turn)


def _between(recording: RealSense, depth: str, color: str) -> Pose | None:
    """Return color_from_depth, by the reference that both streams state their place to; None without one."""
    of_depth, of_color = recording.places(depth), recording.places(color)
    shared = min(of_depth.keys() & of_color.keys(), default=None)
    return None if shared is None else np.asarray(of_color[shared] @ inverted(of_depth[shared]))
