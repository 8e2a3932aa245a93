"""TUM RGB-D: colour and depth as two streams with their own clocks, motion capture as the trajectory."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError
from stages.formats import calibration, documents, trajectories
from stages.layouts.files import common_size, first_existing, has
from stages.layouts.in_time import associate
from stages.layouts.layout import Layout
from stages.scan import Camera, Frame, Scan, SkippedFrame

if TYPE_CHECKING:
    from stages.layouts.params import ScanParams

# The data set's own tools pair within 0.02 s, less than one frame at 30 Hz.
_TOLERANCE = 20_000_000
_UNITS_PER_METRE = 5000.0
# The folder holds no intrinsics; its name tells the camera: fx fy cx cy, then k1 k2 p1 p2 k3.
_CAMERAS = {
    "freiburg1": ((517.3, 516.5, 318.6, 255.3), (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "freiburg2": ((520.9, 521.0, 325.1, 249.7), (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "freiburg3": ((535.4, 539.2, 320.1, 247.6), ()),
}
_FALLBACK = (525.0, 525.0, 319.5, 239.5)


def _matches(folder: Path) -> str | None:
    if not has(folder, "rgb.txt", "depth.txt"):
        return None
    return "rgb.txt and depth.txt" + (" with groundtruth.txt" if has(folder, "groundtruth.txt") else "")


def _read(folder: Path, options: ScanParams) -> Scan:
    path = options.file("poses", folder) or first_existing(folder, "groundtruth.txt")
    trajectory = None if path is None else trajectories.read_timed(path)
    color_times, listed_colors = _stream(folder / "rgb.txt")
    depth_times, listed_depths = _stream(folder / "depth.txt")
    colors, moved_colors = _where_they_are(listed_colors, folder)
    depths, moved_depths = _where_they_are(listed_depths, folder)
    camera, warnings = _camera(folder, options, *common_size(depths))
    warnings += moved_colors + moved_depths

    frames: list[Frame] = []
    skipped: list[SkippedFrame] = []
    partners = associate(color_times, depth_times, _TOLERANCE)
    for color, time, partner in zip(colors, color_times.tolist(), partners.tolist(), strict=True):
        if partner < 0:
            skipped.append(SkippedFrame(color.stem, "no depth frame within 0.02 s"))
            continue
        # The surface is where the depth camera saw it from, so its moment decides.
        moment = int(depth_times[partner])
        pose = None if trajectory is None else trajectories.interpolate(trajectory, moment, _TOLERANCE)
        if pose is None and trajectory is not None:
            skipped.append(SkippedFrame(color.stem, "no pose within 0.02 s"))
            continue
        frames.append(
            Frame(
                name=color.stem,
                camera=camera,
                color=color,
                depth=depths[partner],
                depth_scale=options.depth_scale or _UNITS_PER_METRE,
                world_from_camera=pose,
                timestamp=time,
            )
        )
    lacking = "poses: groundtruth.txt is missing; name a trajectory with scan.poses=FILE"
    missing = (lacking,) if trajectory is None else ()
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), tuple(warnings), missing)


def _stream(path: Path) -> tuple[NDArray[np.int64], list[Path]]:
    """Return the times in nanoseconds and the files of a stream, from lines `seconds file`."""
    times, files = [], []
    for number, text in documents.lines(path):
        words = text.split()
        if len(words) != 2:
            raise InputError(f"line {number} is not `seconds file`.", path)
        times.append(trajectories.nanoseconds(float(words[0]), path, number))
        files.append(path.parent / words[1])
    if not files:
        raise InputError("it lists no images.", path)
    return np.array(times, np.int64), files


def _where_they_are(files: list[Path], folder: Path) -> tuple[list[Path], list[str]]:
    """Return the files of a stream and what is to be said: their folder may have another name than listed."""
    listed = files[0].parent
    if listed.exists():
        return files, []
    holders = [place for place in folder.iterdir() if any((place / path.name).is_file() for path in files)]
    if len(holders) != 1:
        return files, []
    found = holders[0]
    said = f"there is no folder {listed.name}/, but {found.name}/ has the images listed in it: they are used"
    return [found / path.name for path in files], [said]


def _camera(folder: Path, options: ScanParams, width: int, height: int) -> tuple[Camera, list[str]]:
    stated = options.camera(width, height)
    if stated is not None:
        return stated, []
    path = options.file("calibration", folder) or first_existing(folder, "camera.json", "intrinsic.json")
    if path is not None:
        return calibration.read_camera(path, width, height), []
    named = re.search(r"(?<![a-z])(?:freiburg|fr)_?([123])(?!\d)", folder.resolve().name, re.IGNORECASE)
    if named is not None:
        matrix, distortion = _CAMERAS[f"freiburg{named[1]}"]
        return Camera(width, height, *matrix, distortion), [
            f"the camera is freiburg{named[1]}'s, by the folder's name"
        ]
    return Camera(width, height, *_FALLBACK), [
        "the folder has no intrinsics and its name no freiburg1 to 3: 525,525,319.5,239.5 is used, and TUM's "
        "depth of 5000 units a metre; for another camera set scan.intrinsics=fx,fy,cx,cy and "
        "scan.depth_scale=VALUE"
    ]


LAYOUT = Layout(
    name="tum",
    text="rgb.txt, depth.txt, groundtruth.txt (TUM RGB-D)",
    matches=_matches,
    read=_read,
)
