"""Cameras and poses in a text file with headings, as the APC vision toolbox writes it.

One file per folder. A line that begins with `#` describes the matrix below it:

    # Color camera intrinsic matrix
     6.15195190e+02   0.00000000e+00   2.98442688e+02
     …
    # Depth-to-color camera extrinsic matrix
     …
    # Camera-to-world extrinsic matrix (camera pose) for frame-000000
     …
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.codes import SCAN_TABLE_DAMAGED
from scanloom.stages.scans.model.poses import check_rigid_pose, invert_pose
from scanloom.stages.scans.model.scan import Pose
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

# Patterns of headings: type of the matrix, its direction, and its frame.
_CAMERA_TO_WORLD = re.compile(r"cam\w{0,40}[ -](?:to|2)[ -]world|camera pose", re.IGNORECASE)
_WORLD_TO_CAMERA = re.compile(r"world[ -](?:to|2)[ -]cam", re.IGNORECASE)
_DEPTH_TO_COLOR = re.compile(r"depth[ -](?:to|2)[ -](?:colou?r|rgb)", re.IGNORECASE)
_INTRINSIC = re.compile(r"(?:(colou?r|rgb)|(depth|infrared|ir))?.*\bintrinsic", re.IGNORECASE)
_FRAME = re.compile(r"\b(?:frame|image)[-_ ]?\d+\b", re.IGNORECASE)
_SHAPES = ((3, 3), (3, 4), (4, 4))


@dataclass(frozen=True, eq=False)
class HeadedText:
    """Content of a text file with headings.

    Attributes
    ----------
    color, depth : (3, 3) float64 camera matrices, pixels; None if missing. A camera without a stated type is
        the colour camera.
    color_from_depth : (4, 4) float64, metres; None if missing.
    poses : (4, 4) world_from_camera by frame name, None where tracking was lost.
    unknown_headings : headings of matrices of unknown type.
    """

    color: NDArray[np.float64] | None
    depth: NDArray[np.float64] | None
    color_from_depth: Pose | None
    poses: dict[str, Pose | None]
    unknown_headings: tuple[str, ...]


def has_frame_headings(text: str) -> bool:
    """Return True if a text has a heading for the pose of a frame."""
    headings = (line for line in text.splitlines() if line.lstrip().startswith("#"))
    return any(_FRAME.search(line) and _detect_pose_direction(line) for line in headings)


def read_headed_text(path: Path) -> HeadedText:
    """Read cameras and poses from a text file with headings.

    Raises
    ------
    InputError
        If a row is not numeric, a matrix does not fit its heading, or a frame has two poses.
    """
    cameras: dict[str, NDArray[np.float64]] = {}
    poses: dict[str, Pose | None] = {}
    color_from_depth, others = None, []
    for number, heading, matrix in _read_blocks(path):
        where = f"the matrix below line {number}"
        if matrix.shape not in _SHAPES:
            raise InputError(SCAN_TABLE_DAMAGED, "{place} is not 3x3, 3x4 or 4x4.", path, place=where)
        frame, direction = _FRAME.search(heading), _detect_pose_direction(heading)
        if frame is not None and direction:
            pose = check_rigid_pose(_require_four_columns(matrix, where, path), path, where)
            if frame[0] in poses:
                raise InputError(SCAN_TABLE_DAMAGED, "{frame} has two poses.", path, frame=frame[0])
            is_inverse = direction == "world-to-camera"
            poses[frame[0]] = invert_pose(pose) if is_inverse and pose is not None else pose
        elif _DEPTH_TO_COLOR.search(heading):
            color_from_depth = check_rigid_pose(_require_four_columns(matrix, where, path), path, where)
        elif (camera := _INTRINSIC.match(heading)) is not None:
            cameras["depth" if camera[2] else "color"] = matrix[:3, :3]
        else:
            others.append(heading)
    return HeadedText(cameras.get("color"), cameras.get("depth"), color_from_depth, poses, tuple(others))


def _detect_pose_direction(heading: str) -> str:
    if _WORLD_TO_CAMERA.search(heading):
        return "world-to-camera"
    return "camera-to-world" if _CAMERA_TO_WORLD.search(heading) else ""


def _require_four_columns(matrix: NDArray[np.float64], where: str, path: Path) -> NDArray[np.float64]:
    if matrix.shape[1] != 4:
        raise InputError(SCAN_TABLE_DAMAGED, "{place} is not a pose, which has 4 columns.", path, place=where)
    return matrix


def _read_blocks(path: Path) -> list[tuple[int, str, NDArray[np.float64]]]:
    """Return the line number (from 1), heading and matrix of each block."""
    blocks: list[tuple[int, str, list[list[float]]]] = []
    for number, line in enumerate(documents.read_text(path).splitlines(), 1):
        text = line.strip()
        if text.startswith("#"):
            blocks.append((number, " ".join(text.lstrip("# \t").split()), []))
        elif text:
            if not blocks:
                raise InputError(
                    SCAN_TABLE_DAMAGED, "line {number} has no heading (`# …`) above it.", path, number=number
                )
            blocks[-1][2].append(trajectories.read_number_line(text, number, path))
    for number, _, rows in blocks:
        if len({len(row) for row in rows}) > 1:
            raise InputError(
                SCAN_TABLE_DAMAGED,
                "the rows below line {number} have different lengths.",
                path,
                number=number,
            )
    return [(number, heading, np.array(rows, np.float64)) for number, heading, rows in blocks if rows]
