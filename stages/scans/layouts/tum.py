"""TUM RGB-D: colour and depth as two streams with their own clocks, motion capture as the trajectory."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError
from stages.files import documents
from stages.scans.formats import calibration, trajectories
from stages.scans.reading.associations import read_associations
from stages.scans.reading.beside import trajectory_beside
from stages.scans.reading.depth_units import MILLIMETRES, told_units
from stages.scans.reading.files import (
    COLOR_FOLDERS,
    DEPTH_FOLDERS,
    DEPTHS,
    IMAGES,
    common_size,
    first_existing,
    has,
    images,
)
from stages.scans.reading.layout import Layout
from stages.scans.reading.moments import nearest_in_time
from stages.scans.reading.moved import found_file
from stages.scans.reading.params import ReadingParams
from stages.scans.reading.stated import found_camera
from stages.scans.reading.timed_poses import poses_at
from stages.scans.scan import Camera, Frame, Pose, Scan, SkippedFrame, scaled
from stages.scans.world import Z_UP, WorldUp, up_of_layout

# The data set's own tools pair within 0.02 s, less than one frame at 30 Hz.
_TOLERANCE = 20_000_000
_SECOND = 1_000_000_000
_UNITS_PER_METRE = 5000.0
# The folder holds no intrinsics; which recording it is of tells the camera: fx fy cx cy, then k1 k2 p1 p2 k3.
_CAMERAS = {
    "freiburg1": ((517.3, 516.5, 318.6, 255.3), (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "freiburg2": ((520.9, 521.0, 325.1, 249.7), (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "freiburg3": ((535.4, 539.2, 320.1, 247.6), ()),
}
_ASSOCIATIONS = ("associations.txt", "associate.txt", "association.txt", "associated.txt")
# Which recording a file is of stands in its first lines: `# file: 'rgbd_dataset_freiburg1_rpy.bag'`.
_RECORDING = re.compile(r"^#\s*file:\s*['\"]?([^'\"\n]+)", re.MULTILINE)
_OWN = re.compile(r"rgbd_dataset_freiburg([123])(?!\d)")
_LIKE_OWN = re.compile(r"(?<![a-z])(?:freiburg|fr)_?[123](?!\d)", re.IGNORECASE)
_HEAD = 1000
# How images are named when their lists are lost.
_STAMPED = re.compile(r"\d+\.\d+")


@dataclass(frozen=True)
class _Stream:
    """The images of a stream, in the order they are listed: times in nanoseconds, and files."""

    times: NDArray[np.int64]
    files: list[Path]


def _matches(folder: Path) -> str | None:
    if has(folder, "rgb.txt", "depth.txt"):
        found = "rgb.txt and depth.txt"
    elif has(folder, "rgb") and (listed := first_existing(folder, *_ASSOCIATIONS)) is not None:
        found = f"rgb/ and {listed.name}"
    elif (stamped := _stamped(folder)) is not None:
        color, depth = (stream.files[0].parent.name for stream in stamped)
        found = f"{color}/ and {depth}/ with times for names"
    else:
        return None
    return found + (" with groundtruth.txt" if has(folder, "groundtruth.txt") else "")


def _read(folder: Path, options: ReadingParams) -> Scan:
    path = options.file("poses", folder) or first_existing(folder, "groundtruth.txt")
    color_stream, depth_stream, warnings = _streams(folder)
    colors, depths = color_stream.files, depth_stream.files
    camera, scale, about_camera = _camera(folder, options, depths)
    warnings += about_camera

    frames: list[Frame] = []
    partners = nearest_in_time(color_stream.times, depth_stream.times, _TOLERANCE).tolist()
    skipped = [
        SkippedFrame(color.stem, "no depth frame within 0.02 s")
        for color, partner in zip(colors, partners, strict=True)
        if partner < 0
    ]
    paired = [number for number, partner in enumerate(partners) if partner >= 0]
    # The surface is where the depth camera saw it from, so its moment decides.
    moments = [int(depth_stream.times[partners[number]]) for number in paired]
    names = [colors[number].stem for number in paired]
    poses: list[Pose | None] = [None] * len(paired)
    if path is not None:
        poses = poses_at(path, moments, names, _TOLERANCE, options)
    elif (found := _poses_beside(folder, moments, names, options)) is not None:
        path, poses, said = found
        warnings.append(said)
    for number, pose in zip(paired, poses, strict=True):
        color, partner, time = colors[number], partners[number], int(color_stream.times[number])
        if pose is None and path is not None:
            skipped.append(SkippedFrame(color.stem, "no pose within 0.02 s"))
            continue
        frames.append(
            Frame(
                name=color.stem,
                camera=camera,
                color=color,
                depth=depths[partner],
                depth_scale=scale,
                world_from_camera=pose,
                timestamp=time,
            )
        )
    lacking = "poses: groundtruth.txt is missing; name a trajectory with scan.poses=FILE"
    missing = (lacking,) if path is None else ()
    up = None if path is None else _up(folder, path)
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), tuple(warnings), missing, up=up)


def _poses_beside(
    folder: Path, moments: Sequence[int], names: Sequence[str], options: ReadingParams
) -> tuple[Path, list[Pose | None], str] | None:
    """Return the only file that holds as many poses as frames, the poses, and what is to be said of them.

    None without one, and where its times are others than those of the frames, unless these only count them.
    """
    path = trajectory_beside(folder, len(names))
    if path is None:
        return None
    said = f"the poses are read from {path.name}, which lies beside the images"
    if set(np.diff(moments)) == {_SECOND}:
        said = f"{said}; the images' times only count them, so poses are taken in their order"
        options = replace(options, poses_by_order=True)
    try:
        return path, poses_at(path, moments, names, _TOLERANCE, options), said
    except InputError:
        return None


def _up(folder: Path, trajectory: Path) -> WorldUp | None:
    """Return what is up in the worlds of the data set's motion capture; None where others use its form."""
    is_own = _data_set_camera(folder)[0] is not None or _OWN.search(documents.read_text(trajectory)[:_HEAD])
    return up_of_layout(LAYOUT.name, Z_UP) if is_own else None


def _streams(folder: Path) -> tuple[_Stream, _Stream, list[str]]:
    """Return colour and depth, and what is to be said about them."""
    if has(folder, "rgb.txt", "depth.txt"):
        color, depth = (_listed(folder / name) for name in ("rgb.txt", "depth.txt"))
    elif (listed := first_existing(folder, *_ASSOCIATIONS)) is not None:
        couples = read_associations(listed)
        color = _Stream(np.array([one.color_time for one in couples]), [one.color for one in couples])
        depth = _Stream(np.array([one.depth_time for one in couples]), [one.depth for one in couples])
    elif (stamped := _stamped(folder)) is not None:
        said = "there are no lists rgb.txt and depth.txt: the images are paired by the times in their names"
        return *stamped, [said]
    else:
        raise InputError("rgb.txt and depth.txt, or images named by their times, are needed.", folder)
    colors, about_colors = _where_they_are(color.files, folder)
    depths, about_depths = _where_they_are(depth.files, folder)
    return replace(color, files=colors), replace(depth, files=depths), about_colors + about_depths


def _listed(path: Path) -> _Stream:
    """Return a stream from lines `seconds file`."""
    times, files = [], []
    for number, text in documents.lines(path):
        words = re.split(r"[\s;]+|,(?=\s*[^\d\s])", text, maxsplit=1)
        if len(words) != 2:
            raise InputError(f"line {number} is not `seconds file`.", path)
        times.append(trajectories.stamp(words[0].rstrip(","), path, number))
        files.append(_listed_file(words[1].strip(" ,;"), path, number))
    if not files:
        raise InputError("it lists no images.", path)
    return _Stream(np.array(times, np.int64), files)


def _listed_file(name: str, path: Path, number: int) -> Path:
    """Return the file that a line names; where its path is one of another computer, by the path's end."""
    if PurePosixPath(name).is_absolute() or PureWindowsPath(name).is_absolute():
        return found_file(path.parent, name, f"line {number}: {name[:100]!r}", path)
    return path.parent / documents.require_inside(name, path, f"line {number}")


def _stamped(folder: Path) -> tuple[_Stream, _Stream] | None:
    """Return the streams of two folders whose images are named by their times in seconds."""
    streams = []
    for names, suffixes in ((COLOR_FOLDERS, IMAGES), (DEPTH_FOLDERS, DEPTHS)):
        place = first_existing(folder, *names)
        files = images(place, suffixes) if place is not None and place.is_dir() else []
        if not files or not all(_STAMPED.fullmatch(path.stem) for path in files):
            return None
        times = [trajectories.stamp(path.stem, path, 1) for path in files]
        streams.append(_Stream(np.array(times, np.int64), files))
    return streams[0], streams[1]


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


def _recorded_as(folder: Path) -> str | None:
    """Return the recording that the lists name in their first lines; None where they name none."""
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt"):
        head = documents.read_text(folder / name)[:_HEAD] if (folder / name).is_file() else ""
        if named := _RECORDING.search(head):
            return named[1]
    return None


def _data_set_camera(folder: Path) -> tuple[str | None, str]:
    """Return which of the data set's cameras took the images, and what says so.

    What the lists say counts. The folder's name does only where they say nothing, and only as the data set
    gives it: anyone's recording may lie in a folder that is called freiburg1.
    """
    recorded = _recorded_as(folder)
    named = _OWN.match(folder.resolve().name if recorded is None else recorded)
    source = "the folder's name" if recorded is None else "the name of the recording in its lists"
    return (None if named is None else f"freiburg{named[1]}"), source


def _camera(folder: Path, options: ReadingParams, depths: Sequence[Path]) -> tuple[Camera, float, list[str]]:
    """Return the camera, the depth scale, and what is to be said about them."""
    width, height = common_size(depths)
    own, source = _data_set_camera(folder)
    path = options.file("calibration", folder) or first_existing(folder, "camera.json", "intrinsic.json")
    camera = options.camera(width, height)
    warnings: list[str] = []
    if camera is None and path is not None:
        camera = calibration.read_camera(path, width, height)
    elif camera is None:
        camera, path, warnings = found_camera(folder, width, height)
        if path is None and own is not None:
            matrix, distortion = _CAMERAS[own]
            camera = scaled(Camera(640, 480, *matrix, distortion), width, height)
            warnings = [f"the camera is {own}'s, by {source}"]
        elif path is None and _LIKE_OWN.search(folder.resolve().name):
            warnings.append(
                "the folder's name is like one of the TUM data set, but nothing in it says that it is: its "
                "lens is not taken from the name"
            )
    stated = path and calibration.read_depth_scale(path)
    scale = options.depth_scale or stated or (None if own is None else _UNITS_PER_METRE)
    if scale is None:
        scale, about_scale = _scale(depths)
        warnings += about_scale
    return camera, scale, warnings


def _scale(depths: Sequence[Path]) -> tuple[float, list[str]]:
    """Return the units a metre of depth that nothing states, and what is to be said about them."""
    told = told_units(depths)
    if told == MILLIMETRES:
        said = (
            f"depth is taken as millimetres: in TUM's {_UNITS_PER_METRE:g} units a metre half of it would be "
            f"nearer than a Kinect sees; where it is, set scan.depth_scale={_UNITS_PER_METRE:g}"
        )
        return told, [said]
    if told is None:
        said = (
            f"depth is taken as TUM's {_UNITS_PER_METRE:g} units a metre; where it is in millimetres set "
            "scan.depth_scale=1000"
        )
        return _UNITS_PER_METRE, [said]
    return told, []


LAYOUT = Layout(
    name="tum",
    text="rgb.txt and depth.txt (or associations.txt, or images named by their times), groundtruth.txt "
    "(TUM RGB-D)",
    matches=_matches,
    read=_read,
)
