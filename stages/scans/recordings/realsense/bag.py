"""RealSense `.bag` files, which librealsense wrote up to version 2.57.

Topics of a stream are below `/device_0/sensor_0/Depth_0/`: `image/data`, `info/camera_info` and `tf/0`,
the transform from a reference stream to this stream. `option/Depth_Units/value` of the sensor is in
metres.
"""

from __future__ import annotations

import re
from functools import partial

from scanloom.stages.scans.model.scan import Pose
from scanloom.stages.scans.recordings.messages import (
    CameraMessage,
    read_camera_info,
    read_float,
    read_image,
    read_transform,
)
from scanloom.stages.scans.recordings.realsense.stream_selection import (
    MAX_OPTION_VALUES,
    RealSenseRecording,
    RealSenseStream,
    find_accelerometers,
)
from scanloom.stages.scans.recordings.recording import Recording
from scanloom.stages.scans.recordings.topic_images import wrap_topic_images

_IMAGE_TOPIC = re.compile(r"((/device_\d+/sensor_\d+)/([A-Za-z]+)_\d+)/image/data")


def parse_realsense_bag(bag: Recording) -> RealSenseRecording | None:
    """Interpret a bag as a RealSense recording.

    Returns None if it has no RealSense image topics.
    """
    streams = {}
    for name, topic in bag.topics.items():
        matched = _IMAGE_TOPIC.fullmatch(name)
        if matched is not None:
            stream, sensor, kind = matched.groups()
            streams[stream] = RealSenseStream(kind.lower(), sensor, wrap_topic_images(stream, topic))
    if not streams:
        return None
    return RealSenseRecording(
        bag.path,
        streams,
        partial(_read_camera, bag),
        partial(_read_depth_units, bag),
        partial(_read_extrinsics, bag),
        find_accelerometers(bag),
    )


def _read_camera(bag: Recording, name: str) -> CameraMessage | None:
    info = bag.topics.get(f"{name}/info/camera_info")
    return None if info is None else read_camera_info(info.read(0, None), f"{bag.path}: {name}")


def _read_depth_units(bag: Recording, stream: RealSenseStream) -> list[float]:
    # Older recorders keep the space in the name of the option.
    names = (f"{stream.sensor}/option/{option}/value" for option in ("Depth_Units", "Depth Units"))
    option = next((bag.topics[name] for name in names if name in bag.topics), None)
    if option is not None:
        return [
            read_float(option.read(number, None), bag.path)
            for number in range(min(len(option.record_times_ns), MAX_OPTION_VALUES))
        ]
    image = read_image(bag.topics[f"{stream.images.name}/image/data"].read(0, None), bag.path)
    return [read_float(image.trailing_bytes, bag.path)] if len(image.trailing_bytes) == 4 else []


def _read_extrinsics(bag: Recording, name: str) -> dict[str, Pose]:
    start = f"{name}/tf/"
    return {
        topic.removeprefix(start): read_transform(bag.topics[topic].read(0, None), bag.path)
        for topic in bag.topics
        if topic.startswith(start)
    }
