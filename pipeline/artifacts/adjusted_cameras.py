"""Files with the poses and cameras estimated by `adjust`.

trajectory.tum   camera-to-world poses of all frames that have a pose; frames that were not adjusted keep
                 their input pose
cameras.json     adjusted poses as 4x4 matrices by frame index, with frame names; the adjusted colour camera
                 and the rolling-shutter rotations, if any; whether the adjustment was accepted, and why
                 (`scan.adjusted` reads this file)

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
from scanloom.stages.adjusting.adjusted import Adjusted
from scanloom.stages.frames.rigid_pose import require_rigid_pose
from scanloom.stages.scans.model.scan import Camera, Frame, Scan
from scanloom.stages.scans.trajectory.files import write_tum

_FILE = "cameras.json"


# Subfolder of the artifact; it does not exist if the adjustment was rejected.
FOLDER = "adjusted"


@dataclass(frozen=True)
class AdjustedCameras(Artifact):
    """Adjusted poses and colour camera; empty if the adjustment was rejected."""

    NAME = "adjusted_cameras"

    def apply_to(self, scan: Scan) -> Scan:
        """Apply the adjusted poses and cameras to a scan."""
        return apply_adjusted(scan, self.folder / FOLDER)


def write_adjusted(folder: Path, found: Adjusted) -> Mapping[str, Any]:
    """Write an adjustment into an empty folder and return its metrics."""
    poses = {place: require_rigid_pose(found.frames[place]) for place in found.places}
    if poses:
        posed = {place: one for place, one in enumerate(found.frames) if one.world_from_camera is not None}
        times = [_time(place, frame) for place, frame in posed.items()]
        write_tum(folder / "trajectory.tum", times, [require_rigid_pose(frame) for frame in posed.values()])
    camera, apart = _color_camera(found)
    document = {
        "accepted": found.accepted,
        "why": found.why,
        "color_camera": camera,
        "color_from_depth": apart,
        "names": {str(place): found.frames[place].name for place in poses},
        "poses": {str(place): pose.tolist() for place, pose in poses.items()},
        "shutter_turns": _turns(found),
    }
    (folder / _FILE).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8", newline="\n")
    return found.figures()


def apply_adjusted(scan: Scan, folder: Path) -> Scan:
    """Apply the adjustment stored in a folder to a scan.

    The scan is returned unchanged if the folder has no cameras.json.
    """
    if not (folder / _FILE).exists():
        return scan
    found = json.loads((folder / _FILE).read_text(encoding="utf-8"))
    turns = found["shutter_turns"] or {}
    frames = [
        _placed(frame, found["poses"].get(str(place)), turns.get(str(place)))
        for place, frame in enumerate(scan.frames)
    ]
    if found["color_camera"] is not None:
        camera, apart = Camera(**_as_tuple(found["color_camera"])), np.array(found["color_from_depth"])
        frames = [_seen_by(frame, camera, apart) for frame in frames]
    return replace(scan, frames=frames)


def _color_camera(found: Adjusted) -> tuple[dict[str, Any] | None, list[list[float]] | None]:
    if not found.has_camera:
        return None, None
    # Frames that could not be adjusted keep their input camera, so take the first frame with the adjusted
    # one.
    frame = next(
        one
        for one in found.frames
        if one.color_camera == found.camera_after and one.color_from_depth is not None
    )
    assert frame.color_camera is not None
    assert frame.color_from_depth is not None
    return asdict(frame.color_camera), frame.color_from_depth.tolist()


def _as_tuple(camera: Mapping[str, Any]) -> dict[str, Any]:
    return {**camera, "distortion": tuple(camera["distortion"])}


def _turns(found: Adjusted) -> dict[str, list[float]] | None:
    if not found.has_turns:
        return None
    turns = {place: found.frames[place].shutter_turn for place in found.places}
    return {str(place): turn.tolist() for place, turn in turns.items() if turn is not None}


def _placed(frame: Frame, pose: list[list[float]] | None, turn: list[float] | None) -> Frame:
    if turn is not None:
        frame = replace(frame, shutter_turn=np.array(turn))
    return frame if pose is None else replace(frame, world_from_camera=np.array(pose))


def _seen_by(frame: Frame, camera: Camera, apart: np.ndarray[Any, Any]) -> Frame:
    if frame.color is None or frame.depth is None:
        return frame
    return replace(frame, color_camera=camera, color_from_depth=apart)


def _time(place: int, frame: Frame) -> float:
    return place if frame.timestamp is None else frame.timestamp / 1e9
