"""BOP (benchmark for 6D object pose): numbered images and `scene_camera.json`.

    rgb/000000.png (or gray/)     depth/000000.png     scene_camera.json, by number:
        cam_K 3×3 row-major, depth_scale (millimetres per depth unit), and if the scene has world poses
        cam_R_w2c 3×3 row-major and cam_t_w2c, millimetres: world-to-camera

Depth is registered to the colour camera. scene_gt.json, mask/ and mask_visib/ describe objects and not
cameras, and are ignored.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.camera_resolution import get_stated_camera
from scanloom.stages.scans.calibration.table_values import flatten_numbers, to_finite_number
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_INVALID,
    FRAME_IMAGE_MISSING,
    FRAME_POSE_MISSING,
    SCAN_FILES_MISSING,
    SCAN_FRAMES_SKIPPED,
)
from scanloom.stages.scans.image_folders.image_files import (
    COLOR_FOLDERS,
    DEPTH_SUFFIXES,
    IMAGE_SUFFIXES,
    find_common_size,
    find_first_existing,
    list_images,
)
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.posed_views import create_view_frame
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.poses import check_rigid_pose, invert_pose
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, SkippedFrame
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

_CAMERAS_FILE = "scene_camera.json"
_POSE_KEYS = ("cam_R_w2c", "cam_t_w2c")
_MM_PER_METRE = 1000.0
CameraTable = Mapping[str, Any]


def _matches(folder: Path) -> str | None:
    is_there = (folder / _CAMERAS_FILE).is_file()
    return (
        _CAMERAS_FILE
        if is_there and find_first_existing(folder, *COLOR_FOLDERS, "depth") is not None
        else None
    )


def _read(folder: Path, options: ReadingParams) -> Scan:
    path = folder / _CAMERAS_FILE
    tables = _read_camera_tables(path)
    colors = _list_by_number(find_first_existing(folder, *COLOR_FOLDERS))
    depths = _list_by_number(folder / "depth", DEPTH_SUFFIXES)
    streams = depths or colors
    if not streams:
        raise InputError(
            SCAN_FILES_MISSING, "rgb/, gray/ and depth/ have no images named like 000010.png.", folder
        )
    used = sorted(number for number in streams if number in tables)
    if not used:
        raise InputError(CAMERA_CALIBRATION_INVALID, "the file has no entry for any of the images.", path)
    size = find_common_size([streams[number] for number in used])
    stated = get_stated_camera(options, folder, *size)
    given = options.resolve_file("poses", folder)
    matched: dict[int, Pose | None] | None = None
    if given is not None:
        names = [streams[number].stem for number in used]
        found = trajectories.match_poses_to_frames(trajectories.read_trajectory(given), names, given)
        matched = dict(zip(used, found, strict=True))
    has_world = matched is not None or any(key in tables[number] for number in used for key in _POSE_KEYS)
    frames: list[Frame] = []
    skipped = [
        SkippedFrame(
            streams[number].stem,
            SCAN_FRAMES_SKIPPED.warning("{file} has no entry for this image", file=_CAMERAS_FILE),
        )
        for number in sorted(streams.keys() - tables.keys())
    ]
    for number in used:
        name, table = streams[number].stem, tables[number]
        color, depth = colors.get(number), depths.get(number)
        try:
            pose = _parse_pose(table, path) if matched is None else matched[number]
            if pose is None and has_world:
                skipped.append(SkippedFrame(name, FRAME_POSE_MISSING.warning("the frame has no pose")))
                continue
            if color is None and colors:
                skipped.append(SkippedFrame(name, FRAME_IMAGE_MISSING.warning("its colour image is missing")))
                continue
            camera = stated or _parse_camera(table, size, path)
            if depth is None and color is not None:
                frames.append(create_view_frame(name, camera, color, pose))
                continue
            scale = options.depth_scale or _MM_PER_METRE / _parse_depth_scale(table, path)
        except InputError as error:
            skipped.append(SkippedFrame(name, error.diagnostic))
            continue
        frames.append(
            Frame(name, camera, color=color, depth=depth, depth_scale=scale, world_from_camera=pose)
        )
    alone = len(tables.keys() - streams.keys())
    if alone:
        emit(
            SCAN_FRAMES_SKIPPED.warning(
                "{file} has entries for {count} images that do not exist; they are ignored",
                file=_CAMERAS_FILE,
                count=alone,
            )
        )
    missing = () if has_world else (describe_missing_poses("{file} has no cam_R_w2c", file=_CAMERAS_FILE),)
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=missing)


def _read_camera_tables(path: Path) -> dict[int, CameraTable]:
    """Read `scene_camera.json` as a table per image number."""
    document = documents.read_json(path)
    if not isinstance(document, dict) or not document:
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "the file must be a JSON object with a camera per image number.", path
        )
    tables: dict[int, CameraTable] = {}
    for key, table in document.items():
        if not (key.isascii() and key.isdigit() and len(key) < 10 and isinstance(table, dict)):
            raise InputError(
                CAMERA_CALIBRATION_INVALID,
                "{key!r} is not an image number with a camera object.",
                path,
                key=str(key)[:40],
            )
        tables[int(key)] = table
    return tables


def _list_by_number(folder: Path | None, suffixes: Sequence[str] = IMAGE_SUFFIXES) -> dict[int, Path]:
    """Return the images of a folder by the number in their name.

    Empty if the folder does not exist.
    """
    if folder is None or not folder.is_dir():
        return {}
    return {int(path.stem): path for path in list_images(folder, suffixes) if path.stem.isdecimal()}


def _parse_camera(table: CameraTable, size: tuple[int, int], path: Path) -> Camera:
    return calibration.create_camera_from_matrix(
        _parse_values(table, "cam_K", 9, path).reshape(3, 3), (), *size, path
    )


def _parse_depth_scale(table: CameraTable, path: Path) -> float:
    scale = to_finite_number(table.get("depth_scale", 1.0), "depth_scale", path)
    if scale <= 0:
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "depth_scale is {scale:g}; it must be positive.", path, scale=scale
        )
    return scale


def _parse_values(table: CameraTable, key: str, count: int, path: Path) -> NDArray[np.float64]:
    values = flatten_numbers(table.get(key), key, path)
    if len(values) != count:
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "{key} must be a list of {count} numbers.", path, key=key, count=count
        )
    return np.array(values)


def _parse_pose(table: CameraTable, path: Path) -> Pose | None:
    """Parse the camera-to-world pose of a frame, in metres.

    Returns None if the scene has no world frame, or the pose is not finite (lost tracking).
    """
    if not any(key in table for key in _POSE_KEYS):
        return None
    rotation = _parse_values(table, _POSE_KEYS[0], 9, path).reshape(3, 3)
    translation = _parse_values(table, _POSE_KEYS[1], 3, path) / _MM_PER_METRE
    world_to_camera = check_rigid_pose(np.column_stack([rotation, translation]), path)
    return None if world_to_camera is None else invert_pose(world_to_camera)


LAYOUT = Layout(
    name="bop",
    description="rgb/ or gray/, depth/ and scene_camera.json (BOP's data sets), or views without depth/",
    matches=_matches,
    read=_read,
)
