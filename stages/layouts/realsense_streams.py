"""Which streams a RealSense recording holds, and how its cameras stand: all of it is in the file.

Topics are `/device_0/sensor_0/Depth_0/…`: `image/data`, `info/camera_info` and `tf/0`, which takes points of
a reference stream to this one; of a sensor `option/Depth_Units/value`, in metres.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from stages.errors import InputError
from stages.formats import calibration
from stages.formats.ros_bag import RosBag, Topic, read_message
from stages.formats.ros_messages import read_camera_info, read_float, read_image, read_transform
from stages.formats.trajectories import inverted
from stages.layouts.streams import Stream, Streams, stated_depth_camera, unknown_place
from stages.scan import Camera, Pose

if TYPE_CHECKING:
    from stages.layouts.params import ScanParams

_IMAGES = re.compile(r"(/device_\d+/sensor_\d+)/([A-Za-z]+)_(\d+)/image/data")
# Whatever the name says, the maker's own library projects all three like this, to thousandths of a pixel.
_LIKE_OPENCV = ("brown conrady", "inverse brown conrady", "modified brown conrady", "plumb_bob")
# Millimetres are by far the most frequent, but not what every model records.
_USUAL_UNITS = 0.001
# Metres; a unit of less than a nanometre or more than a kilometre is damaged.
_UNITS = (1e-9, 1e3)


def realsense_streams(bag: RosBag, options: ScanParams) -> Streams | None:
    """Return the streams of a RealSense recording; None if the bag has none of its topics.

    Raises
    ------
    InputError
        If it holds no depth, or what it says of its cameras is missing or wrong.
    """
    found: dict[str, list[tuple[str, str, Topic]]] = {}
    for name, topic in sorted(bag.topics.items()):
        matched = _IMAGES.fullmatch(name)
        if matched is not None:
            found.setdefault(matched[2].lower(), []).append((matched[1], name[: -len("/image/data")], topic))
    if not found:
        return None
    if "depth" not in found:
        raise InputError(_without_depth(found), bag.path)
    (sensor, name, topic), *_ = found["depth"]
    camera = stated_depth_camera(bag, name, topic, options) or _recorded_camera(bag, name)
    depth = Stream(name, topic, camera)
    scale, warnings = _depth_scale(bag, sensor, topic, options)
    # The left infrared camera is the one that depth is seen from.
    grey = [one for one in found.get("infrared", ()) if one[0] == sensor]
    chosen = next(iter((*found.get("color", ()), *grey)), None)
    if chosen is None:
        return Streams(depth, None, scale, None, tuple(warnings))
    _, name, topic = chosen
    color = Stream(name, topic, _recorded_camera(bag, name))
    color_from_depth = _between(bag, depth.name, color.name)
    if color_from_depth is None:
        warnings.append(unknown_place(depth.name, color.name))
    if "color" not in found:
        warnings.append("there is no colour stream: the infrared camera's images stand for it")
    return Streams(depth, color, scale, color_from_depth, tuple(warnings))


def _without_depth(found: dict[str, list[tuple[str, str, Topic]]]) -> str:
    streams = ", ".join(name for places in found.values() for _, name, _ in places)
    if len(found.get("infrared", ())) > 1:
        return (
            f"the recording holds no depth, only {streams}, and its infrared pairs cannot be read yet. "
            "Record the depth stream too, or extract the pairs into left/ and right/ with a calibration."
        )
    return f"the recording holds no depth, only {streams}. Record the depth stream too."


def _recorded_camera(bag: RosBag, name: str) -> Camera:
    """Return the camera of a stream as the recording states it."""
    info = bag.topics.get(f"{name}/info/camera_info")
    if info is None:
        raise InputError(
            f"the recording does not say what camera {name} is of (no camera_info); set "
            "scan.intrinsics=fx,fy,cx,cy.",
            bag.path,
        )
    message = read_camera_info(read_message(bag, info, 0), f"{bag.path}: {name}")
    distortion = message.distortion[:5] if any(message.distortion) else ()
    if distortion and message.model.lower() not in _LIKE_OPENCV:
        raise InputError(
            f"the lens of {name} is described as {message.model[:40]!r}, which is not known; Brown-Conrady's "
            "models are.",
            bag.path,
        )
    return calibration.matrix_camera(message.matrix, distortion, message.width, message.height, bag.path)


def _depth_scale(bag: RosBag, sensor: str, depth: Topic, options: ScanParams) -> tuple[float, list[str]]:
    """Return the depth units a metre: as stated, as the sensor's option says, or each image."""
    if options.depth_scale is not None:
        return options.depth_scale, []
    # Older recorders leave the blank in the option's name.
    names = (f"{sensor}/option/Depth_Units/value", f"{sensor}/option/Depth Units/value")
    option = next((bag.topics[name] for name in names if name in bag.topics), None)
    if option is not None:
        values = {read_float(read_message(bag, option, n), bag.path) for n in range(min(len(option), 100))}
        units = read_float(read_message(bag, option, len(option) - 1), bag.path)
    else:
        image = read_image(read_message(bag, depth, 0), bag.path)
        units = read_float(image.rest, bag.path) if len(image.rest) == 4 else 0.0
        values = {units}
    warnings = []
    if not units:
        units = _USUAL_UNITS
        warnings.append(
            "the recording does not say its depth unit: millimetres are assumed; scan.depth_scale=VALUE "
            "states how many units are one metre"
        )
    elif len(values) > 1:
        warnings.append(
            f"the depth unit changes within the recording; the last, {units:g} m, is used for all of it. "
            "scan.depth_scale=VALUE states another, in units a metre"
        )
    if not _UNITS[0] <= units <= _UNITS[1]:
        raise InputError(
            f"its depth unit is {units:g} m, which cannot be right; scan.depth_scale=VALUE states how many "
            "units are one metre.",
            bag.path,
        )
    return 1 / units, warnings


def _between(bag: RosBag, depth: str, color: str) -> Pose | None:
    """Return color_from_depth, by the reference that both streams state their place to; None without one."""
    for name in sorted(bag.topics):
        if not name.startswith(f"{depth}/tf/"):
            continue
        other = bag.topics.get(f"{color}/tf/{name.rpartition('/')[2]}")
        if other is not None:
            color_from_reference, depth_from_reference = (
                read_transform(read_message(bag, topic, 0), bag.path) for topic in (other, bag.topics[name])
            )
            return np.asarray(color_from_reference @ inverted(depth_from_reference))
    return None
