"""Which topics of an ordinary ROS bag are depth and colour: images with a `camera_info` beside them.

Depth is 16-bit millimetres or float metres, as ROS has it. Depth that is aligned to colour wins; otherwise
`/tf_static` says how the two cameras stand.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import takewhile
from typing import TYPE_CHECKING

import numpy as np

from stages.errors import InputError
from stages.formats import calibration
from stages.formats.ros_bag import RosBag, Topic, read_message
from stages.formats.ros_messages import (
    COMPRESSED_IMAGE,
    IMAGE,
    read_camera_info,
    read_compressed,
    read_frame,
    read_image,
    read_transforms,
)
from stages.formats.ros_pixels import is_color, is_depth
from stages.formats.trajectories import inverted
from stages.layouts.bag_images import bag_images
from stages.layouts.streams import Stream, Streams, stated_depth_camera, unknown_place
from stages.scan import Camera, Pose

if TYPE_CHECKING:
    from stages.layouts.params import ScanParams

_ALIGNED = ("aligned_depth", "depth_registered")
_LIKE_OPENCV = ("plumb_bob", "rational_polynomial", "none", "")
# A tree of frames is sent anew now and then; a robot has some hundreds of them.
_MOST_TRANSFORMS = 1000
_OTHERS = ("infra", "/ir", "confidence", "depth")


@dataclass(frozen=True, eq=False)
class _Images:
    """A topic of images and what its first one is encoded as."""

    name: str
    topic: Topic
    encoding: str

    @property
    def is_aligned(self) -> bool:
        return any(word in self.name for word in _ALIGNED)

    @property
    def is_compressed(self) -> bool:
        return self.topic.kind == COMPRESSED_IMAGE

    @property
    def place(self) -> str:
        """The name without what is done to the images: what `camera_info` stands beside."""
        name = self.name.rpartition("/")[0] if self.is_compressed else self.name
        return name.rpartition("/")[0]


def ros_streams(bag: RosBag, options: ScanParams) -> Streams | None:
    """Return depth and colour of a ROS bag; None where it has no images of depth.

    Raises
    ------
    InputError
        If what it says of its cameras is missing or wrong.
    """
    found = [images for name, topic in sorted(bag.topics.items()) if (images := _images(bag, name, topic))]
    depths = [one for one in found if "depth" in one.name.lower() and is_depth(one.encoding)]
    if not depths:
        return None
    depth = min(depths, key=lambda one: (not one.is_aligned, one.is_compressed))
    warnings = []
    if len(depths) > 1:
        warnings.append(f"of {len(depths)} topics of depth, {depth.name} is used")
    scale = options.depth_scale or (1.0 if depth.encoding.lower() == "32fc1" else 1000.0)
    maps = bag_images(bag, depth.name, depth.topic)
    stated = stated_depth_camera(maps, bag.path.parent, options)
    seen = Stream(maps, stated or _recorded_camera(bag, depth))
    colors = [
        one
        for one in found
        if is_color(one.encoding) and not any(word in one.name.lower() for word in _OTHERS)
    ]
    if not colors:
        return Streams(seen, None, scale, None, tuple(warnings))
    # Of several cameras, the colour is that of the depth's: their topics begin alike.
    color = min(colors, key=lambda one: (-_shared(one.name, depth.name), one.is_compressed))
    color_from_depth = None
    if not depth.is_aligned:
        color_from_depth = _between(bag, depth, color)
        if color_from_depth is None:
            warnings.append(unknown_place(depth.name, color.name))
    return Streams(
        seen,
        Stream(bag_images(bag, color.name, color.topic), _recorded_camera(bag, color)),
        scale,
        color_from_depth,
        tuple(warnings),
    )


def _shared(name: str, other: str) -> int:
    """Return how many parts of two names are the same before they part."""
    pairs = zip(name.split("/"), other.split("/"), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


def _images(bag: RosBag, name: str, topic: Topic) -> _Images | None:
    """Return a topic if it is one of images, and its first can be read."""
    try:
        if topic.kind == IMAGE:
            return _Images(name, topic, read_image(read_message(bag, topic, 0), bag.path).encoding)
        if topic.kind == COMPRESSED_IMAGE:
            form, _ = read_compressed(read_message(bag, topic, 0), bag.path)
            # `16UC1; compressedDepth png`, or `rgb8; jpeg compressed bgr8`, or only `jpeg`.
            encoding = form.split(";")[0].strip()
            return _Images(name, topic, encoding if is_depth(encoding) else "bgr8")
    except InputError:
        return None
    return None


def _recorded_camera(bag: RosBag, images: _Images) -> Camera:
    """Return the camera of a topic as the `camera_info` beside it states it."""
    info = bag.topics.get(f"{images.place}/camera_info")
    if info is None:
        raise InputError(
            f"there is no {images.place}/camera_info, which would say what camera {images.name} is of; set "
            "scan.intrinsics=fx,fy,cx,cy.",
            bag.path,
        )
    message = read_camera_info(read_message(bag, info, 0), f"{bag.path}: {images.name}")
    # K and D are of the image as it was taken, P of the rectified one.
    is_rectified = "rect" in images.name.removeprefix(images.place) and message.projection.any()
    matrix = message.projection if is_rectified else message.matrix
    distortion = () if is_rectified or not any(message.distortion) else message.distortion
    if distortion and message.model not in _LIKE_OPENCV:
        raise InputError(
            f"the lens of {images.name} is described as {message.model[:40]!r}; plumb_bob and "
            "rational_polynomial are known.",
            bag.path,
        )
    if len(distortion) not in (0, 4, 5, 8):
        raise InputError(
            f"the lens of {images.name} has {len(distortion)} coefficients, not 4, 5 or 8.", bag.path
        )
    return calibration.matrix_camera(matrix, distortion, message.width, message.height, bag.path)


def _between(bag: RosBag, depth: _Images, color: _Images) -> Pose | None:
    """Return color_from_depth by the tree of `/tf_static`; None where it does not join the two."""
    parents: dict[str, tuple[str, Pose]] = {}
    tree = bag.topics.get("/tf_static")
    for number in range(0 if tree is None else min(len(tree), _MOST_TRANSFORMS)):
        assert tree is not None
        for parent, child, pose in read_transforms(read_message(bag, tree, number), bag.path):
            parents[child.lstrip("/")] = parent.lstrip("/"), pose
    frames = (read_frame(read_message(bag, one.topic, 0), bag.path).lstrip("/") for one in (depth, color))
    of_depth, of_color = (_root(frame, parents) for frame in frames)
    if of_depth is None or of_color is None or of_depth[0] != of_color[0]:
        return None
    return np.asarray(inverted(of_color[1]) @ of_depth[1])


def _root(frame: str, parents: dict[str, tuple[str, Pose]]) -> tuple[str, Pose] | None:
    """Return the root of a frame's tree, and what takes points of the frame to it; None if it is a ring."""
    root_from_frame: Pose = np.eye(4)
    seen = {frame}
    while frame in parents:
        frame, step = parents[frame]
        root_from_frame = np.asarray(step @ root_from_frame)
        if frame in seen:
            return None
        seen.add(frame)
    return frame, root_from_frame
