"""Frames with a headed text file of cameras and poses.

Written by the APC vision toolbox and related tools.

    cam.info.txt                                     see scanloom.stages.scans.calibration.headed_text
    frame-000000.color.png  frame-000000.depth.png   depth registered to the colour camera

The toolbox rotates the bits of depth values by three, in units of 0.1 mm. Poses belong to the colour
camera. Unregistered depth in raw/ is ignored: the lens distortion of its camera is unknown, and the
registered maps fit the colour images better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.files.file_access_log import pause_recording
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration import headed_text
from scanloom.stages.scans.calibration.camera_resolution import find_or_guess_camera, get_stated_camera
from scanloom.stages.scans.calibration.discovery import list_small_documents
from scanloom.stages.scans.calibration.headed_text import HeadedText
from scanloom.stages.scans.codes import (
    FRAME_IMAGE_MISSING,
    SCAN_ASSUMED,
    SCAN_FILES_MISSING,
    SCAN_TABLE_DAMAGED,
)
from scanloom.stages.scans.image_folders.image_files import (
    COLOR_FOLDERS,
    DEPTH_FOLDERS,
    DEPTH_SUFFIXES,
    find_common_size,
    find_first_existing,
    list_images,
)
from scanloom.stages.scans.image_folders.rotated_bits import detect_rotated_files, read_rotated
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, PackedImage, Pose, Scan, SkippedFrame
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

_TEXT_NAMES = ("cam.info.txt", "camera.info.txt", "cam_info.txt", "camera_info.txt")
# Bytes; a pose takes about 300.
_MAX_TEXT_BYTES = 1 << 22
# Depth units per metre of rotated values, as the toolbox writes them, and of plain values.
_TENTH_MM_UNITS_PER_METRE = 10_000.0
_MM_UNITS_PER_METRE = 1000.0
_COLOR_WORDS = ("color", "colour", "rgb")


def _matches(folder: Path) -> str | None:
    found = _find_text_file(folder)
    if found is None:
        return None
    with pause_recording():
        is_headed = _is_headed(found)
    # A damaged file is still recognised by its name, if there are depth images next to it.
    if not is_headed and not any("depth" in one.name.lower() for one in folder.iterdir()):
        return None
    return f"{found.name}, a text with camera poses under headings"


def _find_text_file(folder: Path) -> Path | None:
    """Return the text file of cameras and poses, or None.

    It has a usual name, or is the only text file with headings for poses of frames.
    """
    named = find_first_existing(folder, *_TEXT_NAMES)
    others = [path for path in list_small_documents(folder, _MAX_TEXT_BYTES) if path.suffix.lower() == ".txt"]
    if named is not None:
        return named
    with pause_recording():
        found = [path for path in others if _is_headed(path)]
    return found[0] if len(found) == 1 else None


def _is_headed(path: Path) -> bool:
    try:
        return headed_text.has_frame_headings(documents.read_text(path))
    except InputError:
        return False


def _read(folder: Path, options: ReadingParams) -> Scan:
    path = _find_text_file(folder)
    if path is None:
        raise InputError(
            SCAN_FILES_MISSING,
            "a text file with cameras and poses under headings (cam.info.txt) is required.",
            folder,
        )
    text = headed_text.read_headed_text(path)
    if not text.poses:
        raise InputError(SCAN_TABLE_DAMAGED, "the file has no heading for the pose of a frame.", path)
    found = _find_frames(folder, text)
    if not found:
        raise InputError(
            SCAN_FILES_MISSING,
            "none of the {poses_count} listed frames has a depth map, such as {next}.depth.png.",
            path,
            poses_count=len(text.poses),
            next=next(iter(text.poses), "frame-000000"),
        )
    without_depth = FRAME_IMAGE_MISSING.warning("its depth map is missing")
    lacking = [SkippedFrame(name, without_depth) for name in text.poses if name not in found]
    given = options.resolve_file("poses", folder)
    poses = text.poses
    if given is not None:
        matched = trajectories.match_poses_to_frames(trajectories.read_trajectory(given), list(found), given)
        poses = dict(zip(found, matched, strict=True))
    depths = [depth for depth, _ in found.values()]
    colors = [color for _, color in found.values() if color is not None]
    cameras = _read_cameras(folder, options, text, depths, colors, path)
    rotated = detect_rotated_files(depths, is_scale_stated=False)
    if not rotated:
        emit(
            SCAN_ASSUMED.warning(
                "unlike in files of the APC toolbox, the bits of the depth values are not rotated: they "
                "are read as millimetres",
                remedy="if they are in units of 0.1 mm, set scan.depth_scale={tenths:g}",
                tenths=_TENTH_MM_UNITS_PER_METRE,
            )
        )
    scale = options.depth_scale or (_TENTH_MM_UNITS_PER_METRE if rotated else _MM_UNITS_PER_METRE)
    frames = [
        Frame(
            name=name,
            camera=cameras.depth,
            color=color,
            depth=PackedImage(depth, "depth", partial(read_rotated, depth)) if rotated else depth,
            depth_scale=scale,
            world_from_camera=_to_depth_pose(poses.get(name), cameras, is_given=given is not None),
            color_camera=None if color is None else cameras.color,
            color_from_depth=None if color is None else cameras.color_from_depth,
        )
        for name, (depth, color) in found.items()
    ]
    if text.unknown_headings:
        emit(
            SCAN_ASSUMED.warning(
                "some entries of the file are ignored: {others}",
                path,
                others="; ".join(text.unknown_headings[:3]),
            )
        )
    return Scan(LAYOUT.name, frames, None, folder, tuple(lacking))


def _find_frames(folder: Path, text: HeadedText) -> dict[str, tuple[Path, Path | None]]:
    """Return depth map and colour image of each listed frame with depth.

    The colour image may be None.
    """
    beside = list_images(folder, DEPTH_SUFFIXES)
    depths = [one for one in beside if "depth" in one.name.lower()]
    depths += [
        one
        for name in DEPTH_FOLDERS
        if (folder / name).is_dir()
        for one in list_images(folder / name, DEPTH_SUFFIXES)
    ]
    colors = [one for one in beside if any(word in one.name.lower() for word in _COLOR_WORDS)]
    colors += [
        one for name in COLOR_FOLDERS if (folder / name).is_dir() for one in list_images(folder / name)
    ]
    pairs = {name: (_find_frame_file(depths, name), _find_frame_file(colors, name)) for name in text.poses}
    return {name: (depth, color) for name, (depth, color) in pairs.items() if depth is not None}


def _find_frame_file(files: Sequence[Path], name: str) -> Path | None:
    """Return the file named like the frame, optionally with a suffix."""
    return next(
        (one for one in files if one.name.startswith(name) and not one.name[len(name) :][:1].isalnum()), None
    )


@dataclass(frozen=True, eq=False)
class _DepthColorCameras:
    """Depth camera, and a separate colour camera with its extrinsics.

    `color` is None if there is only one camera.
    """

    depth: Camera
    color: Camera | None = None
    color_from_depth: Pose | None = None


def _to_depth_pose(pose: Pose | None, cameras: _DepthColorCameras, *, is_given: bool) -> Pose | None:
    """Return the pose of the depth camera.

    A trajectory given by the user is already relative to the depth camera.
    """
    if pose is None or cameras.color_from_depth is None or is_given:
        return pose
    moved: Pose = pose @ cameras.color_from_depth
    return moved


def _read_cameras(
    folder: Path,
    options: ReadingParams,
    text: HeadedText,
    depths: Sequence[Path],
    colors: Sequence[Path],
    path: Path,
) -> _DepthColorCameras:
    size = find_common_size(depths)
    color_size = find_common_size(colors) if colors else size
    stated = get_stated_camera(options, folder, *size)
    if stated is not None:
        return _DepthColorCameras(stated)
    if size != color_size and text.color is not None and text.depth is not None:
        depth, color = (
            calibration.create_camera_from_matrix(matrix, (), *of, path)
            for matrix, of in ((text.depth, size), (text.color, color_size))
        )
        return _DepthColorCameras(depth, color, text.color_from_depth)
    # Depth maps of the size of the colour images are registered to the colour camera.
    matrix = text.depth if text.color is None else text.color
    if matrix is None:
        camera, _ = find_or_guess_camera(folder, *size)
        return _DepthColorCameras(camera)
    return _DepthColorCameras(calibration.create_camera_from_matrix(matrix, (), *size, path))


LAYOUT = Layout(
    name="camera-text",
    description="frame-000000.color.png, frame-000000.depth.png, and a text with cameras and poses under "
    "headings (cam.info.txt of the APC vision toolbox)",
    matches=_matches,
    read=_read,
)
