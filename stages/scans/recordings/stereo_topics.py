"""Stereo pair of a ROS recording without depth.

Rectified images (`image_rect`) use the projection matrices P of their `camera_info`. Raw images use K
and D, with R and the right camera's P for the extrinsics. Drivers that omit the baseline from P publish
it in `/tf_static`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.calibration import rig_calibration
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_ASSUMED,
    CAMERA_PAIR_UNCALIBRATED,
    RECORDING_TOPIC_CHOSEN,
)
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import StereoRig
from scanloom.stages.scans.recordings.image_decoding import is_color
from scanloom.stages.scans.recordings.image_topics import (
    ImageTopic,
    find_accelerometer,
    find_transform,
    list_image_topics,
    read_camera_message,
)
from scanloom.stages.scans.recordings.messages import CameraMessage
from scanloom.stages.scans.recordings.recording import Recording
from scanloom.stages.scans.recordings.topic_images import wrap_topic_images
from scanloom.stages.scans.streams.stereo_rigs import read_stated_rig
from scanloom.stages.scans.streams.timestamped_streams import StereoStreams

# RealSense numbers its infrared cameras; the first is the left one.
_SIDE_NAMES = (("left", "right"), ("infra1", "infra2"), ("infrared1", "infrared2"), ("cam0", "cam1"))


def find_stereo_topics(recording: Recording, options: ReadingParams) -> StereoStreams | None:
    """Return the stereo pair of a ROS recording, or None.

    Raises
    ------
    InputError
        If the calibration of the cameras is missing or invalid.
    """
    candidates = _find_candidate_pairs(list_image_topics(recording))
    if not candidates:
        return None
    left, right = min(candidates, key=_rank_pair)
    if len(candidates) > 1:
        emit(
            RECORDING_TOPIC_CHOSEN.warning(
                "{count} pairs of topics could be stereo pairs; {name} is used",
                count=len(candidates),
                name=left.name,
            )
        )
    first, second = (wrap_topic_images(one.name, one.topic) for one in (left, right))
    rig = read_stated_rig(first, recording.path.parent, options) or _read_rig(recording, left, right, options)
    return StereoStreams(first, second, rig, find_accelerometer(recording, left.frame))


def _find_candidate_pairs(found: Sequence[ImageTopic]) -> list[tuple[ImageTopic, ImageTopic]]:
    grey = {one.name: one for one in found if is_color(one.encoding)}
    candidates = []
    for name, one in grey.items():
        others = (name.replace(left, right) for left, right in _SIDE_NAMES if left in name)
        other = next((grey[word] for word in others if word in grey), None)
        if other is not None:
            candidates.append((one, other))
    return candidates


def _rank_pair(side_topics: tuple[ImageTopic, ImageTopic]) -> tuple[bool, bool, bool]:
    """Return the sort key of candidate pairs: the preferred pair sorts first."""
    left, _ = side_topics
    return not left.is_rectified, left.is_compressed, "gray" in left.name


def _read_rig(recording: Recording, left: ImageTopic, right: ImageTopic, options: ReadingParams) -> StereoRig:
    first, second = (read_camera_message(recording, one) for one in (left, right))
    sides = {"left": first, "right": second}
    is_rectified = left.is_rectified and bool(first.projection.any() and second.projection.any())
    document: dict[str, Any] = {"unit": "m"}
    if not second.projection[0, 3]:
        right_from_left = find_transform(recording, left.frame, right.frame)
        if right_from_left is None or not right_from_left[:3, 3].any():
            right_from_left = np.eye(4)
            if options.baseline is None:
                raise InputError(
                    CAMERA_PAIR_UNCALIBRATED,
                    (
                        "the baseline between {left_name} and {right_name} is neither in the right "
                        "camera_info (P[0,3]) nor in /tf_static"
                    ),
                    recording.path,
                    remedy="set scan.baseline=METRES.",
                    left_name=left.name,
                    right_name=right.name,
                )
        tables = {side: _to_calibration_table(one, is_rectified=is_rectified) for side, one in sides.items()}
        document |= {**tables, "R": right_from_left[:3, :3], "T": right_from_left[:3, 3]}
    elif is_rectified:
        document |= {"P1": first.projection, "P2": second.projection}
    else:
        extrinsics = {side: {"R": one.rectification, "P": one.projection} for side, one in sides.items()}
        document |= {side: _to_calibration_table(one) | extrinsics[side] for side, one in sides.items()}
    with collecting(forward=False) as diagnostics:
        rig = rig_calibration.read_rig(
            recording.path, first.width, first.height, document=document, baseline=options.baseline
        )
    # Topic names state whether images are rectified and ROS uses metres, so the reader's warnings about
    # assumptions do not apply.
    emit(*(one for one in diagnostics if one.code != CAMERA_CALIBRATION_ASSUMED.name))
    return rig


def _to_calibration_table(message: CameraMessage, *, is_rectified: bool = False) -> dict[str, Any]:
    """Return a camera as a table with the keys of calibration files."""
    return {
        "width": message.width,
        "height": message.height,
        "distortion_model": None if is_rectified else message.model or None,
        "K": message.projection[:, :3] if is_rectified else message.matrix,
        "D": None if is_rectified else message.distortion,
    }
