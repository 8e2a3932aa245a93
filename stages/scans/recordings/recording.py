"""Messages of a recording by topic, independent of the container format."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import zstd_blocks
from scanloom.stages.files.codes import RECORDING_DAMAGED

# Bytes. No camera image is larger.
MAX_MESSAGE_BYTES = 1 << 28


@dataclass(frozen=True, eq=False)
class TopicMessages:
    """Messages of one topic.

    Attributes
    ----------
    message_type : message type as ROS 1 names it, such as `sensor_msgs/Image`.
    record_times_ns : (n,) int64 recording times, nanoseconds.
    is_cdr : True if the messages are serialised as CDR (ROS 2).
    read : return the bytes of message `i`, or its first `n` bytes; raises InputError if it is damaged.
    find_file : return the file that contains message `i`.
    """

    message_type: str
    record_times_ns: NDArray[np.int64]
    is_cdr: bool
    read: Callable[[int, int | None], bytes]
    find_file: Callable[[int], Path]


@dataclass(frozen=True, eq=False)
class Recording:
    """Topics of a recording.

    Attributes
    ----------
    path : file or folder of the recording, for messages.
    topics : messages by topic name.
    fault : reason why part of the recording could not be read, or None.
    """

    path: Path
    topics: Mapping[str, TopicMessages]
    fault: str | None


def to_ros_1_type(kind: str) -> str:
    """Convert a ROS 2 message type to its ROS 1 name.

    `sensor_msgs/msg/Image` becomes `sensor_msgs/Image`.
    """
    return kind.replace("/msg/", "/")


def decompress_message(message: bytes, label: str, path: Path) -> bytes:
    """Decompress a message that is compressed individually.

    ROS 2 and some RealSense recorders do so. Uncompressed messages are returned unchanged.

    Parameters
    ----------
    label : name of the message in the error.

    Raises
    ------
    InputError
        If a compressed message is damaged.
    """
    if not message.startswith(zstd_blocks.ZSTD_MAGIC):
        return message
    try:
        return zstd_blocks.decompress_zstd(message, MAX_MESSAGE_BYTES)
    except ValueError as error:
        raise InputError(
            RECORDING_DAMAGED, "{called} does not decompress: the message is damaged.", path, called=label
        ) from error


def join_recordings(path: Path, parts: Sequence[Recording]) -> Recording:
    """Concatenate the files of a recording that was split by the recorder.

    Parameters
    ----------
    path : folder of the recording, for messages.
    parts : files in recording order.
    """
    kinds: dict[str, tuple[str, bool]] = {}
    for part in parts:
        for name, topic in part.topics.items():
            kinds.setdefault(name, (topic.message_type, topic.is_cdr))
    topics = {}
    for name, kind in kinds.items():
        found = (part.topics.get(name) for part in parts)
        topics[name] = _join_messages(
            [one for one in found if one is not None and (one.message_type, one.is_cdr) == kind]
        )
    fault = next((part.fault for part in parts if part.fault is not None), None)
    return Recording(path, topics, fault)


def _join_messages(parts: Sequence[TopicMessages]) -> TopicMessages:
    ends = np.cumsum([len(part.record_times_ns) for part in parts])

    def locate_message(number: int) -> tuple[TopicMessages, int]:
        at = int(np.searchsorted(ends, number, side="right"))
        return parts[at], number - int(ends[at]) + len(parts[at].record_times_ns)

    def read(number: int, first: int | None) -> bytes:
        part, own = locate_message(number)
        return part.read(own, first)

    def find_file(number: int) -> Path:
        part, own = locate_message(number)
        return part.find_file(own)

    times = np.concatenate([part.record_times_ns for part in parts])
    return TopicMessages(parts[0].message_type, times, parts[0].is_cdr, read, find_file)
