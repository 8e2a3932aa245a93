"""Lazily decoded images of a topic, raw or compressed."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from numpy.typing import NDArray

from scanloom.stages.scans.model.scan import ColorImage
from scanloom.stages.scans.recordings.image_decoding import decode_color_message, decode_depth_message
from scanloom.stages.scans.recordings.messages import STAMP_BYTES, read_stamp
from scanloom.stages.scans.recordings.recording import TopicMessages
from scanloom.stages.scans.streams.timestamped_streams import TimestampedImages


def wrap_topic_images(
    name: str, topic: TopicMessages, stamp: Callable[[int], int] | None = None
) -> TimestampedImages:
    """Wrap a topic as images that are read and decoded on demand.

    Parameters
    ----------
    name : name of the images in messages.
    stamp : return the capture time of an image, nanoseconds; None to use the time in the message header.
    """
    return TimestampedImages(
        name,
        topic.record_times_ns,
        stamp or partial(_read_timestamp, topic),
        partial(_read_color, name, topic),
        partial(_read_depth, name, topic),
        topic.find_file,
    )


def _read_timestamp(topic: TopicMessages, number: int) -> int:
    return read_stamp(topic.read(number, STAMP_BYTES), topic.find_file(number), is_cdr=topic.is_cdr)


def _read_color(name: str, topic: TopicMessages, number: int) -> ColorImage:
    source = f"{topic.find_file(number)}: {name} {number:06d}"
    return decode_color_message(topic.read(number, None), topic.message_type, source, is_cdr=topic.is_cdr)


def _read_depth(name: str, topic: TopicMessages, number: int) -> NDArray[Any]:
    source = f"{topic.find_file(number)}: {name} {number:06d}"
    return decode_depth_message(topic.read(number, None), topic.message_type, source, is_cdr=topic.is_cdr)
