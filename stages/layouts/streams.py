"""The two streams of a recording that make up a scan, whoever recorded it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from stages.formats.ros_bag import RosBag, Topic, read_message
from stages.formats.ros_messages import COMPRESSED_IMAGE, read_compressed, read_image
from stages.formats.ros_pixels import color_of, compressed_color, compressed_depth, depth_of
from stages.layouts.stated import stated_camera
from stages.scan import Camera, ColorImage, Pose

if TYPE_CHECKING:
    from stages.layouts.params import ScanParams


@dataclass(frozen=True, eq=False)
class Stream:
    """The images of one camera of a recording."""

    name: str
    topic: Topic
    camera: Camera


@dataclass(frozen=True, eq=False)
class Streams:
    """The streams of a recording that make up a scan.

    Attributes
    ----------
    depth, color : colour may show what an infrared camera saw, or be None.
    depth_scale : what one metre is in the depth maps' units.
    color_from_depth : (4, 4) float64, metres; None where both stand in one place or the file does not say.
    warnings : in plain sentences.
    """

    depth: Stream
    color: Stream | None
    depth_scale: float
    color_from_depth: Pose | None
    warnings: tuple[str, ...]


def unknown_place(depth: str, color: str) -> str:
    """Return the warning for cameras that nothing in the recording relates."""
    return (
        f"how the camera of {color} stands to that of {depth} is not in the file: both are taken to stand in "
        "one place, so that colours may be displaced"
    )


def load_color(bag: RosBag, topic: Topic, number: int, source: str) -> ColorImage:
    """Return an image of a topic, (h, w, 3) uint8 RGB; InputError if damaged. `source` stands in messages."""
    data = read_message(bag, topic, number)
    if topic.kind == COMPRESSED_IMAGE:
        return compressed_color(read_compressed(data, source), source)
    return color_of(read_image(data, source), source)


def load_depth(bag: RosBag, topic: Topic, number: int, source: str) -> NDArray[Any]:
    """Return a depth map of a topic as stored, (h, w) uint16 or float32; InputError if damaged."""
    data = read_message(bag, topic, number)
    if topic.kind == COMPRESSED_IMAGE:
        return compressed_depth(read_compressed(data, source), source)
    return depth_of(read_image(data, source), source)


def stated_depth_camera(bag: RosBag, name: str, topic: Topic, options: ScanParams) -> Camera | None:
    """Return the depth camera that the person states, for the size of the first depth map; None if not."""
    if options.intrinsics is None and options.calibration is None:
        return None
    height, width = load_depth(bag, topic, 0, f"{bag.path}: {name}").shape
    return stated_camera(options, bag.path.parent, width, height)
