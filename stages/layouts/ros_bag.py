"""A recording in one `.bag` file: RealSense's or ROS 1's, depth and colour each with its own clock."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError
from stages.formats import trajectories
from stages.formats.ros_bag import RosBag, Topic, read_bag, read_message
from stages.formats.ros_messages import STAMP_BYTES, read_stamp
from stages.layouts.layout import Layout
from stages.layouts.moments import nearest_in_time
from stages.layouts.realsense_streams import realsense_streams
from stages.layouts.ros_streams import ros_streams
from stages.layouts.streams import Stream, load_color, load_depth
from stages.scan import Frame, Packed, Pose, Scan, SkippedFrame

if TYPE_CHECKING:
    from stages.layouts.params import ScanParams

# Of the shorter interval between images: the nearest image of that stream is never more than half of it away.
_TOLERANCE = 0.6
# Nanoseconds; for a stream of one image, and for a trajectory from elsewhere.
_FALLBACK_TOLERANCE = 20_000_000


def _matches(folder: Path) -> str | None:
    return next((file.name for file in sorted(folder.glob("*.bag"))), None)


def _read(place: Path, options: ScanParams) -> Scan:
    path = place if place.is_file() else _only_bag(place)
    bag = read_bag(path)
    streams = realsense_streams(bag, options) or ros_streams(bag, options)
    if streams is None:
        raise InputError(_unknown(bag), path)
    warnings = list(streams.warnings)
    if bag.fault is not None:
        warnings.append(
            f"the recording was not closed or is damaged ({bag.fault}): what comes before is used"
        )
    depths, skipped = _stamps(bag, streams.depth)
    color = streams.color
    if color is None:
        couples: list[tuple[int, int | None]] = [(number, None) for number in depths]
    else:
        colors, damaged = _stamps(bag, color)
        skipped += damaged
        if _have_other_clocks(depths, colors):
            depths = {number: int(streams.depth.topic.times[number]) for number in depths}
            colors = {number: int(color.topic.times[number]) for number in colors}
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
                color=None if color is None or partner is None else _packed(bag, color, partner, load_color),
                depth=_packed(bag, streams.depth, number, load_depth),
                depth_scale=streams.depth_scale,
                world_from_camera=pose,
                timestamp=depths[number],
                color_camera=None if color is None else color.camera,
                color_from_depth=streams.color_from_depth,
            )
        )
    return Scan(LAYOUT.name, frames, None, place, tuple(skipped), tuple(warnings), missing)


def _only_bag(folder: Path) -> Path:
    files = sorted(folder.glob("*.bag"))
    if len(files) != 1:
        found = "there is no .bag file" if not files else f"there are {len(files)} .bag files"
        raise InputError(f"{found} in it; give the one to read.", folder)
    return files[0]


def _unknown(bag: RosBag) -> str:
    """Say what a bag without depth holds."""
    if not bag.topics:
        why = f" ({bag.fault})" if bag.fault else ""
        return f"not one message in it can be read{why}; copy it again, or record it anew."
    shown = ", ".join(sorted(bag.topics)[:8]) + (", …" if len(bag.topics) > 8 else "")
    return (
        "there are no depth images in it (sensor_msgs/Image of 16UC1 or 32FC1, `depth` in the topic's name), "
        f"only {shown}. Record the depth topic too."
    )


def _stamps(bag: RosBag, stream: Stream) -> tuple[dict[int, int], list[SkippedFrame]]:
    """Return when each image was taken, nanoseconds by its number in the stream, and which are damaged."""
    times: dict[int, int] = {}
    damaged = []
    for number in range(len(stream.topic)):
        time = _stamp_or_fault(bag, stream.topic, number)
        if isinstance(time, InputError):
            damaged.append(SkippedFrame(f"{stream.name} {_name(number)}", str(time)))
        else:
            times[number] = time
    return times, damaged


def _stamp_or_fault(bag: RosBag, topic: Topic, number: int) -> int | InputError:
    try:
        return read_stamp(read_message(bag, topic, number, first=STAMP_BYTES), bag.path)
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


def _packed(
    bag: RosBag, stream: Stream, number: int, load: Callable[[RosBag, Topic, int, str], NDArray[Any]]
) -> Packed:
    name = f"{stream.name} {_name(number)}"
    return Packed(bag.path, name, partial(load, bag, stream.topic, number, f"{bag.path}: {name}"))


LAYOUT = Layout(
    name="ros-bag",
    text="one .bag file, or a folder with one (RealSense, or ROS 1 with depth and camera_info)",
    matches=_matches,
    read=_read,
    suffixes=(".bag",),
)
