"""Deserialisation of ROS messages: images, cameras, transforms, accelerations.

Uses the message definitions of `rosbags` for ROS 1 and ROS 2. They never read or allocate more than a
message holds; this was tested with 120,000 truncated or changed messages. The code calls one level below
the `deserialize` functions of `rosbags`, which refuse the bytes that RealSense's recorder appends to an
image.
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
from scanloom.stages.scans.model.poses import create_pose_from_quaternion
from scanloom.stages.scans.model.scan import Pose

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

IMAGE, COMPRESSED_IMAGE = "sensor_msgs/Image", "sensor_msgs/CompressedImage"
IMU = "sensor_msgs/Imu"
# Bytes of the CDR header of a ROS 2 message; its second byte is 1 for little-endian.
_CDR_HEADER_BYTES = 4


@dataclass(frozen=True, eq=False)
class ImageMessage:
    """`sensor_msgs/Image`.

    Attributes
    ----------
    width, height : pixels.
    encoding : pixel format, as ROS names it.
    is_big_endian : byte order of 16-bit and float pixels.
    step : row stride in bytes.
    data : (n,) uint8, all rows.
    trailing_bytes : bytes after the message; RealSense's recorder appends the depth unit as a float32.
    """

    width: int
    height: int
    encoding: str
    is_big_endian: bool
    step: int
    data: NDArray[np.uint8]
    trailing_bytes: bytes


@dataclass(frozen=True, eq=False)
class CameraMessage:
    """`sensor_msgs/CameraInfo`.

    Attributes
    ----------
    width, height : pixels.
    model : name of the distortion model.
    distortion : distortion coefficients.
    matrix : (3, 3) float64 intrinsics K of the raw image.
    rectification : (3, 3) float64 rotation R from the camera to the rectified camera.
    projection : (3, 4) float64 projection P of the rectified image.
    """

    width: int
    height: int
    model: str
    distortion: tuple[float, ...]
    matrix: NDArray[np.float64]
    rectification: NDArray[np.float64]
    projection: NDArray[np.float64]


@cache
def _get_types(is_cdr: bool) -> Typestore:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if is_cdr:
        return get_typestore(Stores.ROS2_HUMBLE)
    types = get_typestore(Stores.ROS1_NOETIC)
    types.register(
        get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
    )
    return types


def _parse_message(
    data: bytes, kind: str, source: Path | str, label: str, *, is_cdr: bool = False
) -> tuple[Any, bytes]:
    """Deserialise a message.

    Parameters
    ----------
    kind : message type as ROS 1 names it.
    label : name of the message in error messages.

    Returns
    -------
    message : object with the fields of the message.
    rest : bytes after the message.

    Raises
    ------
    InputError
        If the message is truncated, damaged or in another encoding.
    """
    from rosbags.serde import SerdeError

    types = _get_types(is_cdr)
    known = types.get_msgdef(kind.replace("/", "/msg/"))
    try:
        if not is_cdr:
            message, end = known.deserialize_ros1(data, 0, known.cls, types)
            return message, data[end:]
        if data[1:2] != b"\1":
            raise ValueError("not little-endian")
        message, end = known.deserialize_cdr_le(memoryview(data)[_CDR_HEADER_BYTES:], 0, known.cls, types)
        return message, data[_CDR_HEADER_BYTES + end :]
    except (SerdeError, struct.error, ValueError) as error:
        raise InputError(
            RECORDING_DAMAGED, "{called} is truncated or damaged.", source, called=label
        ) from error


# Bytes at the start of an image message that hold its timestamp, for ROS 1 and 2. Reading only these avoids
# decompressing whole images.
STAMP_BYTES = 12


def read_stamp(data: bytes, source: Path | str, *, is_cdr: bool = False) -> int:
    """Return the capture time of an image, nanoseconds.

    Only the first `STAMP_BYTES` bytes of its message are needed.

    Raises
    ------
    InputError
        If the message is truncated.
    """
    try:
        _, seconds, nanoseconds = struct.unpack_from("<IiI" if is_cdr else "<III", data)
    except struct.error as error:
        raise InputError(RECORDING_DAMAGED, "the message is truncated.", source) from error
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def read_image(data: bytes, source: Path | str, *, is_cdr: bool = False) -> ImageMessage:
    """Deserialise an image; its pixels stay encoded.

    Parameters
    ----------
    source : location in error messages.
    is_cdr : True for ROS 2.

    Raises
    ------
    InputError
        If the message is truncated.
    """
    message, rest = _parse_message(data, IMAGE, source, "the image", is_cdr=is_cdr)
    return ImageMessage(
        message.width,
        message.height,
        message.encoding,
        bool(message.is_bigendian),
        message.step,
        message.data,
        rest,
    )


def read_camera_info(data: bytes, source: Path | str, *, is_cdr: bool = False) -> CameraMessage:
    """Deserialise a `sensor_msgs/CameraInfo`. The numbers are not validated.

    Raises
    ------
    InputError
        If the message is truncated.
    """
    message, _ = _parse_message(data, "sensor_msgs/CameraInfo", source, "the camera_info", is_cdr=is_cdr)
    # The fields are named D, K, R, P in ROS 1 and d, k, r, p in ROS 2.
    distortion, *matrices = (getattr(message, name if is_cdr else name.upper()) for name in "dkrp")
    matrix, turn, projection = (np.reshape(values, (3, -1)) for values in matrices)
    return CameraMessage(
        message.width,
        message.height,
        message.distortion_model,
        tuple(distortion.tolist()),
        matrix,
        turn,
        projection,
    )


def read_compressed(data: bytes, source: Path | str, *, is_cdr: bool = False) -> tuple[str, bytes]:
    """Return format string and encoded image of a `sensor_msgs/CompressedImage`.

    Raises
    ------
    InputError
        If the message is truncated.
    """
    message, _ = _parse_message(data, COMPRESSED_IMAGE, source, "the image", is_cdr=is_cdr)
    return message.format, message.data.tobytes()


def read_text(data: bytes, source: Path | str) -> str:
    """Return the text of a ROS 2 `std_msgs/String`.

    Raises InputError if the message is truncated.
    """
    message, _ = _parse_message(data, "std_msgs/String", source, "a text", is_cdr=True)
    return str(message.data)


def read_frame(data: bytes, source: Path | str, *, is_cdr: bool = False) -> str:
    """Return the coordinate frame named in a message header.

    Raises InputError if the message is truncated.
    """
    message, _ = _parse_message(data, "std_msgs/Header", source, "the message", is_cdr=is_cdr)
    return str(message.frame_id)


def read_transform(data: bytes, source: Path) -> Pose:
    """Return a ROS 1 `geometry_msgs/Transform` as a (4, 4) float64 matrix, metres.

    Raises
    ------
    InputError
        If the message is truncated or the transform is not rigid.
    """
    return _to_pose(_parse_message(data, "geometry_msgs/Transform", source, "a transform")[0], source)


def read_transforms(data: bytes, source: Path, *, is_cdr: bool = False) -> list[tuple[str, str, Pose]]:
    """Return the transforms of a `tf2_msgs/TFMessage`.

    Returns
    -------
    list of (parent frame, child frame, parent_from_child)
        The matrices are (4, 4) float64, metres.

    Raises
    ------
    InputError
        If the message is truncated or a transform is not rigid.
    """
    message, _ = _parse_message(data, "tf2_msgs/TFMessage", source, "a transform", is_cdr=is_cdr)
    return [
        (one.header.frame_id, one.child_frame_id, _to_pose(one.transform, source))
        for one in message.transforms
    ]


def _to_pose(transform: Any, source: Path) -> Pose:
    translation = [getattr(transform.translation, axis) for axis in "xyz"]
    rotation = [getattr(transform.rotation, axis) for axis in "xyzw"]
    pose = create_pose_from_quaternion(translation, rotation, source, "a transform")
    if pose is None:
        raise InputError(RECORDING_DAMAGED, "a transform contains NaN or infinity.", source)
    return pose


def read_acceleration(data: bytes, source: Path | str, *, is_cdr: bool = False) -> NDArray[np.float64]:
    """Return the acceleration of a `sensor_msgs/Imu`, (3,) float64 m/s².

    NaN if the IMU has no accelerometer.

    Raises
    ------
    InputError
        If the message is truncated.
    """
    message, _ = _parse_message(data, IMU, source, "an IMU reading", is_cdr=is_cdr)
    # ROS marks a quantity that the sensor does not measure by a covariance of -1.
    if message.linear_acceleration_covariance[0] == -1:
        return np.full(3, np.nan)
    return np.array([getattr(message.linear_acceleration, axis) for axis in "xyz"], np.float64)


def read_float(data: bytes, source: Path | str) -> float:
    """Return a `std_msgs/Float32` as its shortest decimal value.

    Raises
    ------
    InputError
        If the message is truncated.
    """
    if len(data) < 4:
        raise InputError(RECORDING_DAMAGED, "a number is truncated.", source)
    # 0.001 in single precision is 0.0010000000474974513; the shortest decimal is the intended value.
    return float(str(np.frombuffer(data, "<f4", 1)[0]))
