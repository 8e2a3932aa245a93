"""Open3D and Redwood style: folders of colour and depth, a trajectory, intrinsic.json.

Small recordings often have both streams in one folder: rgb_0.png, depth_0.png.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.file_access_log import pause_recording
from scanloom.stages.files.images import read_stored_image
from scanloom.stages.files.path_safety import resolve_path
from scanloom.stages.scans.calibration import azure_kinect
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.camera_resolution import find_or_guess_camera
from scanloom.stages.scans.calibration.discovery import find_trajectory
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_ASSUMED,
    POSE_ASSUMED,
    SCALE_DEPTH_UNIT_ASSUMED,
    SCAN_FILES_MISSING,
)
from scanloom.stages.scans.image_folders.depth_units import TUM_UNITS_PER_METRE, infer_depth_scale
from scanloom.stages.scans.image_folders.image_files import (
    COLOR_FOLDERS,
    DEPTH_FOLDERS,
    DEPTH_SUFFIXES,
    extract_numbers,
    find_common_size,
    find_first_existing,
    list_images,
    match_by_number,
    warn_if_paired_by_position,
)
from scanloom.stages.scans.layouts.shared.confidence_maps import find_confidence_maps
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

_INTRINSICS_FILES = ("intrinsic.json", "camera_intrinsic.json", "intrinsics.json", "camera_primesense.json")
_UNITS_PER_METRE = 1000.0
_COLOR_NAME = re.compile("rgb|colou?r", re.IGNORECASE)
_TRAJECTORY_FILES = ("trajectory.log", "trajectory.json", "trajectory.txt", "poses.txt")


def _matches(folder: Path) -> str | None:
    folders = _find_folders(folder)
    if folders is not None:
        return f"{folders[1].name}/ and {folders[0].name}/"
    depths, colors = _list_by_name(folder)
    # A file name without a number is a frame only if it is the only one.
    is_scan = depths and colors and (len(depths) == 1 or all(extract_numbers(path.stem) for path in depths))
    return f"files named like {colors[0].name} and {depths[0].name}" if is_scan else None


def _find_folders(folder: Path) -> tuple[Path, Path] | None:
    """Return the folders of depth and colour, or None."""
    depth, color = find_first_existing(folder, *DEPTH_FOLDERS), find_first_existing(folder, *COLOR_FOLDERS)
    return (depth, color) if depth and color and depth.is_dir() and color.is_dir() else None


def _list_by_name(folder: Path) -> tuple[list[Path], list[Path]]:
    """Return the depth maps and colour images of one folder, by name."""
    files = list_images(folder, DEPTH_SUFFIXES)
    of_depth = [path for path in files if "depth" in path.stem.lower()]
    colors = [path for path in files if path not in of_depth and _COLOR_NAME.search(path.stem)]
    return _drop_pictures(of_depth), colors


def _drop_pictures(depths: Sequence[Path]) -> list[Path]:
    """Drop colour-mapped renderings of depth, stored next to the depth maps.

    Parameters
    ----------
    depths : files grouped by name without numbers. If there are several groups, one file of each is tested.
    """
    kinds = defaultdict(list)
    for path in depths:
        kinds[re.sub(r"\d+", "#", path.stem)].append(path)
    if len(kinds) < 2:
        return list(depths)
    with pause_recording():
        pictures = {kind for kind, files in kinds.items() if _is_picture(files[len(files) // 2])}
    if len(pictures) == len(kinds):
        # The frame reader reports the unsuitable format.
        return list(depths)
    return [path for path in depths if re.sub(r"\d+", "#", path.stem) not in pictures]


def _is_picture(path: Path) -> bool:
    try:
        return read_stored_image(path).ndim > 2
    except InputError:
        return False


def _read(folder: Path, options: ReadingParams) -> Scan:
    folders = _find_folders(folder)
    if folders is None:
        depths, colors = _list_by_name(folder)
        named = "the images named depth", "the images named color or rgb"
    else:
        depths, colors = _drop_pictures(list_images(folders[0], DEPTH_SUFFIXES)), list_images(folders[1])
        named = f"{folders[0].name}/", f"{folders[1].name}/"
    if not depths or not colors:
        raise InputError(
            SCAN_FILES_MISSING, "a folder color/ (or rgb/, image/) and a folder depth/ are required.", folder
        )
    pairs, skipped = match_by_number(depths, colors, *named, folder)
    names = [depth.stem for depth, _ in pairs]
    path = options.resolve_file("poses", folder) or _find_trajectory(folder)
    if path is None and (path := find_trajectory(folder, len(pairs))) is not None:
        emit(
            POSE_ASSUMED.warning(
                "the poses are read from {file}, which was found in the scan folder", file=path.name
            )
        )
    poses: list[Pose | None] = [None] * len(pairs)
    missing: tuple[Diagnostic, ...] = ()
    if path is not None:
        poses = trajectories.match_poses_to_frames(trajectories.read_trajectory(path), names, path)
    else:
        missing = (describe_missing_poses("trajectory.log (or .json) is missing"),)
    camera, stated, scale = _find_camera(folder, options, [depth for depth, _ in pairs])
    color_camera, color_from_depth = _read_color_camera(stated, camera, [image for _, image in pairs])
    confidences, min_confidence = find_confidence_maps(folder, [depth for depth, _ in pairs], options)
    frames = [
        Frame(
            name=depth.stem,
            camera=camera,
            color=image,
            depth=depth,
            depth_scale=scale,
            world_from_camera=pose,
            confidence=confidences.get(depth),
            min_confidence=min_confidence,
            color_camera=color_camera,
            color_from_depth=color_from_depth,
        )
        for (depth, image), pose in zip(pairs, poses, strict=True)
    ]
    warn_if_paired_by_position(pairs, *named)
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=missing)


def _find_trajectory(folder: Path) -> Path | None:
    """Return the trajectory file, or None.

    It has a usual name, or is the only file that looks like a trajectory.

    Searched in the folder, in scene/ (where Open3D's reconstruction system writes it), and in the parent
    folder.
    """
    for place in (folder, folder / "scene", resolve_path(folder).parent):
        others = [*place.glob("*traj*.log"), *place.glob("*traj*.txt")]
        found = find_first_existing(place, *_TRAJECTORY_FILES) or (others[0] if len(others) == 1 else None)
        if found is not None:
            return found
    return None


def _find_camera(
    folder: Path, options: ReadingParams, depths: Sequence[Path]
) -> tuple[Camera, Path | None, float]:
    """Return the camera, its file or None, and the depth scale."""
    width, height = find_common_size(depths)
    # Open3D's examples share one camera file between several scans.
    path = options.resolve_file("calibration", folder) or find_first_existing(
        folder, *_INTRINSICS_FILES, *(f"../{name}" for name in _INTRINSICS_FILES)
    )
    camera = options.get_camera(width, height)
    if camera is None:
        if path is None:
            camera, path = find_or_guess_camera(folder, width, height)
        else:
            camera = calibration.read_camera(path, width, height)
            if not path.parent.samefile(folder):
                emit(
                    CAMERA_CALIBRATION_ASSUMED.warning(
                        "the intrinsics are read from {file} in the parent folder", file=path.name
                    )
                )
    scale = options.depth_scale or (None if path is None else calibration.read_depth_scale(path))
    if scale is None:
        scale = _UNITS_PER_METRE
        if infer_depth_scale(depths) == TUM_UNITS_PER_METRE:
            scale = TUM_UNITS_PER_METRE
            emit(
                SCALE_DEPTH_UNIT_ASSUMED.warning(
                    "all depth values are multiples of five, as in TUM's unit: {fifths:g} units per metre "
                    "are assumed",
                    remedy="if depth is in millimetres, set scan.depth_scale={millimetres:g}",
                    fifths=TUM_UNITS_PER_METRE,
                    millimetres=_UNITS_PER_METRE,
                )
            )
    return camera, path, scale


def _read_color_camera(
    path: Path | None, camera: Camera, colors: Sequence[Path]
) -> tuple[Camera | None, Pose | None]:
    """Return the colour camera and color_from_depth, if the file states both."""
    color_from_depth = None if path is None else azure_kinect.read_color_from_depth(path, camera)
    if path is None or color_from_depth is None:
        return None, None
    return calibration.read_camera(path, *find_common_size(colors)), color_from_depth


LAYOUT = Layout(
    name="redwood",
    description="color/ (or rgb/, image/), depth/, trajectory.log|json, intrinsic.json (Open3D, Redwood), "
    "or rgb_0.png and depth_0.png in one folder",
    matches=_matches,
    read=_read,
)
