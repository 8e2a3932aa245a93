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
from scanloom.stages.scans.image_folders.timestamp_matching import match_timestamps
from scanloom.stages.scans.layouts.shared.gravity import estimate_up_directions
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Frame, PackedImage, Pose, Scan, SkippedFrame
from scanloom.stages.scans.recordings.bag import read_bag
from scanloom.stages.scans.recordings.db3 import read_db3
from scanloom.stages.scans.recordings.depth_topics import select_topic_streams
from scanloom.stages.scans.recordings.mcap import read_mcap
from scanloom.stages.scans.recordings.realsense.bag import parse_realsense_bag
from scanloom.stages.scans.recordings.realsense.db3 import parse_realsense_db3
from scanloom.stages.scans.recordings.realsense.stream_selection import (
    RealSenseRecording,
    select_realsense_streams,
)
from scanloom.stages.scans.recordings.recording import Recording, join_recordings
from scanloom.stages.scans.recordings.recording_files import (
    RECORDING_SUFFIXES,
    find_recording_files,
    list_recordings,
)
from scanloom.stages.scans.recordings.stereo_topics import find_stereo_topics
from scanloom.stages.scans.streams.timestamped_streams import (
    DepthColorStreams,
    StereoStreams,
    TimestampedImages,
)
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories
from scanloom.stages.scans.trajectory.timed_poses import match_poses_by_time

# Matching tolerance as a ratio of the shorter frame interval: the nearest image of that stream is at most
# half an interval away.
_TOLERANCE_RATIO = 0.6
# Nanoseconds; for a stream with a single image, and for external trajectories.
_FALLBACK_TOLERANCE_NS = 20_000_000


_READERS = {".bag": read_bag, ".db3": read_db3, ".mcap": read_mcap}


def _matches(folder: Path) -> str | None:
    return next((file.name for file in list_recordings(folder)), None)


def _read(source: Path, options: ReadingParams) -> Scan:
    streams, fault = _read_streams(source, options)
    if fault is not None:
        emit(
            RECORDING_DAMAGED.warning(
                "the recording is incomplete or damaged ({fault}); the data before this point is used",
                fault=fault,
            )
        )
    first: TimestampedImages
    second: TimestampedImages | None
    if isinstance(streams, StereoStreams):
        first, second, labels = streams.left, streams.right, ("left images", "right images")
    else:
        first, second = streams.depth.images, None if streams.color is None else streams.color.images
        labels = "depth maps", "colour images"
    matches, skipped = _match_images(first, second, labels)
    if not matches:
        why = f" ({skipped[0].name}: {skipped[0].reason})" if skipped else ""
        raise InputError(
            RECORDING_CLOCKS_DIFFER,
            "no {called} and {called_2} were captured at the same time{why}.",
            source,
            called=labels[0][:-1],
            called_2=labels[1][:-1],
            why=why,
        )
    poses, missing = _read_poses(options, source, [(number, time) for number, time, _ in matches])
    recorded = first.record_times_ns[[number for number, _, _ in matches]]
    ups = estimate_up_directions(streams.accelerometer, recorded)
    frames = [
        replace(
            _create_stereo_frame(streams, *couple, pose)
            if isinstance(streams, StereoStreams)
            else _create_depth_frame(streams, *couple, pose),
            up=up,
        )
        for couple, pose, up in zip(matches, poses, ups, strict=True)
    ]
    rig = streams.rig if isinstance(streams, StereoStreams) else None
    return Scan(LAYOUT.name, frames, rig, source, tuple(skipped), missing=missing)


def _read_streams(
    source: Path, options: ReadingParams
) -> tuple[DepthColorStreams | StereoStreams, str | None]:
    """Return the streams of a recording, and a fault or None.

    The fault is the reason why part of the recording is unreadable.
    """
    recording, camera = _read_recording(find_recording_files(source), source)
    if camera is not None:
        return select_realsense_streams(camera, options), recording.fault
    streams = select_topic_streams(recording, options) or find_stereo_topics(recording, options)
    if streams is None:
        raise InputError(RECORDING_TOPIC_MISSING, _describe_without_images(recording), source)
    return streams, recording.fault


def _read_recording(files: Sequence[Path], source: Path) -> tuple[Recording, RealSenseRecording | None]:
    """Read the files of a recording.

    The second result interprets it as a RealSense recording; None if it is not one.
    """
    parts = [_READERS.get(file.suffix.lower(), read_bag)(file) for file in files]
    recording = parts[0] if len(parts) == 1 else join_recordings(source, parts)
    suffix = files[0].suffix.lower()
    if suffix == ".db3" and len(files) == 1:
        return recording, parse_realsense_db3(recording)
    return recording, parse_realsense_bag(recording) if suffix == ".bag" else None


def _describe_without_images(recording: Recording) -> str:
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


def _match_images(
    first: TimestampedImages, second: TimestampedImages | None, labels: tuple[str, str]
) -> tuple[list[tuple[int, int, int | None]], list[SkippedFrame]]:
    """Match the images of two streams by time.

    Parameters
    ----------
    labels : names of the images of both streams in messages.

    Returns
    -------
    list of (index, time, partner)
        Sorted by time (ns). `partner` is an index into the second stream, or None without such a stream.
    list of SkippedFrame
        Images whose timestamp is unreadable.
    """
    times, skipped = _read_timestamps(first)
    if second is None:
        alone = sorted(times.items(), key=lambda entry: entry[1])
        return [(number, time, None) for number, time in alone], skipped
    others, damaged = _read_timestamps(second)
    skipped += damaged
    if _has_disjoint_times(times, others):
        times = {number: int(first.record_times_ns[number]) for number in times}
        others = {number: int(second.record_times_ns[number]) for number in others}
        emit(
            RECORDING_CLOCKS_DIFFER.warning(
                "the clocks of {first} and {second} do not overlap: images are matched by recording time",
                first=labels[0],
                second=labels[1],
            )
        )
    matches = _match_by_time(times, others)
    if len(matches) < max(len(times), len(others)):
        emit(
            RECORDING_CLOCKS_DIFFER.warning(
                "only {count} of {first_count} {first} and {second_count} {second} match in time: the "
                "others are skipped",
                count=len(matches),
                first_count=len(times),
                first=labels[0],
                second_count=len(others),
                second=labels[1],
            )
        )
    matches.sort(key=lambda couple: times[couple[0]])
    return [(number, times[number], partner) for number, partner in matches], skipped


def _create_depth_frame(
    streams: DepthColorStreams, number: int, time: int, partner: int | None, pose: Pose | None
) -> Frame:
    color = streams.color
    return Frame(
        name=_format_name(number),
        camera=streams.depth.camera,
        color=None if color is None or partner is None else _wrap_color(color.images, partner),
        depth=_wrap_depth(streams.depth.images, number),
        depth_scale=streams.depth_scale,
        world_from_camera=pose,
        timestamp=time,
        color_camera=None if color is None else color.camera,
        color_from_depth=streams.color_from_depth,
    )


def _create_stereo_frame(
    pair: StereoStreams, number: int, time: int, partner: int | None, pose: Pose | None
) -> Frame:
    return Frame(
        name=_format_name(number),
        camera=pair.rig.left,
        color=_wrap_color(pair.left, number),
        right=None if partner is None else _wrap_color(pair.right, partner),
        world_from_camera=pose,
        timestamp=time,
    )


def _read_timestamps(images: TimestampedImages) -> tuple[dict[int, int], list[SkippedFrame]]:
    """Return the capture times (ns) of readable images, and damaged images.

    The times are by number of the image in the stream.
    """
    times: dict[int, int] = {}
    damaged = []
    for number in range(len(images.record_times_ns)):
        time = _read_timestamp_or_error(images, number)
        if isinstance(time, InputError):
            damaged.append(SkippedFrame(f"{images.name} {_format_name(number)}", time.diagnostic))
        else:
            times[number] = time
    return times, damaged


def _read_timestamp_or_error(images: TimestampedImages, number: int) -> int | InputError:
    try:
        return images.read_timestamp(number)
    except InputError as error:
        return error


def _has_disjoint_times(first: Mapping[int, int], second: Mapping[int, int]) -> bool:
    """Return True if the time ranges of two streams are disjoint.

    Streams that were recorded together then have different clocks.
    """
    if not first or not second:
        return False
    apart = max(min(first.values()), min(second.values())) - min(max(first.values()), max(second.values()))
    return apart > _compute_tolerance(first, second)


def _compute_tolerance(*streams: Mapping[int, int]) -> int:
    intervals = [np.median(np.diff(sorted(times.values()))) for times in streams if len(times) > 1]
    return round(_TOLERANCE_RATIO * min(intervals)) if intervals else _FALLBACK_TOLERANCE_NS


def _match_by_time(first: Mapping[int, int], second: Mapping[int, int]) -> list[tuple[int, int]]:
    """Match the images of two streams by time.

    Returns pairs of image numbers.
    """
    numbers, others = list(first), list(second)
    times, other_times = (np.fromiter(one.values(), np.int64, len(one)) for one in (first, second))
    partners = match_timestamps(other_times, times, _compute_tolerance(first, second))
    return [(numbers[partner], others[at]) for at, partner in enumerate(partners.tolist()) if partner >= 0]


def _read_poses(
    options: ReadingParams, source: Path, moments: Sequence[tuple[int, int]]
) -> tuple[Sequence[Pose | None], tuple[Diagnostic, ...]]:
    """Return the pose of each frame, and the diagnostics of missing poses.

    Parameters
    ----------
    moments : number and time (ns) of each frame.
    """
    given = options.resolve_file("poses", source.parent if source.is_file() else source)
    if given is None:
        return [None] * len(moments), (describe_missing_poses("recordings contain no poses"),)
    names = [_format_name(number) for number, _ in moments]
    trajectory = trajectories.read_trajectory(given)
    if trajectory.timestamps is None:
        return trajectories.match_poses_to_frames(trajectory, names, given), ()
    return match_poses_by_time(
        given, [time for _, time in moments], names, _FALLBACK_TOLERANCE_NS, options
    ), ()


def _format_name(number: int) -> str:
    return f"{number:06d}"


def _wrap_color(images: TimestampedImages, number: int) -> PackedImage:
    return PackedImage(
        images.find_file(number), f"{images.name} {_format_name(number)}", partial(images.read_color, number)
    )


def _wrap_depth(images: TimestampedImages, number: int) -> PackedImage:
    return PackedImage(
        images.find_file(number), f"{images.name} {_format_name(number)}", partial(images.read_depth, number)
    )


LAYOUT = Layout(
    name="ros-bag",
    description="one .bag, .db3 or .mcap file, or a folder with one (RealSense; ROS 1 or 2 with "
    "camera_info and depth, or with a stereo pair)",
    matches=_matches,
    read=_read,
    suffixes=RECORDING_SUFFIXES,
)
