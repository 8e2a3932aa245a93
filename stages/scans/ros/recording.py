"""The messages of a ROS recording, by topic, whichever kind of file holds them: a bag, a `.db3`, an MCAP."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stages.scans.ros.bag import RosBag, Topic, read_message
from stages.scans.ros.db3 import Db3, read_row
from stages.scans.ros.mcap import Mcap, McapTopic, read_mcap_message

# How MCAP files call ROS's two ways to serialise, and whether it is ROS 2's.
_ENCODINGS = {"cdr": True, "ros1": False}


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
class RosRecording:
    """The topics of a recording, by name; each has messages.

    Attributes
    ----------
    path : what messages call the recording: its file, or its folder.
    fault : why a part of it could not be read, or None.
    """

    path: Path
    topics: Mapping[str, Messages]
    fault: str | None


def of_bag(bag: RosBag) -> RosRecording:
    """Return what a ROS 1 bag holds."""

    def read(topic: Topic, number: int, first: int | None) -> bytes:
        return read_message(bag, topic, number, first=first)

    topics = {
        name: Messages(topic.kind, topic.times, False, partial(read, topic), lambda _: bag.path)
        for name, topic in bag.topics.items()
    }
    return RosRecording(bag.path, topics, bag.fault)


def of_db3(db3: Db3) -> RosRecording:
    """Return what a `.db3` of ROS 2 holds."""

    def read(rows: NDArray[np.int64], number: int, first: int | None) -> bytes:
        return read_row(db3, int(rows[number]))[:first]

    topics = {
        name: Messages(
            _as_ros_1(topic.kind), topic.times, True, partial(read, topic.rows), lambda _: db3.path
        )
        for name, topic in db3.topics.items()
    }
    return RosRecording(db3.path, topics, None)


def of_mcap(mcap: Mcap) -> RosRecording:
    """Return what an MCAP file holds; messages of another encoding have a type that nothing knows."""

    def read(topic: McapTopic, number: int, first: int | None) -> bytes:
        return read_mcap_message(mcap, topic, number, first=first)

    topics = {
        name: Messages(
            _as_ros_1(topic.kind) if topic.encoding in _ENCODINGS else f"{topic.kind} as {topic.encoding}",
            topic.times,
            _ENCODINGS.get(topic.encoding, False),
            partial(read, topic),
            lambda _: mcap.path,
        )
        for name, topic in mcap.topics.items()
    }
    return RosRecording(mcap.path, topics, mcap.fault)


def joined(path: Path, parts: Sequence[RosRecording]) -> RosRecording:
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
    return RosRecording(path, topics, fault)


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


def _as_ros_1(kind: str) -> str:
    return kind.replace("/msg/", "/")
