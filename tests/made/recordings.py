"""ROS and RealSense recordings with the vendors' topics and messages.

They are written by an independent library, `rosbags`.
"""

from __future__ import annotations

import json
import sqlite3
import struct
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

_TYPES = get_typestore(Stores.ROS1_NOETIC)
_TYPES.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
_ROS_2 = get_typestore(Stores.ROS2_HUMBLE)
DEPTH, COLOR = "/device_0/sensor_0/Depth_0", "/device_0/sensor_1/Color_0"
INFRARED = "/device_0/sensor_0/Infrared_{}"


def make_message(kind: str, **fields: Any) -> Any:
    return _TYPES.types[f"{kind.replace('/', '/msg/')}"](**fields)


def make_string_message(said: str) -> tuple[str, dict[str, Any]]:
    """Make type and fields of a ROS 2 text message."""
    return "std_msgs/msg/String", {"data": said}


def serialise_ros1(kind: str, **fields: Any) -> bytes:
    return bytes(_TYPES.serialize_ros1(make_message(kind, **fields), kind.replace("/", "/msg/")))


def serialise_ros2(kind: str, fields: dict[str, Any]) -> bytes:
    return bytes(_ROS_2.serialize_cdr(_ROS_2.types[kind](**fields), kind))


def make_header(time: int, frame: str = "1") -> Any:
    """Make a message header.

    RealSense's recorder stores its version in the field for the frame's name.
    """
    stamp = make_message("builtin_interfaces/Time", sec=time // 10**9, nanosec=time % 10**9)
    return make_message("std_msgs/Header", seq=7, stamp=stamp, frame_id=frame)


def make_transform(translation: Sequence[float], turn: Sequence[float]) -> dict[str, Any]:
    return {
        "translation": make_message("geometry_msgs/Vector3", **dict(zip("xyz", translation, strict=True))),
        "rotation": make_message("geometry_msgs/Quaternion", **dict(zip("xyzw", turn, strict=True))),
    }


@dataclass
class Image:
    """Image with a time stamp, the time of recording, and the depth unit that is appended to its message."""

    time: int
    pixels: np.ndarray
    encoding: str
    recorded: int | None = None
    unit: float | None = 0.0
    padding: int = 0
    big_endian: bool = False
    frame: str = "1"
    compressed: tuple[str, bytes] | None = None

    @property
    def kind(self) -> str:
        return "sensor_msgs/Image" if self.compressed is None else "sensor_msgs/CompressedImage"

    def message(self) -> bytes:
        header = make_header(self.time, self.frame)
        if self.compressed is not None:
            form, data = self.compressed
            return serialise_ros1(self.kind, header=header, format=form, data=np.frombuffer(data, np.uint8))
        stored = self.pixels.astype(self.pixels.dtype.newbyteorder(">" if self.big_endian else "<"))
        height, width = stored.shape[:2]
        rows = np.frombuffer(stored.tobytes(), np.uint8).reshape(height, -1)
        rows = np.pad(rows, ((0, 0), (0, self.padding)), constant_values=99)
        data = serialise_ros1(
            self.kind,
            header=header,
            height=height,
            width=width,
            encoding=self.encoding,
            is_bigendian=int(self.big_endian),
            step=rows.shape[1],
            data=rows.ravel(),
        )
        return data if self.unit is None else data + struct.pack("<f", self.unit)

    def row(self, topic: str, recorded: int, form: str) -> tuple[str, str, dict[str, Any]]:
        """Make topic, message type and fields for a newer recording."""
        stamp = _ROS_2.types["builtin_interfaces/msg/Time"](sec=recorded // 10**9, nanosec=recorded % 10**9)
        fields: dict[str, Any] = {
            "header": _ROS_2.types["std_msgs/msg/Header"](stamp=stamp, frame_id="Depth")
        }
        height, width = self.pixels.shape[:2]
        if form != "png":
            fields |= {"height": height, "width": width, "encoding": self.encoding, "is_bigendian": 0}
            fields |= {"step": self.pixels.strides[0], "data": np.frombuffer(self.pixels.tobytes(), np.uint8)}
            return topic, "sensor_msgs/msg/Image", fields
        is_depth = self.pixels.ndim == 2
        shown = self.pixels if is_depth else self.pixels[:, :, ::-1]
        data = bytes(12 * is_depth) + cv2.imencode(".png", shown)[1].tobytes()
        form = "16UC1; compressedDepth png" if is_depth else "rgb8; png compressed bgr8"
        fields |= {"format": form, "data": np.frombuffer(data, np.uint8)}
        kind = "compressedDepth" if is_depth else "compressed"
        return f"{topic}/{kind}", "sensor_msgs/msg/CompressedImage", fields


@dataclass
class Stream:
    """Stream with its properties in the recording; None for properties that the recording lacks."""

    name: str
    images: Sequence[Image]
    intrinsics: tuple[float, float, float, float] | None
    size: tuple[int, int]
    from_reference: tuple[Sequence[float], Sequence[float]] | None = ((0, 0, 0), (0, 0, 0, 1))
    model: str = "Brown Conrady"
    distortion: Sequence[float] = (0, 0, 0, 0, 0)
    projection: Sequence[float] = (0,) * 12
    rectification: Sequence[float] = (1, 0, 0, 0, 1, 0, 0, 0, 1)
    topic: str = "/image/data"
    info: str = "/info/camera_info"


@dataclass
class Reading:
    """Accelerometer sample in m/s²; the variance is -1 for a sensor that does not measure acceleration."""

    time: int
    acceleration: Sequence[float]
    frame: str = "imu"
    variance: float = 0.0

    def message(self) -> bytes:
        vector = make_message("geometry_msgs/Vector3", **dict(zip("xyz", self.acceleration, strict=True)))
        return serialise_ros1(
            "sensor_msgs/Imu",
            header=make_header(self.time, self.frame),
            orientation=make_message("geometry_msgs/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=np.array([-1.0, *[0] * 8]),
            angular_velocity=make_message("geometry_msgs/Vector3", x=0.0, y=0.0, z=0.0),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=vector,
            linear_acceleration_covariance=np.array([self.variance, *[0] * 8]),
        )


@dataclass
class Recording:
    """Streams, accelerometer samples by topic, and the recorded values of the depth unit option."""

    streams: Sequence[Stream]
    units: Sequence[float] = (0.0001,)
    compression: str = "lz4"
    chunk_bytes: int = 2500
    started: int = 0
    others: dict[str, tuple[str, dict[str, Any]]] = field(default_factory=dict)
    readings: dict[str, Sequence[Reading]] = field(default_factory=dict)

    def write(self, path: Path) -> Path:
        """Write a ROS 1 bag."""
        path.unlink(missing_ok=True)
        writer = Writer(path)
        writer.chunk_threshold = self.chunk_bytes
        if self.compression != "none":
            writer.set_compression(Writer.CompressionFormat[self.compression.upper()])
        with writer:
            written: dict[str, Any] = {}
            for topic, kind, time, data in self._messages():
                if topic not in written:
                    written[topic] = writer.add_connection(topic, _to_ros2_type(kind), typestore=_TYPES)
                writer.write(written[topic], time, data)
        return path

    def write_ros2(self, folder: Path, storage: str, packed: str = "none", parts: int = 1) -> Path:
        """Write a ROS 2 folder; return its only file, or the folder if it has several files.

        `storage` is sqlite3 or mcap. `packed` is the part that zstd compresses: none, message, file, or
        storage (chunks).
        """
        messages = list(self._messages())
        # Recorders split files by size, so the next file starts in the middle of the streams.
        starts = [len(messages) * part // parts for part in range(parts + 1)]
        names = []
        for part in range(parts):
            inner = folder if parts == 1 else folder.with_name(f"{folder.name}_{part}")
            writer = Writer2(inner, version=9, storage_plugin=StoragePlugin[storage.upper()])
            if packed != "none":
                writer.set_compression(CompressionMode[packed.upper()], CompressionFormat.ZSTD)
            with writer:
                written: dict[str, Any] = {}
                for topic, kind, time, data in messages[starts[part] : starts[part + 1]]:
                    if topic not in written:
                        written[topic] = writer.add_connection(topic, _to_ros2_type(kind), typestore=_ROS_2)
                    writer.write(written[topic], time, _ROS_2.ros1_to_cdr(data, _to_ros2_type(kind)))
            names += sorted(file.name for file in inner.iterdir() if file.name != "metadata.yaml")
        if parts == 1:
            return folder / names[0]
        folder.mkdir()
        for part, name in enumerate(names):
            (folder.with_name(f"{folder.name}_{part}") / name).rename(folder / name)
        listed = json.dumps({"rosbag2_bagfile_information": {"version": 9, "relative_file_paths": names}})
        (folder / "metadata.yaml").write_text(listed)
        return folder

    def write_db3(self, path: Path, form: str = "raw") -> Path:
        """Write a recording like librealsense 3; `form` of images is raw, png, or zstd (all messages)."""
        path.unlink(missing_ok=True)
        database = sqlite3.connect(path)
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT)")
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
        )
        for time, name, kind, fields in self._rows(form):
            known = database.execute("SELECT id FROM topics WHERE name = ?", (name,)).fetchone()
            if known is None:
                added = database.execute("INSERT INTO topics(name, type) VALUES (?, ?)", (name, kind))
                known = (added.lastrowid,)
            data = fields if isinstance(fields, bytes) else serialise_ros2(kind, fields)
            if form == "zstd":
                data = zstd.compress(data)
            database.execute(
                "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", (*known, time, data)
            )
        database.commit()
        database.close()
        return path

    def _rows(self, form: str) -> Iterator[tuple[int, str, str, dict[str, Any] | bytes]]:
        """Yield time, topic, message type, and the fields or the serialised message."""
        for topic, readings in self.readings.items():
            for one in readings:
                data = bytes(_ROS_2.ros1_to_cdr(one.message(), "sensor_msgs/msg/Imu"))
                yield one.time - self.started, topic, "sensor_msgs/msg/Imu", data
        for unit in self.units:
            yield 0, "/device_0/sensor_0/option/Depth_Units/value", *make_string_message(f"{unit:.6f}")
        for stream in self.streams:
            width, height = stream.size
            if stream.intrinsics is not None:
                fx, fy, cx, cy = stream.intrinsics
                lens = f"model={stream.model};coeffs={','.join(map(str, stream.distortion))}"
                said = f"width={width};height={height};fx={fx};ppx={cx};fy={fy};ppy={cy};{lens}"
                yield 0, f"{stream.name}/camera_info", *make_string_message(said)
            if stream.from_reference is not None:
                shift, turn = stream.from_reference
                columns = ",".join(f"{value:.6f}" for value in Rotation.from_quat(turn).as_matrix().T.ravel())
                said = f"rotation={columns};translation={','.join(map(str, shift))}"
                yield 0, f"{stream.name}/tf/ref_1", *make_string_message(said)
            for image in stream.images:
                recorded = (image.time if image.recorded is None else image.recorded) - self.started
                said = f"Frame number=1;timestamp_domain=Global Time;timestamp={image.time / 1e6:.6f};"
                yield recorded, f"{stream.name}/image/metadata", *make_string_message(said)
                yield recorded, *image.row(f"{stream.name}/image/data", recorded, form)

    def _messages(self) -> Iterator[tuple[str, str, int, bytes]]:
        """Yield topic, ROS 1 type, time of recording and serialised message, in file order."""
        for topic, (kind, fields) in self.others.items():
            yield topic, kind, 1, serialise_ros1(kind, **fields)
        for stream in self.streams:
            yield from _describe_stream(stream)
        for n, unit in enumerate(self.units):
            topic = "/device_0/sensor_0/option/Depth_Units/value"
            yield topic, "std_msgs/Float32", n + 1, serialise_ros1("std_msgs/Float32", data=unit)
        taken: list[tuple[int, str, str, Image | Reading]] = [
            (one.time if one.recorded is None else one.recorded, s.name + s.topic, one.kind, one)
            for s in self.streams
            for one in s.images
        ]
        taken += [
            (one.time, topic, "sensor_msgs/Imu", one)
            for topic, all_of in self.readings.items()
            for one in all_of
        ]
        for time, topic, kind, one in sorted(taken, key=lambda entry: entry[0]):
            yield topic, kind, time, one.message()


def _to_ros2_type(kind: str) -> str:
    return kind.replace("/", "/msg/")


def _describe_stream(stream: Stream) -> Iterator[tuple[str, str, int, bytes]]:
    if stream.intrinsics is not None:
        fx, fy, cx, cy = stream.intrinsics
        info = serialise_ros1(
            "sensor_msgs/CameraInfo",
            header=make_header(0),
            height=stream.size[1],
            width=stream.size[0],
            distortion_model=stream.model,
            D=np.array(stream.distortion, np.float64),
            K=np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0]),
            R=np.array(stream.rectification, np.float64),
            P=np.array(stream.projection, np.float64),
            binning_x=0,
            binning_y=0,
            roi=make_message(
                "sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
            ),
        )
        yield stream.name + stream.info, "sensor_msgs/CameraInfo", 1, info
    if stream.from_reference is not None:
        placed = serialise_ros1("geometry_msgs/Transform", **make_transform(*stream.from_reference))
        yield f"{stream.name}/tf/1", "geometry_msgs/Transform", 1, placed
