"""Generated inputs for both checkouts: recordings and a configuration file."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "made"))
from recordings import COLOR, DEPTH, Image, Recording, Stream

_FRAMES = 6
_START_NS = 1_700_000_000_000_000_000
_INTERVAL_NS = 33_000_000
_COLOR_DELAY_NS = 1_000_000
_TRUNCATION_RATIOS = (0.02, 0.5, 0.9, 0.999)

_PARAMETERS = """
[fuse]
voxel_size = 0.012

[clean]
fill_holes = 0.1

[simplify]
method = "planar"
max_shape = 0.01
max_texture = 50

[compare]
samples = 20000

[report]
views = 2
width = 300
"""


def write_inputs(folder: Path, sample: Path) -> None:
    """Write all inputs into a new folder; `sample` is the RGB-D sample."""
    folder.mkdir(parents=True)
    (folder / "run.toml").write_text(_PARAMETERS)
    _write_realsense(folder, sample)
    _write_ros(folder, sample)
    for name in ("realsense.bag", "ros2.db3", "ros2.mcap"):
        whole = (folder / name).read_bytes()
        for cut in _TRUNCATION_RATIOS:
            (folder / f"cut_{cut}_{name}").write_bytes(whole[: int(cut * len(whole))])


def _write_realsense(folder: Path, sample: Path) -> None:
    """Write RealSense recordings in the ROS 1 and db3 formats."""
    known, depths, colors, unit = _read_frames(sample)
    depth = Stream(DEPTH, [Image(*one, "mono16", unit=unit) for one in depths], **known)
    color = Stream(COLOR, [Image(*one, "rgb8") for one in colors], **known)
    recording = Recording([depth, color], units=(unit,))
    recording.write(folder / "realsense.bag")
    for form in ("raw", "png", "zstd"):
        recording.write_db3(folder / f"realsense_{form}.db3", form)


def _write_ros(folder: Path, sample: Path) -> None:
    """Write ROS 1 and ROS 2 recordings with each supported compression."""
    known, depths, colors, _ = _read_frames(sample)
    known |= {"model": "plumb_bob", "from_reference": None, "info": "/camera_info"}
    of_ros: dict[str, Any] = {"unit": None, "frame": "optical"}
    depth = Stream(
        "/camera/depth", [Image(*one, "16UC1", **of_ros) for one in depths], topic="/image_raw", **known
    )
    raw = [Image(*one, "rgb8", **of_ros) for one in colors]
    png = [
        Image(
            *one, "rgb8", compressed=("png", cv2.imencode(".png", one[1][:, :, ::-1])[1].tobytes()), **of_ros
        )
        for one in colors
    ]
    color = Stream("/camera/color", raw, topic="/image_raw", **known)
    for compression in ("none", "bz2", "lz4"):
        Recording([depth, color], (), compression).write(folder / f"ros1_{compression}.bag")
    packed_color = Stream("/camera/color", png, topic="/image_raw/compressed", **known)
    Recording([depth, packed_color], ()).write(folder / "ros1_png.bag")
    for storage, packed in (
        ("sqlite3", "none"),
        ("sqlite3", "message"),
        ("mcap", "none"),
        ("mcap", "storage"),
    ):
        written = Recording([depth, color], ()).write_ros2(folder / f"{storage}_{packed}", storage, packed)
        written.rename(folder / f"ros2{'' if packed == 'none' else '_zstd'}{written.suffix}")


def _read_frames(sample: Path) -> tuple[dict[str, Any], list[Any], list[Any], float]:
    """Read the first frames of a sample.

    Returns camera parameters, time-stamped depth images, time-stamped colour images, and metres per depth
    unit.
    """
    scan = json.loads((sample / "scan.json").read_text())
    camera = scan["camera"]
    known = {
        "intrinsics": tuple(camera[name] for name in ("fx", "fy", "cx", "cy")),
        "size": (camera["width"], camera["height"]),
    }
    depths, colors = [], []
    for n, frame in enumerate(scan["frames"][:_FRAMES]):
        moment = _START_NS + n * _INTERVAL_NS
        depths.append((moment, cv2.imread(str(sample / frame["depth"]), cv2.IMREAD_UNCHANGED)))
        image = cv2.imread(str(sample / frame["color"]))
        colors.append((moment + _COLOR_DELAY_NS, np.ascontiguousarray(image[:, :, ::-1])))
    return known, depths, colors, 1 / scan["depth_scale"]
