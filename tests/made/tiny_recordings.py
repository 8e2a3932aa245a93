"""Recording of the tiny scene that tests of layouts share.

The colour camera is rotated by 90° and shifted against the depth camera: color_from_depth maps (x, y, z) to
(-y - 0.04, x + 0.02, z). The known point (0.2, 0.1, 2) is thus at (-0.14, 0.22, 2). With focal lengths of 200
and the principal point (24.5, 32.5), it projects to pixel (10.5, 54.5), between four pixels.
"""

import dataclasses

import numpy as np
from recordings import COLOR, DEPTH, Image, Recording, Stream, make_header, make_message, make_transform

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import POSE_ASSUMED
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.reader import read_scan

START = 1_700_000_000_000_000_000
INTERVAL = 33_000_000
QUARTER = (0, 0, 0.5**0.5, 0.5**0.5)


# Both streams give their pose relative to a reference 1 m in front of the depth camera, rotated about its y
# axis.
DEPTH_TURN = (0, 0.6, 0, 0.8)


def depth_map(metres=2.0, units=0.0001):
    image = np.full((24, 32), round(metres / units), np.uint16)
    image[0, 0] = 0
    return image


def color_image(grey=90):
    image = np.full((64, 48, 3), grey, np.uint8)
    image[54:56, 10:12] = (10, 240, 120)
    return image


def color_turn():
    """Compose QUARTER and DEPTH_TURN as a quaternion x y z w."""
    s = 0.5**0.5
    return (-s * 0.6, s * 0.6, s * 0.8, s * 0.8)


def depth_stream(count=2, **changes):
    images = [Image(START + n * INTERVAL, depth_map(), "mono16", unit=0.0001) for n in range(count)]
    stream = Stream(DEPTH, images, (100, 100, 16, 12), (32, 24), ((0, 0, 1), DEPTH_TURN))
    return dataclasses.replace(stream, **changes)


def color_stream(count=2, **changes):
    images = [Image(START + n * INTERVAL + 4_000_000, color_image(), "rgb8") for n in range(count)]
    # The quarter turn also rotates the depth camera's position in the reference, (0, 0, 1), which is on its
    # axis.
    stream = Stream(COLOR, images, (200, 200, 24.5, 32.5), (48, 64), ((-0.04, 0.02, 1), color_turn()))
    return dataclasses.replace(stream, **changes)


def recording(**changes):
    return dataclasses.replace(Recording([depth_stream(), color_stream()]), **changes)


def ros_depth(**changes):
    images = [Image(START, depth_map(units=0.001), "16UC1", unit=None, frame="depth_optical")]
    stream = Stream("/cam/depth", images, (100, 100, 16, 12), (32, 24), None, "plumb_bob")
    return dataclasses.replace(stream, **{"topic": "/image_raw", "info": "/camera_info", **changes})


def ros_color(**changes):
    images = [Image(START, color_image(), "bgr8", unit=None, frame="color_optical")]
    images[0].pixels = np.ascontiguousarray(images[0].pixels[:, :, ::-1])
    stream = Stream("/cam/color", images, (200, 200, 24.5, 32.5), (48, 64), None, "plumb_bob")
    return dataclasses.replace(stream, **{"topic": "/image_raw", "info": "/camera_info", **changes})


def ros_bag(depth=None, color=None, links=(), **others):
    """Make a bag of a generic camera; `links` are (parent, child, translation, quaternion)."""
    transforms = [
        make_message(
            "geometry_msgs/TransformStamped",
            header=make_header(0, parent),
            child_frame_id=child,
            transform=make_message("geometry_msgs/Transform", **make_transform(*place)),
        )
        for parent, child, *place in links
    ]
    if links:
        others["/tf_static"] = ("tf2_msgs/TFMessage", {"transforms": transforms})
    return Recording([depth or ros_depth(), color or ros_color()], units=(), others=others)


# color_from_depth is a quarter turn about z followed by a shift of (-0.04, 0.02, 0). The position of the
# colour camera in the depth camera's frame is the negative shift turned back: (-0.02, -0.04, 0).
LINKS = [
    ("base", "depth_optical", (0, 0, 1), DEPTH_TURN),
    ("depth_optical", "arm", (-0.02, -0.04, 0), (0, 0, 0, 1)),
    ("/arm", "color_optical", (0, 0, 0), (0, 0, -(0.5**0.5), 0.5**0.5)),
]


def call_or_get_error(read, *arguments, **options):
    """Call a function; return its result, or the message of its error."""
    try:
        return read(*arguments, **options)
    except InputError as error:
        return str(error)


def list_warnings(scan: Scan) -> list[str]:
    """List the warnings of a recording, except the one for a single frame without a pose."""
    return [str(one) for one in scan.diagnostics if one.code != POSE_ASSUMED.name]


def summarise_scan(file):
    """Sum the readable frames of a scan and count its warnings; None for an unreadable scan."""
    scan = call_or_get_error(read_scan, file, complete=False)
    if isinstance(scan, str):
        assert str(file) in scan
        return None
    frames = []
    for one in scan.frames:
        images = [call_or_get_error(read_depth, one), call_or_get_error(read_color, one)]
        faults = [image for image in images if isinstance(image, str)]
        assert all(str(file) in fault for fault in faults)
        if not faults and images[1] is not None:
            frames.append((one.name, *(float(image.sum()) for image in images)))
    return frames, len(list_warnings(scan))
