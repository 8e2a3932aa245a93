"""Application of the result of `adjust` to a scan: poses, colour camera and rolling shutter rotations.

{
"accepted": true,                          false: no improvement was found, frames stay unchanged
"color_camera": {"width": 640, "fx": …},   null: unchanged
"color_from_depth": [[…], …],              4x4, metres; null: unchanged
"names": {"0": "000000", …},               names of adjusted frames by frame index
"poses": {"0": [[…], …], …},               4x4 world_from_camera, metres, by frame index
"shutter_turns": {"0": […], …}             rotation vectors, radians: camera rotation from first to last row
                                           during readout; null or missing for a global shutter
"depth_calibration": {…}                   correction of depth, see depth_calibration.py; null or missing:
                                           unchanged
}
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.codes import CAMERA_ADJUSTED_MISMATCH, CAMERA_CALIBRATION_INVALID, POSE_MISSING
from scanloom.stages.scans.model.depth_correction import DepthCorrection
from scanloom.stages.scans.model.poses import check_rigid_pose, parse_pose_matrix, parse_shutter_turn
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan
from scanloom.stages.scans.transforms.depth_calibration import parse_depth_calibration


def apply_adjusted_cameras(scan: Scan, path: Path) -> Scan:
    """Apply the cameras.json of `adjust` to the frames of a scan, by frame name.

    Raises
    ------
    InputError
        If the file is not a cameras.json of `adjust`, or contains none of the frames.
    """
    document = documents.read_json(path)
    if not isinstance(document, dict) or not calibration.is_adjust_result(document):
        raise InputError(CAMERA_ADJUSTED_MISMATCH, "a cameras.json of `scanloom adjust` is expected.", path)
    poses = _read_poses(document, path)
    camera = _read_color_camera(document, path)
    turns = _read_shutter_turns(document, path)
    table = document.get("depth_calibration")
    correction = None if table is None else parse_depth_calibration(table, path)
    frames = [
        _apply_to_frame(frame, poses.get(frame.name), camera, turns.get(frame.name), correction)
        for frame in scan.frames
    ]
    if poses and not any(frame.name in poses for frame in scan.frames):
        raise InputError(
            CAMERA_ADJUSTED_MISMATCH,
            "it belongs to another scan: none of its frames is among the {frames_count} frames of this scan.",
            path,
            frames_count=len(frames),
        )
    posed = any(frame.world_from_camera is not None for frame in frames)
    missing = tuple(one for one in scan.missing if not (posed and one.code == POSE_MISSING.name))
    return replace(scan, frames=frames, missing=missing)


def _apply_to_frame(
    frame: Frame,
    pose: Pose | None,
    camera: tuple[Camera, Pose] | None,
    turn: NDArray[np.float64] | None,
    correction: DepthCorrection | None,
) -> Frame:
    if pose is not None:
        frame = replace(frame, world_from_camera=pose)
    if turn is not None:
        frame = replace(frame, shutter_turn=turn)
    if camera is not None and frame.color is not None and frame.depth is not None:
        frame = replace(frame, color_camera=camera[0], color_from_depth=camera[1])
    if correction is not None and frame.depth is not None:
        frame = replace(frame, depth_correction=correction)
    return frame


def _read_poses(document: dict[str, Any], path: Path) -> dict[str, Pose]:
    names, poses = document.get("names"), document.get("poses")
    if not isinstance(names, dict) or not isinstance(poses, dict) or set(names) != set(poses):
        raise InputError(
            CAMERA_ADJUSTED_MISMATCH,
            "the names of its frames are missing",
            path,
            remedy="run `scanloom adjust` again.",
        )
    if not all(isinstance(name, str) for name in names.values()):
        raise InputError(CAMERA_ADJUSTED_MISMATCH, "a frame's name is not a string.", path)
    return {names[place]: _read_finite_pose(poses[place], f"frame {names[place]}", path) for place in poses}


def _read_shutter_turns(document: dict[str, Any], path: Path) -> dict[str, NDArray[np.float64]]:
    names, turns = document["names"], document.get("shutter_turns")
    if turns is None:
        return {}
    if not isinstance(turns, dict) or not set(turns) <= set(names):
        raise InputError(
            CAMERA_ADJUSTED_MISMATCH,
            "the names of its frames are missing",
            path,
            remedy="run `scanloom adjust` again.",
        )
    return {names[place]: parse_shutter_turn(turns[place], path, f"frame {names[place]}") for place in turns}


def _read_color_camera(document: dict[str, Any], path: Path) -> tuple[Camera, Pose] | None:
    table = document.get("color_camera")
    if table is None:
        return None
    if not isinstance(table, dict):
        raise InputError(CAMERA_ADJUSTED_MISMATCH, "color_camera must be a table of names and values.", path)
    width, height = table.get("width"), table.get("height")
    if not isinstance(width, int) or not isinstance(height, int) or not 0 < width * height <= 1 << 27:
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "color_camera needs its width and height in pixels.", path
        )
    camera = calibration.parse_camera_table(table, width, height, path)
    return camera, _read_finite_pose(document.get("color_from_depth"), "color_from_depth", path)


def _read_finite_pose(value: object, where: str, path: Path) -> Pose:
    pose = check_rigid_pose(parse_pose_matrix(value, path, where), path, where)
    if pose is None:
        raise InputError(CAMERA_ADJUSTED_MISMATCH, "{place} is not finite.", path, place=where)
    return pose
