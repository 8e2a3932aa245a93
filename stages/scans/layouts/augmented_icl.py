"""Augmented ICL-NUIM as published by Redwood: colour, depth and a .log.

Either all in one folder, with colour and depth under the same number, or in the folders as downloaded:
x-color/00000.jpg, x-depth-clean/00000.png, x-traj.txt.
"""

from __future__ import annotations

import re
from pathlib import Path

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.calibration.camera_resolution import get_stated_camera
from scanloom.stages.scans.codes import SCAN_FILES_MISSING
from scanloom.stages.scans.image_folders.image_files import find_common_size, list_images, match_by_number
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, scale_camera
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

_CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
_UNITS_PER_METRE = 1000.0
_NUMBER_NAME = re.compile(r"\d{5}")
# Depth without simulated noise is preferred.
_DEPTH_FOLDER_PATTERNS = ("*-depth-clean", "*-depth-simulated", "*-depth")
_TRAJECTORY_PATTERNS = ("*.log", "*-traj.txt")


def _matches(folder: Path) -> str | None:
    streams = _find_streams(folder)
    if streams is None or _find_trajectory(folder) is None:
        return None
    depth, color = streams
    if depth == color:
        return "pairs like 00000.jpg and 00000.png with a .log"
    return f"{color.name}/ and {depth.name}/"


def _find_streams(folder: Path) -> tuple[Path, Path] | None:
    """Return the folders of depth and colour; both may be equal."""
    if any(
        _NUMBER_NAME.fullmatch(path.stem) and path.with_suffix(".png").exists()
        for path in folder.glob("*.jpg")
    ):
        return folder, folder
    colors = [path for path in folder.glob("*-color") if path.is_dir()]
    depths = [path for kind in _DEPTH_FOLDER_PATTERNS for path in folder.glob(kind) if path.is_dir()]
    return (depths[0], colors[0]) if len(colors) == 1 and depths else None


def _find_trajectory(folder: Path) -> Path | None:
    found = [path for kind in _TRAJECTORY_PATTERNS for path in folder.glob(kind)]
    return found[0] if len(found) == 1 else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    streams = _find_streams(folder)
    if streams is None:
        raise InputError(
            SCAN_FILES_MISSING,
            "images named like 00000.jpg (colour) and 00000.png (depth) are required.",
            folder,
        )
    depths, colors = list_images(streams[0], (".png",)), list_images(streams[1], (".jpg",))
    pairs, skipped = match_by_number(depths, colors, "depth (.png)", "colour (.jpg)", folder)
    names = [depth.stem for depth, _ in pairs]
    path = options.resolve_file("poses", folder) or _find_trajectory(folder)
    poses: list[Pose | None] = [None] * len(names)
    missing: tuple[Diagnostic, ...] = ()
    if path is None:
        missing = (describe_missing_poses("exactly one .log or *-traj.txt is required"),)
    else:
        poses = trajectories.match_poses_to_frames(trajectories.read_trajectory(path), names, path)
    size = find_common_size([depth for depth, _ in pairs])
    camera = get_stated_camera(options, folder, *size) or scale_camera(_CAMERA, *size)
    frames = [
        Frame(
            name=name,
            camera=camera,
            color=color,
            depth=depth,
            depth_scale=options.depth_scale or _UNITS_PER_METRE,
            world_from_camera=pose,
        )
        for name, (depth, color), pose in zip(names, pairs, poses, strict=True)
    ]
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=missing)


LAYOUT = Layout(
    name="augmented-icl",
    description="00000.jpg, 00000.png and one .log, or *-color/, *-depth-clean/, *-traj.txt (Augmented "
    "ICL-NUIM)",
    matches=_matches,
    read=_read,
)
