"""LLFF: photos in images/, and poses_bounds.npy with 17 numbers per photo.

Rows are in the order of the photo names. A row is a 3x5 matrix (row-major), then the minimum and
maximum depth. Matrix columns: camera axes down, right and back in the world; camera position; h, w and
f in pixels. Downscaled photos (images_4/, images_8/) keep their rows. Lengths have an unknown scale.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import read_array
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.camera_resolution import get_stated_camera
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_INVALID,
    SCAN_FILES_MISSING,
    SCAN_TABLE_DAMAGED,
)
from scanloom.stages.scans.image_folders.image_files import extract_numbers, list_images
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.photo_masks import find_photo_mask
from scanloom.stages.scans.layouts.shared.posed_views import create_view_frame, to_metres
from scanloom.stages.scans.model.poses import check_rigid_pose
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, SkippedFrame
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

_POSES_FILE = "poses_bounds.npy"
_COLUMN_COUNT = 17
_MAX_VIEW_COUNT = 1 << 20
# The stored bounds are percentiles of the points, so the depth range is widened by this ratio.
_RANGE_MARGIN_RATIO = 0.1


def _matches(folder: Path) -> str | None:
    return (
        _POSES_FILE if (folder / _POSES_FILE).is_file() and _find_image_folder(folder) is not None else None
    )


def _find_image_folder(folder: Path) -> Path | None:
    """Return the folder of photos, preferring the highest resolution."""
    smaller = sorted(folder.glob("images_*"), key=lambda place: (extract_numbers(place.name), place.name))
    places = [place for place in (folder / "images", *smaller) if place.is_dir()]
    return next((place for place in places if list_images(place)), None)


def _read(folder: Path, options: ReadingParams) -> Scan:
    place = _find_image_folder(folder)
    if place is None:
        raise InputError(SCAN_FILES_MISSING, "a folder images/ with the photos is required.", folder)
    path = folder / _POSES_FILE
    rows = _read_rows(path)
    # Rows follow the lexicographic order of the names.
    colors = sorted(list_images(place), key=lambda color: color.name)
    names = [color.stem for color in colors]
    rows = list(trajectories.assign_by_number(rows, names, path, "rows"))
    given = options.resolve_file("poses", folder)
    if given is None:
        poses = [
            to_metres(_parse_pose(row, path, f"row {number}"), options.depth_scale)
            for number, row in enumerate(rows)
        ]
    else:
        poses = trajectories.match_poses_to_frames(trajectories.read_trajectory(given), names, given)
    frames: list[Frame] = []
    skipped: list[SkippedFrame] = []
    for color, row, pose in zip(colors, rows, poses, strict=True):
        try:
            camera = _parse_camera(folder, options, row, path)
            frame = create_view_frame(color.stem, camera, color, pose, mask=find_photo_mask(folder, color))
        except InputError as error:
            skipped.append(SkippedFrame(color.stem, error.diagnostic))
            continue
        frames.append(frame if given else replace(frame, depth_range=_parse_depth_range(row, options)))
    is_metric = given is not None or options.depth_scale is not None
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), is_metric=is_metric)


def _read_rows(path: Path) -> list[NDArray[np.float64]]:
    table = read_array(path, "the table of poses")
    if (
        table.ndim != 2
        or table.shape[1] != _COLUMN_COUNT
        or len(table) > _MAX_VIEW_COUNT
        or table.dtype.kind != "f"
    ):
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "rows of {columns} numbers are expected, but the array has shape {table_shape} and type "
            "{table_dtype}.",
            path,
            columns=_COLUMN_COUNT,
            table_shape=table.shape,
            table_dtype=table.dtype,
        )
    return list(np.array(table, np.float64))


def _parse_pose(row: NDArray[np.float64], path: Path, where: str) -> Pose | None:
    down, right, back, at = row[:15].reshape(3, 5).T[:4]
    return check_rigid_pose(np.column_stack([right, down, -back, at]), path, where)


def _parse_camera(folder: Path, options: ReadingParams, row: NDArray[np.float64], path: Path) -> Camera:
    height, width, focal = row[4:15:5].tolist()
    if not all(1 <= side < 1 << 16 and side == int(side) for side in (width, height)):
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "the file states an invalid image size of {width:g}×{height:g} pixels.",
            path,
            width=width,
            height=height,
        )
    size = int(width), int(height)
    camera = Camera(*size, focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2)
    return get_stated_camera(options, folder, *size) or calibration.check_camera_values(camera, path)


def _parse_depth_range(row: NDArray[np.float64], options: ReadingParams) -> tuple[float, float] | None:
    near, far = (row[15:] / (options.depth_scale or 1.0)).tolist()
    return (
        (near / (1 + _RANGE_MARGIN_RATIO), far * (1 + _RANGE_MARGIN_RATIO))
        if 0 < near < far < np.inf
        else None
    )


LAYOUT = Layout(
    name="llff",
    description="poses_bounds.npy, images/, optionally masks/ (LLFF)",
    matches=_matches,
    read=_read,
)
