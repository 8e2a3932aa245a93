"""The images of a topic of a ROS 1 bag, plain or compressed."""

from __future__ import annotations

from functools import partial
from typing import Any

from numpy.typing import NDArray

from stages.formats.ros_bag import RosBag, Topic, read_message
from stages.formats.ros_messages import STAMP_BYTES, read_stamp
from stages.formats.ros_pixels import color_in, depth_in
from stages.layouts.streams import Images
from stages.scan import ColorImage


def bag_images(bag: RosBag, name: str, topic: Topic) -> Images:
    """Return the images of a topic, to be read when asked for."""
    return Images(
        name,
        topic.times,
        partial(_stamp, bag, topic),
        partial(_color, bag, name, topic),
        partial(_depth, bag, name, topic),
    )


def _stamp(bag: RosBag, topic: Topic, number: int) -> int:
    return read_stamp(read_message(bag, topic, number, first=STAMP_BYTES), bag.path)


def _color(bag: RosBag, name: str, topic: Topic, number: int) -> ColorImage:
    return color_in(read_message(bag, topic, number), topic.kind, f"{bag.path}: {name} {number:06d}")


def _depth(bag: RosBag, name: str, topic: Topic, number: int) -> NDArray[Any]:
    return depth_in(read_message(bag, topic, number), topic.kind, f"{bag.path}: {name} {number:06d}")
