"""Files with the poses and cameras estimated by `adjust`.

trajectory.tum   camera-to-world poses of all frames that have a pose; frames that were not adjusted keep
                 their input pose
cameras.json     adjusted poses as 4x4 matrices by frame index, with frame names; the adjusted colour camera
                 and the rolling-shutter rotations, if any; whether the adjustment was accepted, and why
                 (`scan.adjusted_cameras` reads this file). `depth_calibration` only exists if depth is
                 corrected.
depth_calibration.json
                 the same correction of depth, for other scans of the sensor (`scan.depth_calibration`);
                 only if depth is corrected

A rejected adjustment has no trajectory.tum, and the frames keep their poses.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.pipeline.stage import Artifact
from scanloom.stages.adjusting.adjustment_result import Adjustment
from scanloom.stages.frames.rigid_pose import require_rigid_pose
from scanloom.stages.scans.model.scan import Camera, Frame, Scan
from scanloom.stages.scans.trajectory.trajectory_formats import write_tum
from scanloom.stages.scans.transforms.depth_calibration import (
    DEPTH_CALIBRATION_FILE,
    parse_depth_calibration,
    to_depth_calibration_table,
    write_depth_calibration,
)

_FILE = "cameras.json"


# Subfolder of the artifact; it does not exist if the adjustment was rejected.
ADJUSTED_FOLDER = "adjusted"


@dataclass(frozen=True)
class AdjustedCameras(Artifact):
    """Adjusted poses and colour camera; empty if the adjustment was rejected."""

    NAME = "adjusted_cameras"

    def apply_to(self, scan: Scan) -> Scan:
        """Apply the adjusted poses and cameras to a scan."""
        return apply_adjusted(scan, self.folder / ADJUSTED_FOLDER)


def write_adjusted(folder: Path, adjustment: Adjustment) -> Mapping[str, Any]:
    """Write an adjustment into an empty folder and return its metrics."""
    poses = {place: require_rigid_pose(adjustment.frames[place]) for place in adjustment.adjusted_indices}
    if poses:
        posed_frames = {
            place: one for place, one in enumerate(adjustment.frames) if one.world_from_camera is not None
        }
        times = [_get_frame_time(place, frame) for place, frame in posed_frames.items()]
        write_tum(
            folder / "trajectory.tum", times, [require_rigid_pose(frame) for frame in posed_frames.values()]
        )
    camera, color_from_depth = _color_camera(adjustment)
    document = {
        "accepted": adjustment.accepted,
        "why": adjustment.reason,
        "color_camera": camera,
        "color_from_depth": color_from_depth,
        "names": {str(place): adjustment.frames[place].name for place in poses},
        "poses": {str(place): pose.tolist() for place, pose in poses.items()},
        "shutter_turns": _collect_shutter_rotations(adjustment),
    }
    if adjustment.depth_correction is not None:
        document["depth_calibration"] = to_depth_calibration_table(adjustment.depth_correction)
        write_depth_calibration(folder / DEPTH_CALIBRATION_FILE, adjustment.depth_correction)
    (folder / _FILE).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8", newline="\n")
    return adjustment.to_dict()


def apply_adjusted(scan: Scan, folder: Path) -> Scan:
    """Apply the adjustment stored in a folder to a scan.

    The scan is returned unchanged if the folder has no cameras.json.
    """
    if not (folder / _FILE).exists():
        return scan
    document = json.loads((folder / _FILE).read_text(encoding="utf-8"))
    rotations = document["shutter_turns"] or {}
    frames = [
        _set_pose(frame, document["poses"].get(str(place)), rotations.get(str(place)))
        for place, frame in enumerate(scan.frames)
    ]
    if document["color_camera"] is not None:
        camera, color_from_depth = (
            Camera(**_parse_camera(document["color_camera"])),
            np.array(document["color_from_depth"]),
        )
        frames = [_set_color_camera(frame, camera, color_from_depth) for frame in frames]
    if document.get("depth_calibration") is not None:
        correction = parse_depth_calibration(document["depth_calibration"], folder / _FILE)
        frames = [
            frame if frame.depth is None else replace(frame, depth_correction=correction) for frame in frames
        ]
    return replace(scan, frames=frames)


def _color_camera(adjustment: Adjustment) -> tuple[dict[str, Any] | None, list[list[float]] | None]:
    if not adjustment.is_camera_adjusted:
        return None, None
    # Frames that could not be adjusted keep their input camera, so take the first frame with the adjusted
    # one.
    frame = next(
        one
        for one in adjustment.frames
        if one.color_camera == adjustment.camera_after and one.color_from_depth is not None
    )
    assert frame.color_camera is not None
    assert frame.color_from_depth is not None
    return asdict(frame.color_camera), frame.color_from_depth.tolist()


def _parse_camera(camera: Mapping[str, Any]) -> dict[str, Any]:
    return {**camera, "distortion": tuple(camera["distortion"])}


def _collect_shutter_rotations(adjustment: Adjustment) -> dict[str, list[float]] | None:
    if not adjustment.is_shutter_adjusted:
        return None
    turns = {place: adjustment.frames[place].shutter_turn for place in adjustment.adjusted_indices}
    return {str(place): turn.tolist() for place, turn in turns.items() if turn is not None}


def _set_pose(frame: Frame, pose: list[list[float]] | None, turn: list[float] | None) -> Frame:
    if turn is not None:
        frame = replace(frame, shutter_turn=np.array(turn))
    return frame if pose is None else replace(frame, world_from_camera=np.array(pose))


def _set_color_camera(frame: Frame, camera: Camera, color_from_depth: np.ndarray[Any, Any]) -> Frame:
    if frame.color is None or frame.depth is None:
        return frame
    return replace(frame, color_camera=camera, color_from_depth=color_from_depth)


def _get_frame_time(frame_index: int, frame: Frame) -> float:
    return frame_index if frame.timestamp is None else frame.timestamp / 1e9
