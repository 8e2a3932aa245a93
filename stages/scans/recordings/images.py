"""Lazily decoded images of a topic, raw or compressed."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import ColorImage
from scanloom.stages.scans.recordings.messages import STAMP_BYTES, read_stamp
from scanloom.stages.scans.recordings.pixels import color_in, depth_in
from scanloom.stages.scans.recordings.recording import Messages
from scanloom.stages.scans.streams.clocked_streams import Images


def topic_images(name: str, topic: Messages, stamp: Callable[[int], int] | None = None) -> Images:
    """Wrap a topic as images that are read and decoded on demand.

    Parameters
    ----------
    name : name of the images in messages.
    stamp : return the capture time of an image, nanoseconds; None to use the time in the message header.
    """
    return Images(
        name,
        topic.times,
        stamp or partial(_stamp, topic),
        partial(_color, name, topic),
        partial(_depth, name, topic),
        topic.file,
    )


def _stamp(topic: Messages, number: int) -> int:
    return read_stamp(topic.read(number, STAMP_BYTES), topic.file(number), is_cdr=topic.is_cdr)


def _color(name: str, topic: Messages, number: int) -> ColorImage:
    source = f"{topic.file(number)}: {name} {number:06d}"
    return color_in(topic.read(number, None), topic.kind, source, is_cdr=topic.is_cdr)


def _depth(name: str, topic: Messages, number: int) -> NDArray[Any]:
    source = f"{topic.file(number)}: {name} {number:06d}"
    return depth_in(topic.read(number, None), topic.kind, source, is_cdr=topic.is_cdr)
