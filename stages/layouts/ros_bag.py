"""A recording in one file, depth and colour each with its own clock: RealSense's, or a ROS 1 bag."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stages.errors import InputError
from stages.formats import trajectories
from stages.formats.ros_bag import RosBag, read_bag
from stages.formats.ros_db3 import read_db3
from stages.layouts.layout import Layout
from stages.layouts.moments import nearest_in_time
from stages.layouts.realsense_bag import realsense_bag
from stages.layouts.realsense_db3 import realsense_db3
from stages.layouts.realsense_streams import realsense_streams
from stages.layouts.refused import ROS_2
from stages.layouts.ros_streams import ros_streams
from stages.layouts.streams import Images, Streams
from stages.scan import Frame, Packed, Pose, Scan, SkippedFrame

if TYPE_CHECKING:
    from stages.layouts.params import ScanParams

_SUFFIXES = (".bag", ".db3")
# Of the shorter interval between images: the nearest image of that stream is never more than half of it away.
_TOLERANCE = 0.6
# Nanoseconds; for a stream of one image, and for a trajectory from elsewhere.
_FALLBACK_TOLERANCE = 20_000_000


def _matches(folder: Path) -> str | None:
    return next((file.name for file in _recordings(folder)), None)


def _read(place: Path, options: ScanParams) -> Scan:
    path = place if place.is_file() else _only_one(place)
    streams, fault = _of_db3(path, options) if path.suffix.lower() == ".db3" else _of_bag(path, options)
    warnings = list(streams.warnings)
    if fault is not None:
        warnings.append(f"the recording was not closed or is damaged ({fault}): what comes before is used")
    depths, skipped = _stamps(streams.depth.images)
    color = streams.color
    if color is None:
        couples: list[tuple[int, int | None]] = [(number, None) for number in depths]
    else:
        colors, damaged = _stamps(color.images)
        skipped += damaged
        if _have_other_clocks(depths, colors):
            depths = {number: int(streams.depth.images.recorded[number]) for number in depths}
            colors = {number: int(color.images.recorded[number]) for number in colors}
            warnings.append(
                "the clocks of depth and colour do not agree at all: images are paired by when they were "
                "recorded"
            )
        couples = _couples(depths, colors)
        if len(couples) < max(len(depths), len(colors)):
            warnings.append(
                f"{len(couples)} of {len(depths)} depth maps and of {len(colors)} colour images are of one "
                "moment: the others are left out"
            )
    if not couples:
        first = f" ({skipped[0].name}: {skipped[0].reason})" if skipped else ""
        raise InputError(f"no depth map and colour image in it are of one moment{first}.", path)
    couples.sort(key=lambda couple: depths[couple[0]])
    poses, missing = _poses(options, place, [(number, depths[number]) for number, _ in couples])
    frames: list[Frame] = []
    for (number, partner), pose in zip(couples, poses, strict=True):
        frames.append(
            Frame(
                name=_name(number),
                camera=streams.depth.camera,
                color=None if color is None or partner is None else _color(path, color.images, partner),
                depth=_depth(path, streams.depth.images, number),
                depth_scale=streams.depth_scale,
                world_from_camera=pose,
                timestamp=depths[number],
                color_camera=None if color is None else color.camera,
                color_from_depth=streams.color_from_depth,
            )
        )
    return Scan(LAYOUT.name, frames, None, place, tuple(skipped), tuple(warnings), missing)


def _of_bag(path: Path, options: ScanParams) -> tuple[Streams, str | None]:
    """Return the streams of a bag, and why the rest of it could not be read, if so."""
    bag = read_bag(path)
    recording = realsense_bag(bag)
    streams = ros_streams(bag, options) if recording is None else realsense_streams(recording, options)
    if streams is None:
        raise InputError(_without_depth(bag), path)
    return streams, bag.fault


def _of_db3(path: Path, options: ScanParams) -> tuple[Streams, None]:
    recording = realsense_db3(read_db3(path))
    if recording is None:
        raise InputError(f"it is no recording of a RealSense camera, but of ROS 2's own. {ROS_2}", path)
    return realsense_streams(recording, options), None


def _recordings(folder: Path) -> list[Path]:
    return sorted(file for suffix in _SUFFIXES for file in folder.glob(f"*{suffix}"))


def _only_one(folder: Path) -> Path:
    files = _recordings(folder)
    if len(files) != 1:
        found = "there is no recording (.bag, .db3)" if not files else f"there are {len(files)} recordings"
        raise InputError(f"{found} in it; give the one to read.", folder)
    return files[0]


def _without_depth(bag: RosBag) -> str:
    """Say what a bag without depth holds."""
    if not bag.topics:
        why = f" ({bag.fault})" if bag.fault else ""
        return f"not one message in it can be read{why}; copy it again, or record it anew."
    shown = ", ".join(sorted(bag.topics)[:8]) + (", …" if len(bag.topics) > 8 else "")
    return (
        "there are no depth images in it (sensor_msgs/Image of 16UC1 or 32FC1, `depth` in the topic's name), "
        f"only {shown}. Record the depth topic too."
    )


def _stamps(images: Images) -> tuple[dict[int, int], list[SkippedFrame]]:
    """Return when each image was taken, nanoseconds by its number in the stream, and which are damaged."""
    times: dict[int, int] = {}
    damaged = []
    for number in range(len(images.recorded)):
        time = _stamp_or_fault(images, number)
        if isinstance(time, InputError):
            damaged.append(SkippedFrame(f"{images.name} {_name(number)}", str(time)))
        else:
            times[number] = time
    return times, damaged


def _stamp_or_fault(images: Images, number: int) -> int | InputError:
    try:
        return images.stamp(number)
    except InputError as error:
        return error


def _have_other_clocks(depths: Mapping[int, int], colors: Mapping[int, int]) -> bool:
    """Say whether two streams that were recorded together claim to be of times that do not overlap at all."""
    if not depths or not colors:
        return False
    apart = max(min(depths.values()), min(colors.values())) - min(max(depths.values()), max(colors.values()))
    return apart > _tolerance(depths, colors)


def _tolerance(*streams: Mapping[int, int]) -> int:
    intervals = [np.median(np.diff(sorted(times.values()))) for times in streams if len(times) > 1]
    return round(_TOLERANCE * min(intervals)) if intervals else _FALLBACK_TOLERANCE


def _couples(depths: Mapping[int, int], colors: Mapping[int, int]) -> list[tuple[int, int | None]]:
    """Return the numbers of the depth maps and colour images that are of one moment."""
    numbers, others = list(depths), list(colors)
    color_times, depth_times = (
        np.fromiter(stream.values(), np.int64, len(stream)) for stream in (colors, depths)
    )
    partners = nearest_in_time(color_times, depth_times, _tolerance(depths, colors))
    return [(numbers[partner], others[at]) for at, partner in enumerate(partners.tolist()) if partner >= 0]


def _poses(
    options: ScanParams, place: Path, moments: Sequence[tuple[int, int]]
) -> tuple[Sequence[Pose | None], tuple[str, ...]]:
    """Return the pose of each frame, given by its number and time, and what is missing."""
    given = options.file("poses", place.parent if place.is_file() else place)
    if given is None:
        return [None] * len(moments), ("poses: a recording has none; name a trajectory with scan.poses=FILE",)
    trajectory = trajectories.in_order(trajectories.read_trajectory(given))
    if trajectory.timestamps is None:
        return trajectories.match(trajectory, [_name(number) for number, _ in moments], given), ()
    poses = [trajectories.interpolate(trajectory, time, _FALLBACK_TOLERANCE) for _, time in moments]
    if all(pose is None for pose in poses):
        start, end = moments[0][1] / 1e9, moments[-1][1] / 1e9
        raise InputError(
            f"none of its poses is within 0.02 s of a frame; the recording is of {start:.3f} to {end:.3f} s.",
            given,
        )
    return poses, ()


def _name(number: int) -> str:
    return f"{number:06d}"


def _color(path: Path, images: Images, number: int) -> Packed:
    return Packed(path, f"{images.name} {_name(number)}", partial(images.color, number))


def _depth(path: Path, images: Images, number: int) -> Packed:
    return Packed(path, f"{images.name} {_name(number)}", partial(images.depth, number))


LAYOUT = Layout(
    name="ros-bag",
    text="one .bag or .db3 file, or a folder with one (RealSense; ROS 1 with depth and camera_info)",
    matches=_matches,
    read=_read,
    suffixes=_SUFFIXES,
)
