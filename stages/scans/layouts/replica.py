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
from scanloom.stages.scans.image_folders.image_files import DEPTHS, common_size, first_existing, images, pair
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.lacking import poses_missing
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, scaled
from scanloom.stages.scans.model.world import Z_UP
from scanloom.stages.scans.trajectory import files as trajectories

# Camera of all rendered rooms of the data set.
_CAMERA = Camera(1200, 680, 600.0, 600.0, 599.5, 339.5)
_UNITS_PER_METRE = 6553.5
_POSES = "traj.txt"


def _matches(folder: Path) -> str | None:
    is_there = (folder / _POSES).is_file() and (folder / "results").is_dir()
    return f"{_POSES} and results/" if is_there else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    results = folder / "results"
    if not results.is_dir():
        raise InputError(
            SCAN_FILES_MISSING,
            "a folder results/ with frame000000.jpg and depth000000.png is required.",
            folder,
        )
    depths = [path for path in images(results, DEPTHS) if path.stem.startswith("depth")]
    colors = [path for path in images(results) if path.stem.startswith("frame")]
    pairs, skipped = pair(depths, colors, "results/depth*", "results/frame*", folder)
    names = [depth.stem.removeprefix("depth") for depth, _ in pairs]
    path = options.file("poses", folder) or first_existing(folder, _POSES)
    poses: list[Pose | None] = [None] * len(names)
    missing: tuple[Diagnostic, ...] = ()
    if path is None:
        missing = (poses_missing("{file} is missing", file=_POSES),)
    else:
        poses = trajectories.match(trajectories.read_trajectory(path), names, path)
    camera, scale = _camera(folder, options, *common_size([depth for depth, _ in pairs]))
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


def _camera(folder: Path, options: ReadingParams, width: int, height: int) -> tuple[Camera, float]:
    """Return the camera and the depth scale in units per metre."""
    stated, given = options.camera(width, height), options.file("calibration", folder)
    # One camera file is shared by all rooms.
    path = given or first_existing(folder, "cam_params.json", "../cam_params.json")
    if path is None:
        if stated is None:
            emit(
                CAMERA_CALIBRATION_ASSUMED.warning(
                    "cam_params.json is missing: the camera of the data set and {units} depth units per "
                    "metre are used",
                    units=_UNITS_PER_METRE,
                )
            )
        return stated or scaled(_CAMERA, width, height), _UNITS_PER_METRE
    table = documents.read_document(path) if path.suffix != ".txt" else {}
    entry = table.get("camera", table)
    scale = _scale(entry, path) if isinstance(entry, dict) else _UNITS_PER_METRE
    if stated is not None:
        return stated, scale
    if path.suffix == ".txt" or not isinstance(entry, dict):
        return calibration.read_camera(path, width, height), scale
    longer = {"w": "width", "h": "height"}
    sized = {longer.get(key) or key: value for key, value in entry.items()}
    return calibration.camera_from_table(sized, width, height, path), scale


def _scale(entry: dict[str, Any], path: Path) -> float:
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
    text="results/frame000000.jpg, results/depth000000.png, traj.txt (Replica, rendered)",
    matches=_matches,
    read=_read,
    up=Z_UP,
)
