"""RealSense `.db3` files, which librealsense writes since version 2.58.

Topic names are the same as in its `.bag` files. Cameras are described as text, `name=value;name=value`.
The capture time of an image is in a metadata message with the same recording time.
"""

from __future__ import annotations

import math
import re
from functools import partial
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import RECORDING_DAMAGED
from scanloom.stages.scans.model.poses import rigid
from scanloom.stages.scans.model.scan import Pose
from scanloom.stages.scans.recordings.images import topic_images
from scanloom.stages.scans.recordings.messages import CameraMessage, read_text
from scanloom.stages.scans.recordings.realsense.streams import (
    MOST_OPTIONS,
    RealSense,
    RealSenseStream,
    accelerometers_of,
)
from scanloom.stages.scans.recordings.recording import Messages, Recording

_IMAGES = re.compile(r"((/device_\d+/sensor_\d+)/([A-Za-z]+)_\d+)/image/data(/compressed|/compressedDepth)?")


def realsense_db3(recording: Recording) -> RealSense | None:
    """Interpret a `.db3` as a RealSense recording.

    Returns None if it has no RealSense image topics.
    """
    streams = {}
    for name, topic in recording.topics.items():
        matched = _IMAGES.fullmatch(name)
        if matched is not None:
            stream, sensor, kind, _ = matched.groups()
            images = topic_images(stream, topic, partial(_stamp, recording, stream, topic))
            streams[stream] = RealSenseStream(kind.lower(), sensor, images)
    if not streams:
        return None
    return RealSense(
        recording.path,
        streams,
        partial(_camera, recording),
        partial(_units, recording),
        partial(_places, recording),
        accelerometers_of(recording),
    )


def _stamp(recording: Recording, name: str, topic: Messages, number: int) -> int:
    """Return the capture time of an image, nanoseconds.

    The metadata message with the same recording time holds the capture time in milliseconds.
    """
    texts = recording.topics.get(f"{name}/image/metadata")
    at = -1 if texts is None else int(np.searchsorted(texts.times, topic.times[number]))
    if texts is None or at >= len(texts.times) or texts.times[at] != topic.times[number]:
        raise InputError(
            RECORDING_DAMAGED,
            "image {number} of {name} has no metadata with its capture time.",
            recording.path,
            number=number,
            name=name,
        )
    said = _values(recording, texts, at)
    (milliseconds,) = _numbers(said, "timestamp", 1, recording.path)
    if not abs(milliseconds) < 1 << 42:
        raise InputError(
            RECORDING_DAMAGED,
            "image {number} of {name}: invalid capture time {milliseconds:g} ms.",
            recording.path,
            number=number,
            name=name,
            milliseconds=milliseconds,
        )
    return round(milliseconds * 1e6)


def _camera(recording: Recording, name: str) -> CameraMessage | None:
    topic = recording.topics.get(f"{name}/camera_info")
    if topic is None:
        return None
    path, said = recording.path, _values(recording, topic, 0)
    width, height, fx, fy, cx, cy = (
        _numbers(said, key, 1, path)[0] for key in ("width", "height", "fx", "fy", "ppx", "ppy")
    )
    if not (width.is_integer() and height.is_integer()):
        raise InputError(
            RECORDING_DAMAGED,
            "invalid image size {width:g}×{height:g} pixels of {name}.",
            path,
            name=name,
            width=width,
            height=height,
        )
    distortion = _numbers(said, "coeffs", 5, path)
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return CameraMessage(
        int(width), int(height), said.get("model", ""), tuple(distortion), matrix, np.eye(3), np.zeros((3, 4))
    )


def _units(recording: Recording, stream: RealSenseStream) -> list[float]:
    option = recording.topics.get(f"{stream.sensor}/option/Depth_Units/value")
    if option is None:
        return []
    words = [_text(recording, option, number) for number in range(min(len(option.times), MOST_OPTIONS))]
    return [_numbers({"Depth_Units": word}, "Depth_Units", 1, recording.path)[0] for word in words]


def _places(recording: Recording, name: str) -> dict[str, Pose]:
    start = f"{name}/tf/"
    found = {}
    for topic in recording.topics:
        if topic.startswith(start):
            said = _values(recording, recording.topics[topic], 0)
            # librealsense stores rotations column-major.
            turn = np.reshape(_numbers(said, "rotation", 9, recording.path), (3, 3)).T
            shift = np.reshape(_numbers(said, "translation", 3, recording.path), (3, 1))
            pose = rigid(np.hstack([turn, shift]), recording.path, topic)
            assert pose is not None
            found[topic.removeprefix(start)] = pose
    return found


def _values(recording: Recording, topic: Messages, number: int) -> dict[str, str]:
    entries = (entry.partition("=") for entry in _text(recording, topic, number).split(";"))
    return {name: value for name, _, value in entries}


def _text(recording: Recording, topic: Messages, number: int) -> str:
    return read_text(topic.read(number, None), recording.path)


def _numbers(said: dict[str, str], key: str, count: int, path: Path) -> list[float]:
    """Parse `count` comma-separated numbers. Raises InputError unless all are finite."""
    try:
        values = [float(word) for word in said.get(key, "").split(",")]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise InputError(
            RECORDING_DAMAGED,
            "{key} is {said!r}; {count} numbers are expected.",
            path,
            key=key,
            said=said.get(key, "")[:40],
            count=count,
        )
    return values
