"""Take serialised messages apart: images, cameras, transforms.

`rosbags` knows how ROS 1 and 2 serialise and what their messages consist of. No number in a message makes it
read or reserve more than is there: so it was with 120,000 that were cut or changed. Its types are asked one
level below its own `deserialize` functions, which refuse what RealSense's recorder writes behind an image.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import RECORDING_DAMAGED
from scanloom.stages.scans.model.poses import pose_from_quaternion
from scanloom.stages.scans.model.scan import Pose

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

IMAGE, COMPRESSED_IMAGE = "sensor_msgs/Image", "sensor_msgs/CompressedImage"
IMU = "sensor_msgs/Imu"
# Before a ROS 2 message four bytes say how it is packed: the second is 1 for little-endian.
_CDR_HEAD = 4


@dataclass(frozen=True, eq=False)
class ImageMessage:
    """`sensor_msgs/Image`.

    Attributes
    ----------
    width, height : pixels.
    encoding : what a pixel is, by ROS's names.
    is_big_endian : of 16-bit and float pixels.
    step : bytes from row to row.
    data : (n,) uint8, the rows.
    rest : bytes after them; RealSense's recorder adds the depth unit as a float32.
    """

    width: int
    height: int
    encoding: str
    is_big_endian: bool
    step: int
    data: NDArray[np.uint8]
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


@cache
def _types(is_cdr: bool) -> Typestore:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if is_cdr:
        return get_typestore(Stores.ROS2_HUMBLE)
    types = get_typestore(Stores.ROS1_NOETIC)
    types.register(
        get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
    )
    return types


def _message(
    data: bytes, kind: str, source: Path | str, called: str, *, is_cdr: bool = False
) -> tuple[Any, bytes]:
    """Return a message, and what stands behind it; `called` is what the error calls it.

    Raises
    ------
    InputError
        If it is cut short or damaged, or packed in another way.
    """
    from rosbags.serde import SerdeError

    types = _types(is_cdr)
    known = types.get_msgdef(kind.replace("/", "/msg/"))
    try:
        if not is_cdr:
            message, end = known.deserialize_ros1(data, 0, known.cls, types)
            return message, data[end:]
        if data[1:2] != b"\1":
            raise ValueError("not little-endian")
        message, end = known.deserialize_cdr_le(memoryview(data)[_CDR_HEAD:], 0, known.cls, types)
        return message, data[_CDR_HEAD + end :]
    except (SerdeError, struct.error, ValueError) as error:
        raise InputError(
            RECORDING_DAMAGED, "{called} is cut short or damaged.", source, called=called
        ) from error


# What the time in the header of an image takes, ROS 1's or 2's: it is read alone where only it is wanted.
STAMP_BYTES = 12


def read_stamp(data: bytes, source: Path | str, *, is_cdr: bool = False) -> int:
    """Return when an image was taken, nanoseconds, from the first bytes of its message."""
    try:
        _, seconds, nanoseconds = struct.unpack_from("<IiI" if is_cdr else "<III", data)
    except struct.error as error:
        raise InputError(RECORDING_DAMAGED, "the message is cut short.", source) from error
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def read_image(data: bytes, source: Path | str, *, is_cdr: bool = False) -> ImageMessage:
    """Return an image, its pixels still packed; `source` stands in messages, `is_cdr` says it is ROS 2's.

    Raises
    ------
    InputError
        If the message is cut short.
    """
    said, rest = _message(data, IMAGE, source, "the image", is_cdr=is_cdr)
    return ImageMessage(
        said.width, said.height, said.encoding, bool(said.is_bigendian), said.step, said.data, rest
    )


def read_camera_info(data: bytes, source: Path | str, *, is_cdr: bool = False) -> CameraMessage:
    """Return a camera; its numbers are not checked. Raises InputError if the message is cut short."""
    said, _ = _message(data, "sensor_msgs/CameraInfo", source, "the camera_info", is_cdr=is_cdr)
    # ROS 1 calls them D, K, R and P.
    distortion, *matrices = (getattr(said, name if is_cdr else name.upper()) for name in "dkrp")
    matrix, turn, projection = (np.reshape(values, (3, -1)) for values in matrices)
    return CameraMessage(
        said.width,
        said.height,
        said.distortion_model,
        tuple(distortion.tolist()),
        matrix,
        turn,
        projection,
    )


def read_compressed(data: bytes, source: Path | str, *, is_cdr: bool = False) -> tuple[str, bytes]:
    """Return format and encoded image of `sensor_msgs/CompressedImage`; InputError if it is cut short."""
    said, _ = _message(data, COMPRESSED_IMAGE, source, "the image", is_cdr=is_cdr)
    return said.format, said.data.tobytes()


def read_text(data: bytes, source: Path | str) -> str:
    """Return a ROS 2 `std_msgs/String`; InputError if it is cut short."""
    said, _ = _message(data, "std_msgs/String", source, "a text", is_cdr=True)
    return str(said.data)


def read_frame(data: bytes, source: Path | str, *, is_cdr: bool = False) -> str:
    """Return the name of the frame in a message's header; InputError if it is cut short."""
    said, _ = _message(data, "std_msgs/Header", source, "the message", is_cdr=is_cdr)
    return str(said.frame_id)


def read_transform(data: bytes, source: Path) -> Pose:
    """Return ROS 1's `geometry_msgs/Transform` as a (4, 4) float64 matrix, metres.

    Raises
    ------
    InputError
        If the message is cut short, or it is no rigid motion.
    """
    return _pose(_message(data, "geometry_msgs/Transform", source, "a transform")[0], source)


def read_transforms(data: bytes, source: Path, *, is_cdr: bool = False) -> list[tuple[str, str, Pose]]:
    """Return `tf2_msgs/TFMessage`: parent, child, and the (4, 4) matrix that takes points of child to parent.

    Raises
    ------
    InputError
        As `read_transform`.
    """
    said, _ = _message(data, "tf2_msgs/TFMessage", source, "a transform", is_cdr=is_cdr)
    return [
        (one.header.frame_id, one.child_frame_id, _pose(one.transform, source)) for one in said.transforms
    ]


def _pose(said: Any, source: Path) -> Pose:
    place = [getattr(said.translation, axis) for axis in "xyz"]
    turn = [getattr(said.rotation, axis) for axis in "xyzw"]
    pose = pose_from_quaternion(place, turn, source, "a transform")
    if pose is None:
        raise InputError(RECORDING_DAMAGED, "a transform is not finite.", source)
    return pose


def read_acceleration(data: bytes, source: Path | str, *, is_cdr: bool = False) -> NDArray[np.float64]:
    """Return what the accelerometer of `sensor_msgs/Imu` reads, (3,) m/s²; NaN where the unit has none.

    Raises
    ------
    InputError
        If the message is cut short.
    """
    said, _ = _message(data, IMU, source, "a reading", is_cdr=is_cdr)
    # What a unit does not measure has a variance of -1.
    if said.linear_acceleration_covariance[0] == -1:
        return np.full(3, np.nan)
    return np.array([getattr(said.linear_acceleration, axis) for axis in "xyz"], np.float64)


def read_float(data: bytes, source: Path | str) -> float:
    """Return `std_msgs/Float32` as the decimal number it was written as. Raises InputError if cut short."""
    if len(data) < 4:
        raise InputError(RECORDING_DAMAGED, "a number is cut short.", source)
    # 0.001 in single precision is 0.0010000000474974513, which nobody meant.
    return float(str(np.frombuffer(data, "<f4", 1)[0]))
