"""RealSense, ROS 1 and ROS 2 recordings: streams with independent clocks.

Depth and colour images, or the two views of a stereo pair, are matched by capture time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import RECORDING_DAMAGED
from scanloom.stages.scans.codes import RECORDING_CLOCKS_DIFFER, RECORDING_TOPIC_MISSING
from scanloom.stages.scans.image_folders.timestamp_matching import nearest_in_time
from scanloom.stages.scans.layouts.shared.gravity import ups_of
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.lacking import poses_missing
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Frame, Packed, Pose, Scan, SkippedFrame
from scanloom.stages.scans.recordings.bag import read_bag
from scanloom.stages.scans.recordings.db3 import read_db3
from scanloom.stages.scans.recordings.files import SUFFIXES, recording_files, recordings
from scanloom.stages.scans.recordings.mcap import read_mcap
from scanloom.stages.scans.recordings.pairs import topic_pair
from scanloom.stages.scans.recordings.realsense.bag import realsense_bag
from scanloom.stages.scans.recordings.realsense.db3 import realsense_db3
from scanloom.stages.scans.recordings.realsense.streams import RealSense, realsense_streams
from scanloom.stages.scans.recordings.recording import Recording, joined
from scanloom.stages.scans.recordings.streams import topic_streams
from scanloom.stages.scans.streams.clocked_streams import Images, Pair, Streams
from scanloom.stages.scans.trajectory import files as trajectories
from scanloom.stages.scans.trajectory.timed_poses import poses_at

# Matching tolerance as a ratio of the shorter frame interval: the nearest image of that stream is at most
# half an interval away.
_TOLERANCE = 0.6
# Nanoseconds; for a stream with a single image, and for external trajectories.
_FALLBACK_TOLERANCE = 20_000_000


_READERS = {".bag": read_bag, ".db3": read_db3, ".mcap": read_mcap}


def _matches(folder: Path) -> str | None:
    return next((file.name for file in recordings(folder)), None)


def _read(place: Path, options: ReadingParams) -> Scan:
    streams, fault = _streams(place, options)
    if fault is not None:
        emit(
            RECORDING_DAMAGED.warning(
                "the recording is incomplete or damaged ({fault}); the data before this point is used",
                fault=fault,
            )
        )
    first: Images
    second: Images | None
    if isinstance(streams, Pair):
        first, second, called = streams.left, streams.right, ("left images", "right images")
    else:
        first, second = streams.depth.images, None if streams.color is None else streams.color.images
        called = "depth maps", "colour images"
    couples, skipped = _couples(first, second, called)
    if not couples:
        why = f" ({skipped[0].name}: {skipped[0].reason})" if skipped else ""
        raise InputError(
            RECORDING_CLOCKS_DIFFER,
            "no {called} and {called_2} were captured at the same time{why}.",
            place,
            called=called[0][:-1],
            called_2=called[1][:-1],
            why=why,
        )
    poses, missing = _poses(options, place, [(number, time) for number, time, _ in couples])
    recorded = first.recorded[[number for number, _, _ in couples]]
    ups = ups_of(streams.accelerometer, recorded)
    frames = [
        replace(
            _pair_frame(streams, *couple, pose)
            if isinstance(streams, Pair)
            else _depth_frame(streams, *couple, pose),
            up=up,
        )
        for couple, pose, up in zip(couples, poses, ups, strict=True)
    ]
    rig = streams.rig if isinstance(streams, Pair) else None
    return Scan(LAYOUT.name, frames, rig, place, tuple(skipped), missing=missing)


def _streams(place: Path, options: ReadingParams) -> tuple[Streams | Pair, str | None]:
    """Return the streams of a recording, and a fault or None.

    The fault is the reason why part of the recording is unreadable.
    """
    recording, camera = _recording(recording_files(place), place)
    if camera is not None:
        return realsense_streams(camera, options), recording.fault
    streams = topic_streams(recording, options) or topic_pair(recording, options)
    if streams is None:
        raise InputError(RECORDING_TOPIC_MISSING, _without_images(recording), place)
    return streams, recording.fault


def _recording(files: Sequence[Path], place: Path) -> tuple[Recording, RealSense | None]:
    """Read the files of a recording.

    The second result interprets it as a RealSense recording; None if it is not one.
    """
    parts = [_READERS.get(file.suffix.lower(), read_bag)(file) for file in files]
    recording = parts[0] if len(parts) == 1 else joined(place, parts)
    suffix = files[0].suffix.lower()
    if suffix == ".db3" and len(files) == 1:
        return recording, realsense_db3(recording)
    return recording, realsense_bag(recording) if suffix == ".bag" else None


def _without_images(recording: Recording) -> str:
    """Describe a recording that has neither depth nor a stereo pair."""
    if not recording.topics:
        why = f" ({recording.fault})" if recording.fault else ""
        return f"no message in the recording is readable{why}; copy the file again, or repeat the recording."
    shown = ", ".join(sorted(recording.topics)[:8]) + (", …" if len(recording.topics) > 8 else "")
    return (
        "the recording has neither depth images (sensor_msgs/Image with 16UC1 or 32FC1, `depth` "
        f"in the topic name) nor a left and a right image topic, only {shown}. Record the depth "
        "topic as well."
    )


def _couples(
    first: Images, second: Images | None, called: tuple[str, str]
) -> tuple[list[tuple[int, int, int | None]], list[SkippedFrame]]:
    """Match the images of two streams by time.

    Parameters
    ----------
    called : names of the images of both streams in messages.

    Returns
    -------
    list of (index, time, partner)
        Sorted by time (ns). `partner` is an index into the second stream, or None without such a stream.
    list of SkippedFrame
        Images whose timestamp is unreadable.
    """
    times, skipped = _stamps(first)
    if second is None:
        alone = sorted(times.items(), key=lambda entry: entry[1])
        return [(number, time, None) for number, time in alone], skipped
    others, damaged = _stamps(second)
    skipped += damaged
    if _have_other_clocks(times, others):
        times = {number: int(first.recorded[number]) for number in times}
        others = {number: int(second.recorded[number]) for number in others}
        emit(
            RECORDING_CLOCKS_DIFFER.warning(
                "the clocks of {first} and {second} do not overlap: images are matched by recording time",
                first=called[0],
                second=called[1],
            )
        )
    couples = _of_one_moment(times, others)
    if len(couples) < max(len(times), len(others)):
        emit(
            RECORDING_CLOCKS_DIFFER.warning(
                "only {count} of {first_count} {first} and {second_count} {second} match in time: the "
                "others are skipped",
                count=len(couples),
                first_count=len(times),
                first=called[0],
                second_count=len(others),
                second=called[1],
            )
        )
    couples.sort(key=lambda couple: times[couple[0]])
    return [(number, times[number], partner) for number, partner in couples], skipped


def _depth_frame(streams: Streams, number: int, time: int, partner: int | None, pose: Pose | None) -> Frame:
    color = streams.color
    return Frame(
        name=_name(number),
        camera=streams.depth.camera,
        color=None if color is None or partner is None else _color(color.images, partner),
        depth=_depth(streams.depth.images, number),
        depth_scale=streams.depth_scale,
        world_from_camera=pose,
        timestamp=time,
        color_camera=None if color is None else color.camera,
        color_from_depth=streams.color_from_depth,
    )


def _pair_frame(pair: Pair, number: int, time: int, partner: int | None, pose: Pose | None) -> Frame:
    return Frame(
        name=_name(number),
        camera=pair.rig.left,
        color=_color(pair.left, number),
        right=None if partner is None else _color(pair.right, partner),
        world_from_camera=pose,
        timestamp=time,
    )


def _stamps(images: Images) -> tuple[dict[int, int], list[SkippedFrame]]:
    """Return the capture times (ns) of readable images, and damaged images.

    The times are by number of the image in the stream.
    """
    times: dict[int, int] = {}
    damaged = []
    for number in range(len(images.recorded)):
        time = _stamp_or_fault(images, number)
        if isinstance(time, InputError):
            damaged.append(SkippedFrame(f"{images.name} {_name(number)}", time.diagnostic))
        else:
            times[number] = time
    return times, damaged


def _stamp_or_fault(images: Images, number: int) -> int | InputError:
    try:
        return images.stamp(number)
    except InputError as error:
        return error


def _have_other_clocks(first: Mapping[int, int], second: Mapping[int, int]) -> bool:
    """Return True if the time ranges of two streams are disjoint.

    Streams that were recorded together then have different clocks.
    """
    if not first or not second:
        return False
    apart = max(min(first.values()), min(second.values())) - min(max(first.values()), max(second.values()))
    return apart > _tolerance(first, second)


def _tolerance(*streams: Mapping[int, int]) -> int:
    intervals = [np.median(np.diff(sorted(times.values()))) for times in streams if len(times) > 1]
    return round(_TOLERANCE * min(intervals)) if intervals else _FALLBACK_TOLERANCE


def _of_one_moment(first: Mapping[int, int], second: Mapping[int, int]) -> list[tuple[int, int]]:
    """Match the images of two streams by time.

    Returns pairs of image numbers.
    """
    numbers, others = list(first), list(second)
    times, other_times = (np.fromiter(one.values(), np.int64, len(one)) for one in (first, second))
    partners = nearest_in_time(other_times, times, _tolerance(first, second))
    return [(numbers[partner], others[at]) for at, partner in enumerate(partners.tolist()) if partner >= 0]


def _poses(
    options: ReadingParams, place: Path, moments: Sequence[tuple[int, int]]
) -> tuple[Sequence[Pose | None], tuple[Diagnostic, ...]]:
    """Return the pose of each frame, and the diagnostics of missing poses.

    Parameters
    ----------
    moments : number and time (ns) of each frame.
    """
    given = options.file("poses", place.parent if place.is_file() else place)
    if given is None:
        return [None] * len(moments), (poses_missing("recordings contain no poses"),)
    names = [_name(number) for number, _ in moments]
    trajectory = trajectories.read_trajectory(given)
    if trajectory.timestamps is None:
        return trajectories.match(trajectory, names, given), ()
    return poses_at(given, [time for _, time in moments], names, _FALLBACK_TOLERANCE, options), ()


def _name(number: int) -> str:
    return f"{number:06d}"


def _color(images: Images, number: int) -> Packed:
    return Packed(images.file(number), f"{images.name} {_name(number)}", partial(images.color, number))


def _depth(images: Images, number: int) -> Packed:
    return Packed(images.file(number), f"{images.name} {_name(number)}", partial(images.depth, number))


LAYOUT = Layout(
    name="ros-bag",
    text="one .bag, .db3 or .mcap file, or a folder with one (RealSense; ROS 1 or 2 with "
    "camera_info and depth, or with a stereo pair)",
    matches=_matches,
    read=_read,
    suffixes=SUFFIXES,
)
