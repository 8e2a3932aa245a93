"""Take serialised ROS messages apart: images, cameras, transforms; little-endian.

ROS 1 packs fields without padding; ROS 2 (CDR) aligns each to its size, and has no number in the header.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError
from stages.scans.formats import trajectories
from stages.scans.scan import Pose

IMAGE, COMPRESSED_IMAGE = "sensor_msgs/Image", "sensor_msgs/CompressedImage"


@dataclass(frozen=True, eq=False)
class ImageMessage:
    """`sensor_msgs/Image`.

    Attributes
    ----------
    stamp : nanoseconds, when the image was taken.
    width, height : pixels.
    encoding : what a pixel is, by ROS's names.
    is_big_endian : of 16-bit and float pixels.
    step : bytes from row to row.
    data : the rows.
    rest : bytes after them; RealSense's recorder adds the depth unit as a float32.
    """

    stamp: int
    width: int
    height: int
    encoding: str
    is_big_endian: bool
    step: int
    data: memoryview
    rest: bytes


@dataclass(frozen=True, eq=False)
class CameraMessage:
    """`sensor_msgs/CameraInfo`.

    Attributes
    ----------
    width, height : pixels.
    model : of the distortion.
    distortion : its coefficients.
    matrix : (3, 3) float64, for the image as it was taken.
    rectification : (3, 3) float64, turns the camera to where rectified images are seen from.
    projection : (3, 4) float64, for the rectified image.
    """

    width: int
    height: int
    model: str
    distortion: tuple[float, ...]
    matrix: NDArray[np.float64]
    rectification: NDArray[np.float64]
    projection: NDArray[np.float64]


class _Fields:
    """The fields of a message, one after the other."""

    def __init__(self, data: bytes) -> None:
        self._data = memoryview(data)
        self._at = 0

    def numbers(self, layout: str) -> tuple[Any, ...]:
        """Return numbers as `struct` names their types, without padding."""
        values = struct.unpack_from("<" + layout, self._data, self._at)
        self._at += struct.calcsize("<" + layout)
        return values

    def block(self) -> memoryview:
        """Return bytes that their number stands before."""
        (size,) = self.numbers("I")
        if self._at + size > len(self._data):
            raise ValueError("more bytes than there are")
        block = self._data[self._at : self._at + size]
        self._at += size
        return block

    def text(self) -> str:
        return bytes(self.block()).decode("utf-8", "replace")

    def rest(self) -> bytes:
        return bytes(self._data[self._at :])

    def header(self) -> tuple[int, str]:
        """Return time, nanoseconds, and frame of a message's header."""
        _, seconds, nanoseconds = self.numbers("III")
        return int(seconds) * 1_000_000_000 + int(nanoseconds), self.text()


class _CdrFields(_Fields):
    """The fields of a ROS 2 message; those of `numbers` have to be of one size."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        # Four bytes say how what follows is packed: the second is 1 for little-endian.
        if data[1:2] != b"\1":
            raise ValueError("not little-endian")
        self._at = 4

    def numbers(self, layout: str) -> tuple[Any, ...]:
        self._at += (4 - self._at) % struct.calcsize("<" + layout[-1])
        return super().numbers(layout)

    def text(self) -> str:
        return super().text().removesuffix("\0")

    def header(self) -> tuple[int, str]:
        seconds, nanoseconds = self.numbers("iI")
        return int(seconds) * 1_000_000_000 + int(nanoseconds), self.text()


def _fields(data: bytes, is_cdr: bool) -> _Fields:
    return _CdrFields(data) if is_cdr else _Fields(data)


# What the time in the header of an image takes, ROS 1's or 2's: it is read alone where only it is wanted.
STAMP_BYTES = 12


def read_stamp(data: bytes, source: Path | str, *, is_cdr: bool = False) -> int:
    """Return when an image was taken, nanoseconds, from the first bytes of its message."""
    try:
        _, seconds, nanoseconds = struct.unpack_from("<IiI" if is_cdr else "<III", data)
    except struct.error as error:
        raise InputError("the message is cut short.", source) from error
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def read_image(data: bytes, source: Path | str, *, is_cdr: bool = False) -> ImageMessage:
    """Return an image, its pixels still packed; `source` stands in messages, `is_cdr` says it is ROS 2's.

    Raises
    ------
    InputError
        If the message is cut short.
    """
    try:
        fields = _fields(data, is_cdr)
        stamp, _ = fields.header()
        height, width = fields.numbers("II")
        encoding = fields.text()
        (is_big_endian,), (step,) = fields.numbers("B"), fields.numbers("I")
        return ImageMessage(
            stamp, width, height, encoding, bool(is_big_endian), step, fields.block(), fields.rest()
        )
    except (struct.error, ValueError) as error:
        raise InputError("the image is cut short or damaged.", source) from error


def read_camera_info(data: bytes, source: Path | str, *, is_cdr: bool = False) -> CameraMessage:
    """Return a camera; its numbers are not checked. Raises InputError if the message is cut short."""
    try:
        fields = _fields(data, is_cdr)
        fields.header()
        height, width = fields.numbers("II")
        model = fields.text()
        (count,) = fields.numbers("I")
        distortion = fields.numbers(f"{min(count, len(data))}d")
        matrix, turn, projection = (np.reshape(fields.numbers(f"{n}d"), (3, -1)) for n in (9, 9, 12))
        return CameraMessage(width, height, model, distortion, matrix, turn, projection)
    except (struct.error, ValueError) as error:
        raise InputError("the camera_info is cut short or damaged.", source) from error


def read_compressed(data: bytes, source: Path | str, *, is_cdr: bool = False) -> tuple[str, bytes]:
    """Return format and encoded image of `sensor_msgs/CompressedImage`; InputError if it is cut short."""
    try:
        fields = _fields(data, is_cdr)
        fields.header()
        return fields.text(), bytes(fields.block())
    except (struct.error, ValueError) as error:
        raise InputError("the image is cut short or damaged.", source) from error


def read_text(data: bytes, source: Path | str) -> str:
    """Return a ROS 2 `std_msgs/String`; InputError if it is cut short."""
    try:
        return _CdrFields(data).text()
    except (struct.error, ValueError) as error:
        raise InputError("a text is cut short or damaged.", source) from error


def read_frame(data: bytes, source: Path | str, *, is_cdr: bool = False) -> str:
    """Return the name of the frame in a message's header; InputError if it is cut short."""
    try:
        return _fields(data, is_cdr).header()[1]
    except (struct.error, ValueError) as error:
        raise InputError("the message is cut short.", source) from error


def read_transform(data: bytes, source: Path) -> Pose:
    """Return `geometry_msgs/Transform` as a (4, 4) float64 matrix, metres.

    Raises
    ------
    InputError
        If the message is cut short, or it is no rigid motion.
    """
    try:
        return _pose(_Fields(data), source)
    except struct.error as error:
        raise InputError("a transform is cut short.", source) from error


def read_transforms(data: bytes, source: Path, *, is_cdr: bool = False) -> list[tuple[str, str, Pose]]:
    """Return `tf2_msgs/TFMessage`: parent, child, and the (4, 4) matrix that takes points of child to parent.

    Raises
    ------
    InputError
        As `read_transform`.
    """
    transforms = []
    try:
        fields = _fields(data, is_cdr)
        (count,) = fields.numbers("I")
        for _ in range(count):
            _, parent = fields.header()
            child = fields.text()
            transforms.append((parent, child, _pose(fields, source)))
    except (struct.error, ValueError) as error:
        raise InputError("a transform is cut short.", source) from error
    return transforms


def _pose(fields: _Fields, source: Path) -> Pose:
    values = fields.numbers("7d")
    pose = trajectories.pose_from_quaternion(values[:3], values[3:], source, "a transform")
    if pose is None:
        raise InputError("a transform is not finite.", source)
    return pose


def read_float(data: bytes, source: Path | str) -> float:
    """Return `std_msgs/Float32` as the decimal number it was written as. Raises InputError if cut short."""
    if len(data) < 4:
        raise InputError("a number is cut short.", source)
    # 0.001 in single precision is 0.0010000000474974513, which nobody meant.
    return float(str(np.frombuffer(data, "<f4", 1)[0]))
