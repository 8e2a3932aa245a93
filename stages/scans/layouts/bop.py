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
from scanloom.stages.scans.calibration.resolution import stated_camera
from scanloom.stages.scans.calibration.table_values import number_of, number_row
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_INVALID,
    FRAME_IMAGE_MISSING,
    FRAME_POSE_MISSING,
    SCAN_FILES_MISSING,
    SCAN_FRAMES_SKIPPED,
)
from scanloom.stages.scans.image_folders.image_files import (
    COLOR_FOLDERS,
    DEPTHS,
    IMAGES,
    common_size,
    first_existing,
    images,
)
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.views import single_view
from scanloom.stages.scans.model.lacking import poses_missing
from scanloom.stages.scans.model.poses import inverted, rigid
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, SkippedFrame
from scanloom.stages.scans.trajectory import files as trajectories

_CAMERAS = "scene_camera.json"
_POSE = ("cam_R_w2c", "cam_t_w2c")
_MILLIMETRES = 1000.0
Table = Mapping[str, Any]


def _matches(folder: Path) -> str | None:
    is_there = (folder / _CAMERAS).is_file()
    return _CAMERAS if is_there and first_existing(folder, *COLOR_FOLDERS, "depth") is not None else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    path = folder / _CAMERAS
    tables = _tables(path)
    colors = _by_number(first_existing(folder, *COLOR_FOLDERS))
    depths = _by_number(folder / "depth", DEPTHS)
    streams = depths or colors
    if not streams:
        raise InputError(
            SCAN_FILES_MISSING, "rgb/, gray/ and depth/ have no images named like 000010.png.", folder
        )
    used = sorted(number for number in streams if number in tables)
    if not used:
        raise InputError(CAMERA_CALIBRATION_INVALID, "the file has no entry for any of the images.", path)
    size = common_size([streams[number] for number in used])
    stated = stated_camera(options, folder, *size)
    given = options.file("poses", folder)
    matched: dict[int, Pose | None] | None = None
    if given is not None:
        names = [streams[number].stem for number in used]
        found = trajectories.match(trajectories.read_trajectory(given), names, given)
        matched = dict(zip(used, found, strict=True))
    has_world = matched is not None or any(key in tables[number] for number in used for key in _POSE)
    frames: list[Frame] = []
    skipped = [
        SkippedFrame(
            streams[number].stem,
            SCAN_FRAMES_SKIPPED.warning("{file} has no entry for this image", file=_CAMERAS),
        )
        for number in sorted(streams.keys() - tables.keys())
    ]
    for number in used:
        name, table = streams[number].stem, tables[number]
        color, depth = colors.get(number), depths.get(number)
        try:
            pose = _pose(table, path) if matched is None else matched[number]
            if pose is None and has_world:
                skipped.append(SkippedFrame(name, FRAME_POSE_MISSING.warning("the frame has no pose")))
                continue
            if color is None and colors:
                skipped.append(SkippedFrame(name, FRAME_IMAGE_MISSING.warning("its colour image is missing")))
                continue
            camera = stated or _camera(table, size, path)
            if depth is None and color is not None:
                frames.append(single_view(name, camera, color, pose))
                continue
            scale = options.depth_scale or _MILLIMETRES / _depth_scale(table, path)
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
                file=_CAMERAS,
                count=alone,
            )
        )
    missing = () if has_world else (poses_missing("{file} has no cam_R_w2c", file=_CAMERAS),)
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=missing)


def _tables(path: Path) -> dict[int, Table]:
    """Read `scene_camera.json` as a table per image number."""
    document = documents.read_json(path)
    if not isinstance(document, dict) or not document:
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "the file must be a JSON object with a camera per image number.", path
        )
    tables: dict[int, Table] = {}
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


def _by_number(folder: Path | None, suffixes: Sequence[str] = IMAGES) -> dict[int, Path]:
    """Return the images of a folder by the number in their name.

    Empty if the folder does not exist.
    """
    if folder is None or not folder.is_dir():
        return {}
    return {int(path.stem): path for path in images(folder, suffixes) if path.stem.isdecimal()}


def _camera(table: Table, size: tuple[int, int], path: Path) -> Camera:
    return calibration.matrix_camera(_values(table, "cam_K", 9, path).reshape(3, 3), (), *size, path)


def _depth_scale(table: Table, path: Path) -> float:
    scale = number_of(table.get("depth_scale", 1.0), "depth_scale", path)
    if scale <= 0:
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "depth_scale is {scale:g}; it must be positive.", path, scale=scale
        )
    return scale


def _values(table: Table, key: str, count: int, path: Path) -> NDArray[np.float64]:
    values = number_row(table.get(key), key, path)
    if len(values) != count:
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "{key} must be a list of {count} numbers.", path, key=key, count=count
        )
    return np.array(values)


def _pose(table: Table, path: Path) -> Pose | None:
    """Return the camera-to-world pose in metres, or None without one.

    None if the scene has no world frame or the pose is not finite (lost tracking).
    """
    if not any(key in table for key in _POSE):
        return None
    rotation = _values(table, _POSE[0], 9, path).reshape(3, 3)
    place = _values(table, _POSE[1], 3, path) / _MILLIMETRES
    world_to_camera = rigid(np.column_stack([rotation, place]), path)
    return None if world_to_camera is None else inverted(world_to_camera)


LAYOUT = Layout(
    name="bop",
    text="rgb/ or gray/, depth/ and scene_camera.json (BOP's data sets), or views without depth/",
    matches=_matches,
    read=_read,
)
