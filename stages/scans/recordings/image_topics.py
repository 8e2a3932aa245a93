"""Image topics of a ROS recording: encodings, cameras and transforms."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import CAMERA_INTRINSICS_GUESSED
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Pose
from scanloom.stages.scans.recordings.image_decoding import is_depth
from scanloom.stages.scans.recordings.messages import (
    COMPRESSED_IMAGE,
    IMAGE,
    IMU,
    CameraMessage,
    read_acceleration,
    read_camera_info,
    read_compressed,
    read_frame,
    read_image,
    read_transforms,
)
from scanloom.stages.scans.recordings.recording import Recording, TopicMessages
from scanloom.stages.scans.streams.timestamped_streams import Accelerometer

# Maximum number of `/tf_static` messages to read. The tree is republished now and then; a robot has some
# hundreds of frames.
_MAX_TRANSFORM_MESSAGES = 1000


@dataclass(frozen=True, eq=False)
class ImageTopic:
    """Image topic with its first image's encoding and its coordinate frame."""

    name: str
    topic: TopicMessages
    encoding: str
    frame: str

    @property
    def is_compressed(self) -> bool:
        """True if the images are compressed."""
        return self.topic.message_type == COMPRESSED_IMAGE

    @property
    def namespace(self) -> str:
        """Topic namespace that contains `camera_info`: the name without the image transport parts."""
        name = self.name.rpartition("/")[0] if self.is_compressed else self.name
        return name.rpartition("/")[0]

    @property
    def is_rectified(self) -> bool:
        """True if the topic name marks rectified images: `image_rect_color`, `color/rect/image`."""
        return re.search(r"[/_]rect", "/".join(self.name.split("/")[-3:])) is not None


def list_image_topics(recording: Recording) -> Sequence[ImageTopic]:
    """Return the image topics whose first image is readable, sorted by name."""
    found = (_read_image_topic(recording, name, topic) for name, topic in sorted(recording.topics.items()))
    return [one for one in found if one is not None]


def _read_image_topic(recording: Recording, name: str, topic: TopicMessages) -> ImageTopic | None:
    if topic.message_type not in (IMAGE, COMPRESSED_IMAGE):
        return None
    try:
        first = topic.read(0, None)
        frame = read_frame(first, recording.path, is_cdr=topic.is_cdr).lstrip("/")
        if topic.message_type == IMAGE:
            return ImageTopic(
                name, topic, read_image(first, recording.path, is_cdr=topic.is_cdr).encoding, frame
            )
        form, _ = read_compressed(first, recording.path, is_cdr=topic.is_cdr)
        # Formats: `16UC1; compressedDepth png`, `rgb8; jpeg compressed bgr8`, or only `jpeg`.
        encoding = form.split(";")[0].strip()
        return ImageTopic(name, topic, encoding if is_depth(encoding) else "bgr8", frame)
    except InputError:
        return None


def has_camera_info(recording: Recording, images: ImageTopic) -> bool:
    """Return True if the recording has a `camera_info` for an image topic."""
    return f"{images.namespace}/camera_info" in recording.topics


def read_camera_message(recording: Recording, images: ImageTopic) -> CameraMessage:
    """Return the `camera_info` of an image topic.

    Raises
    ------
    InputError
        If there is no `camera_info` or it is damaged.
    """
    info = recording.topics.get(f"{images.namespace}/camera_info")
    if info is None:
        raise InputError(
            CAMERA_INTRINSICS_GUESSED,
            "the topic {place}/camera_info with the intrinsics of {images_name} is missing",
            recording.path,
            remedy="set scan.intrinsics=fx,fy,cx,cy.",
            place=images.namespace,
            images_name=images.name,
        )
    return read_camera_info(info.read(0, None), f"{recording.path}: {images.name}", is_cdr=info.is_cdr)


def find_transform(recording: Recording, first: str, second: str) -> Pose | None:
    """Return second_from_first (4, 4) from `/tf_static`, or None if not connected.

    Parameters
    ----------
    first, second : names of coordinate frames.

    Raises
    ------
    InputError
        If a transform is damaged.
    """
    parents: dict[str, tuple[str, Pose]] = {}
    tree = recording.topics.get("/tf_static")
    for number in range(0 if tree is None else min(len(tree.record_times_ns), _MAX_TRANSFORM_MESSAGES)):
        assert tree is not None
        transforms = read_transforms(tree.read(number, None), recording.path, is_cdr=tree.is_cdr)
        for parent, child, pose in transforms:
            parents[child.lstrip("/")] = parent.lstrip("/"), pose
    of_first, of_second = (_find_root_frame(frame, parents) for frame in (first, second))
    if of_first is None or of_second is None or of_first[0] != of_second[0]:
        return None
    return np.asarray(invert_pose(of_second[1]) @ of_first[1])


def find_accelerometer(recording: Recording, frame: str) -> Accelerometer | None:
    """Return the accelerometer of a recording relative to a camera, or None.

    Of several IMU topics, a topic with "accel" in its name is preferred, then "gyro", then the first by
    name.

    Parameters
    ----------
    frame : coordinate frame of the camera.
    """
    topics = {name: one for name, one in recording.topics.items() if one.message_type == IMU}
    if not topics:
        return None
    name = min(topics, key=lambda one: ("accel" not in one, "gyro" in one, one))
    topic = topics[name]
    try:
        own = read_frame(topic.read(0, None), recording.path, is_cdr=topic.is_cdr).lstrip("/")
        camera_from_sensor = find_transform(recording, own, frame)
    except InputError:
        camera_from_sensor = None
    return Accelerometer(
        name,
        topic.record_times_ns,
        partial(read_topic_acceleration, topic),
        None if camera_from_sensor is None else camera_from_sensor[:3, :3],
    )


def read_topic_acceleration(topic: TopicMessages, number: int) -> NDArray[np.float64]:
    """Return reading `number` of an accelerometer topic, (3,) m/s².

    Raises
    ------
    InputError
        If the message is damaged.
    """
    return read_acceleration(topic.read(number, None), topic.find_file(number), is_cdr=topic.is_cdr)


def _find_root_frame(frame: str, parents: dict[str, tuple[str, Pose]]) -> tuple[str, Pose] | None:
    """Return the root of a frame, and root_from_frame (4, 4).

    None if the tree has a cycle.
    """
    root_from_frame: Pose = np.eye(4)
    seen = {frame}
    while frame in parents:
        frame, step = parents[frame]
        root_from_frame = np.asarray(step @ root_from_frame)
        if frame in seen:
            return None
        seen.add(frame)
    return frame, root_from_frame
