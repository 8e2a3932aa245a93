"""Record3D: `metadata.json`, `rgb/` and `depth/`, or all in one `.r3d` zip archive.

Poses are camera-to-world with OpenGL camera axes (y up, z back); quaternions have the scalar last. `K`
is column-major, for colour images of `w` × `h`.
"""

from __future__ import annotations

import functools
import math
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents, lzfse_blocks
from scanloom.stages.files.images import decode_color, read_raw_depth
from scanloom.stages.files.zip_archives import open_archive, read_entry
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.camera_resolution import get_stated_camera
from scanloom.stages.scans.calibration.table_values import flatten_numbers
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING, SCAN_FILES_MISSING, SCAN_TABLE_DAMAGED
from scanloom.stages.scans.image_folders.image_files import (
    DEPTH_SUFFIXES,
    IMAGE_SUFFIXES,
    extract_numbers,
    find_common_size,
    find_first_existing,
    list_images,
    match_by_number,
)
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.phone_scans import resolve_min_confidence, scale_to_size
from scanloom.stages.scans.layouts.shared.posed_views import create_depth_missing_error
from scanloom.stages.scans.model.poses import create_pose_from_quaternion, from_opengl
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, ColorImage, Frame, PackedImage, Pose, Scan, SkippedFrame
from scanloom.stages.scans.model.world import Y_UP
from scanloom.stages.scans.recordings.recording_selection import find_single_recording
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

_CONFIDENCE_LEVELS = (0, 1, 2)
# Sizes of LiDAR and TrueDepth depth maps, for archives that do not state one.
_DEPTH_SIZES = ((256, 192), (192, 256), (640, 480), (480, 640))
# Maximum size of an image or of the metadata of hours of recording.
_MAX_ENTRY_BYTES = 1 << 28


@dataclass(frozen=True, eq=False)
class _FrameMetadata:
    """Pose, timestamp and camera of a frame from the metadata."""

    pose: Pose | None
    timestamp: int | None
    camera: Camera


def _matches(folder: Path) -> str | None:
    if (folder / "metadata.json").is_file() and (folder / "rgb").is_dir():
        return "metadata.json and rgb/"
    return next((file.name for file in sorted(folder.glob("*.r3d"))), None)


def _read(folder: Path, options: ReadingParams) -> Scan:
    if (folder / "metadata.json").exists():
        return _read_folder(folder, options)
    return _read_archive(folder, find_single_recording(folder, ".r3d"), options)


def _read_folder(folder: Path, options: ReadingParams) -> Scan:
    path = folder / "metadata.json"
    depths, colors, confidences = (
        list_images(folder / name, suffixes) if (folder / name).is_dir() else []
        for name, suffixes in (
            ("depth", DEPTH_SUFFIXES),
            ("rgb", IMAGE_SUFFIXES),
            (_find_confidence_folder(folder), IMAGE_SUFFIXES),
        )
    )
    if not depths:
        raise create_depth_missing_error(folder, "Record3D writes depth/ if the export includes EXR files.")
    pairs, skipped = match_by_number(depths, colors, "depth/", "rgb/", folder)
    names = [depth.stem for depth, _ in pairs]
    frame_metadata = _parse_frame_metadata(documents.read_json(path), names, path, options, folder)
    size, color_size = (find_common_size(stream) for stream in zip(*pairs, strict=True))
    min_confidence = resolve_min_confidence(options, _CONFIDENCE_LEVELS, folder) if confidences else 0
    scale = options.depth_scale or _infer_depth_scale([depth for depth, _ in pairs])
    by_number = {extract_numbers(file.stem): file for file in confidences}
    frames = []
    for (depth, color), moment in zip(pairs, frame_metadata, strict=True):
        scale_to_size(moment.camera, color_size, "the images", path)
        frames.append(
            Frame(
                name=depth.stem,
                camera=scale_to_size(moment.camera, size, "the depth maps", path),
                color=color,
                depth=depth,
                depth_scale=scale,
                world_from_camera=moment.pose,
                timestamp=moment.timestamp,
                color_camera=moment.camera,
                confidence=by_number.get(extract_numbers(depth.stem)),
                min_confidence=min_confidence,
            )
        )
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped))


def _find_confidence_folder(folder: Path) -> str:
    found = find_first_existing(folder, "confidence", "conf")
    return "confidence" if found is None else found.name


def _infer_depth_scale(depths: Sequence[Path]) -> float:
    """Return the depth units per metre, by the type of the values.

    Float depth is in metres, integer depth in millimetres.
    """
    kinds = (_read_dtype_kind(depth) for depth in depths)
    return 1.0 if next((kind for kind in kinds if kind is not None), "u") == "f" else 1000.0


def _read_dtype_kind(depth: Path) -> str | None:
    """Return the NumPy dtype kind of a depth file, or None.

    None if the file is unreadable.
    """
    try:
        return read_raw_depth(depth).dtype.kind
    except InputError:
        return None


def _read_archive(folder: Path, path: Path, options: ReadingParams) -> Scan:
    archive = open_archive(path)
    entries = {entry.filename for entry in archive.infolist()}
    table = documents.parse_json(_decode_text(_read_entry(archive, "metadata", path), path), path)
    found = sorted((n[0], name[5:-4]) for name in entries if (n := _parse_entry_number(name, ".jpg")))
    if not found:
        raise InputError(SCAN_FILES_MISSING, "the archive has no images named like rgbd/0.jpg.", path)
    stems = [stem for _, stem in found if f"rgbd/{stem}.depth" in entries]
    if not stems:
        raise create_depth_missing_error(
            path, "In .r3d archives, Record3D stores depth as rgbd/0.depth and so on."
        )
    lacking = FRAME_IMAGE_MISSING.warning("its depth map is missing")
    skipped = [SkippedFrame(stem, lacking) for _, stem in found if stem not in set(stems)]
    frame_metadata = _parse_frame_metadata(table, stems, path, options, folder)
    size = _find_depth_size(table, archive, [f"rgbd/{stem}.depth" for stem in stems], path)
    has_confidence = any(name.endswith(".conf") for name in entries)
    min_confidence = resolve_min_confidence(options, _CONFIDENCE_LEVELS, folder) if has_confidence else 0
    frames = []
    for stem, moment in zip(stems, frame_metadata, strict=True):
        trust = f"rgbd/{stem}.conf"
        frames.append(
            Frame(
                name=stem,
                camera=scale_to_size(moment.camera, size, "the depth maps", path),
                color=_wrap_entry(path, f"rgbd/{stem}.jpg", _read_color, archive, moment.camera),
                depth=_wrap_entry(path, f"rgbd/{stem}.depth", _read_values, archive, size, np.float32),
                depth_scale=options.depth_scale or 1.0,
                world_from_camera=moment.pose,
                timestamp=moment.timestamp,
                color_camera=moment.camera,
                confidence=_wrap_entry(path, trust, _read_values, archive, size, np.uint8)
                if trust in entries
                else None,
                min_confidence=min_confidence,
            )
        )
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped))


def _parse_entry_number(name: str, suffix: str) -> tuple[int, ...]:
    stem = name[5 : -len(suffix)]
    return (int(stem),) if name == f"rgbd/{stem}{suffix}" and stem.isascii() and stem.isdigit() else ()


def _wrap_entry(path: Path, name: str, load: Any, archive: zipfile.ZipFile, *known: object) -> PackedImage:
    return PackedImage(path, name, functools.partial(load, archive, name, path, *known))


def _read_color(archive: zipfile.ZipFile, name: str, path: Path, camera: Camera) -> ColorImage:
    image = decode_color(_read_entry(archive, name, path), f"{path}: {name}")
    scale_to_size(camera, (image.shape[1], image.shape[0]), f"the pixels of {name}", path)
    return image


def _read_values(
    archive: zipfile.ZipFile, name: str, path: Path, size: tuple[int, int], kind: type[np.generic]
) -> NDArray[Any]:
    """Decompress an LZFSE entry into an image (h, w).

    Parameters
    ----------
    size : (width, height) in pixels.
    kind : dtype of the pixels.
    """
    width, height = size
    data = lzfse_blocks.decompress_lzfse(
        _read_entry(archive, name, path), width * height * np.dtype(kind).itemsize, f"{path}: {name}"
    )
    return np.frombuffer(data, np.dtype(kind).newbyteorder("<")).reshape(height, width)


def _read_entry(archive: zipfile.ZipFile, name: str, path: Path) -> bytes:
    return read_entry(archive, name, path, _MAX_ENTRY_BYTES)


def _decode_text(data: bytes, path: Path) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(SCAN_TABLE_DAMAGED, "metadata.json is not valid UTF-8.", path) from error


def _find_depth_size(
    table: object, archive: zipfile.ZipFile, names: Sequence[str], path: Path
) -> tuple[int, int]:
    """Return the size (width, height) of the depth maps.

    Taken from the metadata, or else the usual size that has the same number of pixels.
    """
    stated = tuple(table.get(key) for key in ("dw", "dh")) if isinstance(table, dict) else (None, None)
    if stated != (None, None):
        return _parse_pixels(stated[0], "dw", path), _parse_pixels(stated[1], "dh", path)
    width, height = (
        (_parse_pixels(table.get(key), key, path) for key in "wh") if isinstance(table, dict) else (1, 1)
    )
    # Several entries, because the first may be damaged.
    counts = {lzfse_blocks.sum_block_sizes(_read_entry(archive, name, path)) for name in names[:8]}
    for size in _DEPTH_SIZES:
        if 4 * size[0] * size[1] in counts and (size[0] > size[1]) == (width > height):
            return size
    raise InputError(SCAN_TABLE_DAMAGED, "the metadata lacks the size of the depth maps (dw, dh).", path)


def _parse_frame_metadata(
    table: object, names: Sequence[str], path: Path, options: ReadingParams, folder: Path
) -> list[_FrameMetadata]:
    """Return pose, timestamp and camera of each frame."""
    if not isinstance(table, dict):
        raise InputError(SCAN_TABLE_DAMAGED, "the metadata must be a JSON object.", path)
    shared = _parse_camera(table, path, options, folder)
    times, own = table.get("frameTimestamps"), table.get("perFrameIntrinsicCoeffs")
    entries = table.get("poses")
    if not isinstance(entries, list) or not entries:
        raise InputError(SCAN_TABLE_DAMAGED, "the metadata has no list of poses.", path)
    given = options.resolve_file("poses", folder)
    stated_values: list[tuple[object, object, object]] = [
        (entry, _get_frame_value(times, i, len(entries)), _get_frame_value(own, i, len(entries)))
        for i, entry in enumerate(entries)
    ]
    frame_metadata = []
    for name, (entry, time, coefficients) in zip(
        names, trajectories.assign_by_number(stated_values, names, path, "poses"), strict=True
    ):
        frame_metadata.append(
            _FrameMetadata(
                _parse_pose(entry, path, f"frame {name}") if given is None else None,
                _parse_nanoseconds(time, path, name),
                shared
                if coefficients is None
                else _parse_frame_camera(coefficients, shared, path, f"frame {name}"),
            )
        )
    if given is None:
        return frame_metadata
    poses = trajectories.match_poses_to_frames(trajectories.read_trajectory(given), names, given)
    return [
        _FrameMetadata(pose, m.timestamp, m.camera) for pose, m in zip(poses, frame_metadata, strict=True)
    ]


def _get_frame_value(values: object, position: int, count: int) -> object:
    """Return the value of a frame from a per-frame list, or None.

    None if the list does not have one value per frame.
    """
    return values[position] if isinstance(values, list) and len(values) == count else None


def _parse_camera(table: dict[str, Any], path: Path, options: ReadingParams, folder: Path) -> Camera:
    width, height = (_parse_pixels(table.get(key), key, path) for key in "wh")
    stated = get_stated_camera(options, folder, width, height)
    if stated is not None:
        return stated
    row = flatten_numbers(table.get("K"), "K", path)
    if len(row) != 9:
        raise InputError(SCAN_TABLE_DAMAGED, "K in the metadata must be 9 numbers.", path)
    matrix = np.reshape(row, (3, 3)).T
    if not np.allclose(matrix[2], (0, 0, 1)):
        raise InputError(SCAN_TABLE_DAMAGED, "the third row of K must be 0 0 1 (K is column-major).", path)
    return calibration.create_camera_from_matrix(matrix, (), width, height, path)


def _parse_frame_camera(value: object, shared: Camera, path: Path, where: str) -> Camera:
    row = flatten_numbers(value, f"perFrameIntrinsicCoeffs of {where}", path)
    if len(row) != 4:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "perFrameIntrinsicCoeffs of {place} must be 4 numbers: fx, fy, cx, cy.",
            path,
            place=where,
        )
    fx, fy, cx, cy = row
    return calibration.check_camera_values(Camera(shared.width, shared.height, fx, fy, cx, cy), path)


def _parse_pose(entry: object, path: Path, where: str) -> Pose | None:
    row = flatten_numbers(entry, f"the pose of {where}", path)
    if len(row) != 7:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "the pose of {place} must be 7 numbers: qx qy qz qw tx ty tz.",
            path,
            place=where,
        )
    pose = create_pose_from_quaternion(row[4:], row[:4], path, where)
    return None if pose is None else from_opengl(pose)


def _parse_nanoseconds(seconds: object, path: Path, name: str) -> int | None:
    if seconds is None:
        return None
    if isinstance(seconds, bool) or not isinstance(seconds, (int, float)) or not abs(seconds) < 1 << 32:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "frame {name}: invalid timestamp {seconds!r} (seconds).",
            path,
            name=name,
            seconds=str(seconds)[:40],
        )
    return round(seconds * 1e9)


def _parse_pixels(value: object, key: str, path: Path) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 1 <= value < 1 << 14:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "{key} in the metadata is {value!r}; an image size in pixels is expected.",
            path,
            key=key,
            value=str(value)[:40],
        )
    return math.floor(value)


LAYOUT = Layout(
    name="record3d",
    description="metadata.json, rgb/, depth/*.exr|npy|png, or .r3d (Record3D)",
    matches=_matches,
    read=_read,
    suffixes=(".r3d",),
    up=Y_UP,
    is_gravity_aligned=True,
)
