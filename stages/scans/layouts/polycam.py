"""Polycam raw data: `keyframes/` with images, cameras, depth and confidence.

Poses are camera-to-world, in metres, with OpenGL camera axes (y up, z back). Phones without LiDAR write no
depth; their images are single views. Undistorted images have black borders, which are masked.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.files.images import decode_color, read_image_bytes
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.camera_resolution import get_stated_camera
from scanloom.stages.scans.codes import (
    FRAME_IMAGE_MISSING,
    SCAN_FILES_MISSING,
    SCAN_PHONE_IMAGES,
    SCAN_TABLE_DAMAGED,
)
from scanloom.stages.scans.image_folders.image_files import (
    IMAGE_SUFFIXES,
    extract_numbers,
    find_common_size,
    list_images,
)
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.phone_scans import resolve_min_confidence, scale_to_size
from scanloom.stages.scans.layouts.shared.posed_views import create_view_frame
from scanloom.stages.scans.model.poses import check_rigid_pose, from_opengl, parse_pose_matrix
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, PackedImage, Pose, Scan, SkippedFrame
from scanloom.stages.scans.model.world import Y_UP
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

_CONFIDENCE_LEVELS = (0, 127, 255)
# Undistorted images with optimised poses are preferred; long captures lack them.
_UNDISTORTED_FOLDER = "corrected_images"
_FOLDER_PAIRS = (("corrected_cameras", _UNDISTORTED_FOLDER), ("cameras", "images"))
# Maximum level of a black border: JPEG blurs neighbouring pixels into it.
_MAX_BLACK = 8
# Maximum border width as a ratio of the image side; a dark corner of the room may extend farther.
_MAX_BORDER_RATIO = 0.1


def _matches(folder: Path) -> str | None:
    keyframes = folder / "keyframes"
    found = next((cameras for cameras, _ in _FOLDER_PAIRS if (keyframes / cameras).is_dir()), None)
    return None if found is None else f"keyframes/{found}/"


def _read(folder: Path, options: ReadingParams) -> Scan:
    keyframes = folder / "keyframes"
    camera_files, colors = _find_camera_files(folder)
    depths = _list_by_stem(keyframes / "depth")
    confidences = _list_by_stem(keyframes / "confidence")
    min_confidence = (
        resolve_min_confidence(options, _CONFIDENCE_LEVELS, folder) if confidences and depths else 0
    )
    size = find_common_size(list(depths.values())) if depths else None
    color_size = find_common_size(list(colors.values()))
    stems = [file.stem for file in camera_files]
    masks = {
        stem: PackedImage(color, "border", partial(_mask_border, color))
        for stem, color in colors.items()
        if color.parent.name == _UNDISTORTED_FOLDER
    }
    given = options.resolve_file("poses", folder)
    poses = (
        None
        if given is None
        else trajectories.match_poses_to_frames(trajectories.read_trajectory(given), stems, given)
    )
    frames: list[Frame] = []
    skipped: list[SkippedFrame] = []
    for position, (stem, file) in enumerate(zip(stems, camera_files, strict=True)):
        needed = (("image", colors), ("depth map", depths)) if depths else (("image", colors),)
        lacking = next((what for what, held in needed if stem not in held), None)
        if lacking is not None:
            reason = FRAME_IMAGE_MISSING.warning("its {lacking} is missing", lacking=lacking)
            skipped.append(SkippedFrame(stem, reason))
            continue
        try:
            table = documents.read_document(file)
            color_camera = _parse_camera(table, file, options, folder, color_size)
            pose = _parse_pose(table, file) if poses is None else poses[position]
            if size is None:
                frames.append(create_view_frame(stem, color_camera, colors[stem], pose, mask=masks.get(stem)))
                continue
            frames.append(
                Frame(
                    name=stem,
                    camera=scale_to_size(color_camera, size, "the depth maps", file),
                    color=colors[stem],
                    depth=depths[stem],
                    depth_scale=options.depth_scale or 1000.0,
                    world_from_camera=pose,
                    timestamp=_parse_nanoseconds(stem),
                    color_camera=color_camera,
                    confidence=confidences.get(stem),
                    min_confidence=min_confidence,
                    mask=masks.get(stem),
                )
            )
        except InputError as error:
            skipped.append(SkippedFrame(stem, error.diagnostic))
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped))


def _find_camera_files(folder: Path) -> tuple[list[Path], dict[str, Path]]:
    """Return the camera files in order, and the images by stem."""
    keyframes = folder / "keyframes"
    for cameras, pictures in _FOLDER_PAIRS:
        if not (keyframes / cameras).is_dir() or not (keyframes / pictures).is_dir():
            continue
        files, colors = list_images(keyframes / cameras, (".json",)), _list_by_stem(keyframes / pictures)
        if files and colors:
            if cameras != _FOLDER_PAIRS[0][0]:
                emit(
                    SCAN_PHONE_IMAGES.warning(
                        "keyframes/corrected_cameras/ or corrected_images/ is missing or empty: unoptimised "
                        "poses, which drift, and slightly distorted images are used"
                    )
                )
            return files, colors
    raise InputError(
        SCAN_FILES_MISSING,
        "keyframes/ has neither corrected_cameras/ with corrected_images/ nor cameras/ with images/.",
        folder,
    )


def _list_by_stem(folder: Path) -> dict[str, Path]:
    return {file.stem: file for file in list_images(folder, IMAGE_SUFFIXES)} if folder.is_dir() else {}


def _mask_border(path: Path) -> NDArray[np.uint8]:
    """Mask the black border of an undistorted image.

    Returns (h, w) uint8, 0 in the border and 255 elsewhere.

    Raises
    ------
    InputError
        If the file is missing or does not decode.
    """
    import cv2

    image = decode_color(read_image_bytes(path), path)
    black = (image.max(axis=2) <= _MAX_BLACK).astype(np.uint8)
    height, width = black.shape
    deep, wide = int(_MAX_BORDER_RATIO * height), int(_MAX_BORDER_RATIO * width)
    black[deep : height - deep, wide : width - wide] = 0
    # A one-pixel frame connects all black regions that touch the image edge.
    framed = cv2.copyMakeBorder(black, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=1)
    _, labels = cv2.connectedComponents(framed, connectivity=4)
    border = (labels[1:-1, 1:-1] == labels[0, 0]).astype(np.uint8)
    # Grow by one pixel, which undistortion interpolated with black.
    border = cv2.dilate(border, np.ones((3, 3), np.uint8))
    return np.asarray(255 * (border == 0), np.uint8)


def _parse_camera(
    table: dict[str, Any], file: Path, options: ReadingParams, folder: Path, color_size: tuple[int, int]
) -> Camera:
    """Return the colour camera at the image size stated in its file.

    Raises
    ------
    InputError
        If the file is damaged or the images have another aspect ratio.
    """
    width, height = table.get("width"), table.get("height")
    if not isinstance(width, (int, float)) or not isinstance(height, (int, float)):
        raise InputError(SCAN_TABLE_DAMAGED, "width and height of the camera in pixels are missing.", file)
    if not (1 <= width < 1 << 16 and 1 <= height < 1 << 16):
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "invalid camera size of {width}×{height} pixels.",
            file,
            width=width,
            height=height,
        )
    table = table | {"width": int(width), "height": int(height)}
    camera = get_stated_camera(options, folder, int(width), int(height)) or calibration.parse_camera_table(
        table, int(width), int(height), file
    )
    scale_to_size(camera, color_size, "the images", file)
    return camera


def _parse_pose(table: dict[str, Any], file: Path) -> Pose | None:
    rows = [[table.get(f"t_{row}{column}") for column in range(4)] for row in range(3)]
    if any(value is None for row in rows for value in row):
        raise InputError(
            SCAN_TABLE_DAMAGED, "the pose is incomplete: t_00 to t_23 (three rows) are required.", file
        )
    pose = check_rigid_pose(parse_pose_matrix(rows, file, "t_00 to t_23"), file)
    return None if pose is None else from_opengl(pose)


def _parse_nanoseconds(stem: str) -> int | None:
    """Return the timestamp (ns) of a frame named in microseconds, or None."""
    return extract_numbers(stem)[0] * 1000 if stem.isdecimal() and len(stem) < 17 else None


LAYOUT = Layout(
    name="polycam",
    description="keyframes/ with corrected_cameras/ or cameras/, images and optionally depth/ (Polycam's "
    "raw data)",
    matches=_matches,
    read=_read,
    up=Y_UP,
    is_gravity_aligned=True,
)
