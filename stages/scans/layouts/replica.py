"""Replica, rendered for SLAM: results/ with colour and depth, and traj.txt."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_ASSUMED, SCAN_FILES_MISSING, SCAN_TABLE_DAMAGED
from scanloom.stages.scans.image_folders.image_files import (
    DEPTH_SUFFIXES,
    find_common_size,
    find_first_existing,
    list_images,
    match_by_number,
)
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, scale_camera
from scanloom.stages.scans.model.world import Z_UP
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

# Camera of all rendered rooms of the data set.
_CAMERA = Camera(1200, 680, 600.0, 600.0, 599.5, 339.5)
_UNITS_PER_METRE = 6553.5
_POSE_FILE = "traj.txt"


def _matches(folder: Path) -> str | None:
    is_there = (folder / _POSE_FILE).is_file() and (folder / "results").is_dir()
    return f"{_POSE_FILE} and results/" if is_there else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    results = folder / "results"
    if not results.is_dir():
        raise InputError(
            SCAN_FILES_MISSING,
            "a folder results/ with frame000000.jpg and depth000000.png is required.",
            folder,
        )
    depths = [path for path in list_images(results, DEPTH_SUFFIXES) if path.stem.startswith("depth")]
    colors = [path for path in list_images(results) if path.stem.startswith("frame")]
    pairs, skipped = match_by_number(depths, colors, "results/depth*", "results/frame*", folder)
    names = [depth.stem.removeprefix("depth") for depth, _ in pairs]
    path = options.resolve_file("poses", folder) or find_first_existing(folder, _POSE_FILE)
    poses: list[Pose | None] = [None] * len(names)
    missing: tuple[Diagnostic, ...] = ()
    if path is None:
        missing = (describe_missing_poses("{file} is missing", file=_POSE_FILE),)
    else:
        poses = trajectories.match_poses_to_frames(trajectories.read_trajectory(path), names, path)
    camera, scale = _read_camera(folder, options, *find_common_size([depth for depth, _ in pairs]))
    frames = [
        Frame(
            name=name,
            camera=camera,
            color=color,
            depth=depth,
            depth_scale=options.depth_scale or scale,
            world_from_camera=pose,
        )
        for name, (depth, color), pose in zip(names, pairs, poses, strict=True)
    ]
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=missing)


def _read_camera(folder: Path, options: ReadingParams, width: int, height: int) -> tuple[Camera, float]:
    """Return the camera and the depth scale in units per metre."""
    stated, given = options.get_camera(width, height), options.resolve_file("calibration", folder)
    # One camera file is shared by all rooms.
    path = given or find_first_existing(folder, "cam_params.json", "../cam_params.json")
    if path is None:
        if stated is None:
            emit(
                CAMERA_CALIBRATION_ASSUMED.warning(
                    "cam_params.json is missing: the camera of the data set and {units} depth units per "
                    "metre are used",
                    units=_UNITS_PER_METRE,
                )
            )
        return stated or scale_camera(_CAMERA, width, height), _UNITS_PER_METRE
    table = documents.read_document(path) if path.suffix != ".txt" else {}
    entry = table.get("camera", table)
    scale = _parse_scale(entry, path) if isinstance(entry, dict) else _UNITS_PER_METRE
    if stated is not None:
        return stated, scale
    if path.suffix == ".txt" or not isinstance(entry, dict):
        return calibration.read_camera(path, width, height), scale
    longer = {"w": "width", "h": "height"}
    sized = {longer.get(key) or key: value for key, value in entry.items()}
    return calibration.parse_camera_table(sized, width, height, path), scale


def _parse_scale(entry: dict[str, Any], path: Path) -> float:
    value = entry.get("scale", _UNITS_PER_METRE)
    if not isinstance(value, (int, float)) or not 0 < value < 1e12:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "scale is {value!r}; it must be a positive number.",
            path,
            value=str(value)[:40],
        )
    return float(value)


LAYOUT = Layout(
    name="replica",
    description="results/frame000000.jpg, results/depth000000.png, traj.txt (Replica, rendered)",
    matches=_matches,
    read=_read,
    up=Z_UP,
)
