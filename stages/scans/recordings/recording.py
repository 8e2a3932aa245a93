"""The messages of a recording, by topic, whichever kind of file holds them: a bag, a `.db3`, an MCAP."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import zstd_blocks
from scanloom.stages.files.codes import RECORDING_DAMAGED

# No camera makes a larger image.
LARGEST_MESSAGE = 1 << 28


@dataclass(frozen=True, eq=False)
class Messages:
    """The messages of a topic.

    Attributes
    ----------
    kind : the message type as ROS 1 calls it, such as `sensor_msgs/Image`.
    times : (n,) int64 nanoseconds at which they were recorded.
    is_cdr : they are serialised as ROS 2 does.
    read : returns the bytes of the n-th, or only the first so many; raises InputError where it is damaged.
    file : returns which file the n-th is in.
    """

    kind: str
    times: NDArray[np.int64]
    is_cdr: bool
    read: Callable[[int, int | None], bytes]
    file: Callable[[int], Path]


@dataclass(frozen=True, eq=False)
class Recording:
    """The topics of a recording, by name; each has messages.

    Attributes
    ----------
    path : what messages call the recording: its file, or its folder.
    fault : why a part of it could not be read, or None.
    """

    path: Path
    topics: Mapping[str, Messages]
    fault: str | None


def as_ros_1(kind: str) -> str:
    """Return a message type as ROS 1 calls it: without what ROS 2 puts in its middle."""
    return kind.replace("/msg/", "/")


def unpacked(message: bytes, called: str, path: Path) -> bytes:
    """Return a message of ROS 2, which it and some of RealSense's recorders can pack each for itself.

    `called` is what the error calls it.

    Raises
    ------
    InputError
        If it is packed and damaged.
    """
    if not message.startswith(zstd_blocks.MAGIC):
        return message
    try:
        return zstd_blocks.unpacked(message, LARGEST_MESSAGE)
    except ValueError as error:
        raise InputError(
            RECORDING_DAMAGED, "{called} does not decompress; it is damaged.", path, called=called
        ) from error


def joined(path: Path, parts: Sequence[Recording]) -> Recording:
    """Return one recording of several files that a recorder wrote one after the other."""
    kinds: dict[str, tuple[str, bool]] = {}
    for part in parts:
        for name, topic in part.topics.items():
            kinds.setdefault(name, (topic.kind, topic.is_cdr))
    topics = {}
    for name, kind in kinds.items():
        found = (part.topics.get(name) for part in parts)
        topics[name] = _joined_messages(
            [one for one in found if one is not None and (one.kind, one.is_cdr) == kind]
        )
    fault = next((part.fault for part in parts if part.fault is not None), None)
    return Recording(path, topics, fault)


def _joined_messages(parts: Sequence[Messages]) -> Messages:
    ends = np.cumsum([len(part.times) for part in parts])

    def place(number: int) -> tuple[Messages, int]:
        at = int(np.searchsorted(ends, number, side="right"))
        return parts[at], number - int(ends[at]) + len(parts[at].times)

    def read(number: int, first: int | None) -> bytes:
        part, own = place(number)
        return part.read(own, first)

    def file(number: int) -> Path:
        part, own = place(number)
        return part.file(own)

    times = np.concatenate([part.times for part in parts])
    return Messages(parts[0].kind, times, parts[0].is_cdr, read, file)
