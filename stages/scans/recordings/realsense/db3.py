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
from scanloom.stages.scans.model.poses import check_rigid_pose
from scanloom.stages.scans.model.scan import Pose
from scanloom.stages.scans.recordings.messages import CameraMessage, read_text
from scanloom.stages.scans.recordings.realsense.stream_selection import (
    MAX_OPTION_VALUES,
    RealSenseRecording,
    RealSenseStream,
    find_accelerometers,
)
from scanloom.stages.scans.recordings.recording import Recording, TopicMessages
from scanloom.stages.scans.recordings.topic_images import wrap_topic_images

_IMAGE_TOPIC = re.compile(
    r"((/device_\d+/sensor_\d+)/([A-Za-z]+)_\d+)/image/data(/compressed|/compressedDepth)?"
)


def parse_realsense_db3(recording: Recording) -> RealSenseRecording | None:
    """Interpret a `.db3` as a RealSense recording.

    Returns None if it has no RealSense image topics.
    """
    streams = {}
    for name, topic in recording.topics.items():
        matched = _IMAGE_TOPIC.fullmatch(name)
        if matched is not None:
            stream, sensor, kind, _ = matched.groups()
            images = wrap_topic_images(stream, topic, partial(_read_timestamp, recording, stream, topic))
            streams[stream] = RealSenseStream(kind.lower(), sensor, images)
    if not streams:
        return None
    return RealSenseRecording(
        recording.path,
        streams,
        partial(_read_camera, recording),
        partial(_read_depth_units, recording),
        partial(_read_extrinsics, recording),
        find_accelerometers(recording),
    )


def _read_timestamp(recording: Recording, name: str, topic: TopicMessages, number: int) -> int:
    """Return the capture time of an image, nanoseconds.

    The metadata message with the same recording time holds the capture time in milliseconds.
    """
    texts = recording.topics.get(f"{name}/image/metadata")
    at = -1 if texts is None else int(np.searchsorted(texts.record_times_ns, topic.record_times_ns[number]))
    if (
        texts is None
        or at >= len(texts.record_times_ns)
        or texts.record_times_ns[at] != topic.record_times_ns[number]
    ):
        raise InputError(
            RECORDING_DAMAGED,
            "image {number} of {name} has no metadata with its capture time.",
            recording.path,
            number=number,
            name=name,
        )
    fields = _read_fields(recording, texts, at)
    (milliseconds,) = _parse_numbers(fields, "timestamp", 1, recording.path)
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


def _read_camera(recording: Recording, name: str) -> CameraMessage | None:
    topic = recording.topics.get(f"{name}/camera_info")
    if topic is None:
        return None
    path, fields = recording.path, _read_fields(recording, topic, 0)
    width, height, fx, fy, cx, cy = (
        _parse_numbers(fields, key, 1, path)[0] for key in ("width", "height", "fx", "fy", "ppx", "ppy")
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
    distortion = _parse_numbers(fields, "coeffs", 5, path)
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return CameraMessage(
        int(width),
        int(height),
        fields.get("model", ""),
        tuple(distortion),
        matrix,
        np.eye(3),
        np.zeros((3, 4)),
    )


def _read_depth_units(recording: Recording, stream: RealSenseStream) -> list[float]:
    option = recording.topics.get(f"{stream.sensor}/option/Depth_Units/value")
    if option is None:
        return []
    words = [
        _read_string(recording, option, number)
        for number in range(min(len(option.record_times_ns), MAX_OPTION_VALUES))
    ]
    return [_parse_numbers({"Depth_Units": word}, "Depth_Units", 1, recording.path)[0] for word in words]


def _read_extrinsics(recording: Recording, name: str) -> dict[str, Pose]:
    start = f"{name}/tf/"
    found = {}
    for topic in recording.topics:
        if topic.startswith(start):
            fields = _read_fields(recording, recording.topics[topic], 0)
            # librealsense stores rotations column-major.
            rotation = np.reshape(_parse_numbers(fields, "rotation", 9, recording.path), (3, 3)).T
            translation = np.reshape(_parse_numbers(fields, "translation", 3, recording.path), (3, 1))
            pose = check_rigid_pose(np.hstack([rotation, translation]), recording.path, topic)
            assert pose is not None
            found[topic.removeprefix(start)] = pose
    return found


def _read_fields(recording: Recording, topic: TopicMessages, number: int) -> dict[str, str]:
    entries = (entry.partition("=") for entry in _read_string(recording, topic, number).split(";"))
    return {name: value for name, _, value in entries}


def _read_string(recording: Recording, topic: TopicMessages, number: int) -> str:
    return read_text(topic.read(number, None), recording.path)


def _parse_numbers(fields: dict[str, str], key: str, count: int, path: Path) -> list[float]:
    """Parse `count` comma-separated numbers. Raises InputError unless all are finite."""
    try:
        values = [float(word) for word in fields.get(key, "").split(",")]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise InputError(
            RECORDING_DAMAGED,
            "{key} is {said!r}; {count} numbers are expected.",
            path,
            key=key,
            said=fields.get(key, "")[:40],
            count=count,
        )
    return values
