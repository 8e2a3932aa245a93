"""Cameras as printed by ROS's camera calibrator (`ost.txt`, and .ini files of the same form).

    [image]
    width
    1280
    height
    1024
    [narrow_stereo/left]
    camera matrix
    861.6464 0 646.0616
    …
    distortion
    rectification
    projection

A stereo pair is two such sections in one file.
"""

from __future__ import annotations

import re
from typing import Any

# Keys of ROS's YAML by the names in the text.
_YAML_KEYS = {
    "width": "image_width",
    "height": "image_height",
    "camera matrix": "camera_matrix",
    "distortion": "distortion_coefficients",
    "rectification": "rectification_matrix",
    "projection": "projection_matrix",
}
_HEADING = re.compile(r"\[([^\]]{1,200})\]")
_SIDE = re.compile("left|right", re.IGNORECASE)


def parse_ros_text(text: str) -> dict[str, Any] | None:
    """Parse the text into the table of a camera, or tables `left` and `right`.

    Returns None if the text has another form.
    """
    cameras: list[dict[str, Any]] = []
    numbers: list[float] = []
    for line in text.splitlines():
        words = line.partition("#")[0].strip()
        heading = _HEADING.fullmatch(words)
        if heading is not None and heading[1].lower() == "image":
            cameras.append({})
        elif heading is not None and cameras:
            cameras[-1]["camera_name"] = heading[1]
        elif words.lower() in _YAML_KEYS and cameras:
            numbers = cameras[-1].setdefault(_YAML_KEYS[words.lower()], [])
        elif words:
            try:
                numbers.extend(float(word) for word in words.split())
            except ValueError:
                return None
    if not cameras or not all("camera_matrix" in camera for camera in cameras):
        return None
    for camera in cameras:
        for size in ("image_width", "image_height"):
            if len(camera.get(size, ())) == 1:
                camera[size] = camera[size][0]
    if len(cameras) == 1:
        return cameras[0]
    sides = [_SIDE.search(str(camera.get("camera_name"))) for camera in cameras]
    names = [f"camera {i}" if side is None else side[0].lower() for i, side in enumerate(sides)]
    return dict(zip(names, cameras, strict=True)) if len(set(names)) == len(names) else None
