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
from scanloom.stages.files.zip_archives import entry_content, opened_archive
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.resolution import stated_camera
from scanloom.stages.scans.calibration.table_values import number_row
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING, SCAN_FILES_MISSING, SCAN_TABLE_DAMAGED
from scanloom.stages.scans.image_folders.image_files import (
    DEPTHS,
    IMAGES,
    common_size,
    first_existing,
    images,
    numbers,
    pair,
)
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.phones import least_confidence, seen_in
from scanloom.stages.scans.layouts.shared.views import without_depth
from scanloom.stages.scans.model.poses import from_opengl, pose_from_quaternion
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, ColorImage, Frame, Packed, Pose, Scan, SkippedFrame
from scanloom.stages.scans.model.world import Y_UP
from scanloom.stages.scans.recordings.choice import one_recording
from scanloom.stages.scans.trajectory import files as trajectories

_LEVELS = (0, 1, 2)
# Sizes of LiDAR and TrueDepth depth maps, for archives that do not state one.
_DEPTH_SIZES = ((256, 192), (192, 256), (640, 480), (480, 640))
# Maximum size of an image or of the metadata of hours of recording.
_MAX_ENTRY_BYTES = 1 << 28


@dataclass(frozen=True, eq=False)
class _Moment:
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
    return _read_archive(folder, one_recording(folder, ".r3d"), options)


def _read_folder(folder: Path, options: ReadingParams) -> Scan:
    path = folder / "metadata.json"
    depths, colors, trusts = (
        images(folder / name, suffixes) if (folder / name).is_dir() else []
        for name, suffixes in (("depth", DEPTHS), ("rgb", IMAGES), (_confidence_folder(folder), IMAGES))
    )
    if not depths:
        raise without_depth(folder, "Record3D writes depth/ if the export includes EXR files.")
    pairs, skipped = pair(depths, colors, "depth/", "rgb/", folder)
    names = [depth.stem for depth, _ in pairs]
    moments = _moments(documents.read_json(path), names, path, options, folder)
    size, color_size = (common_size(stream) for stream in zip(*pairs, strict=True))
    least = least_confidence(options, _LEVELS, folder) if trusts else 0
    scale = options.depth_scale or _units_a_metre([depth for depth, _ in pairs])
    by_number = {numbers(file.stem): file for file in trusts}
    frames = []
    for (depth, color), moment in zip(pairs, moments, strict=True):
        seen_in(moment.camera, color_size, "the images", path)
        frames.append(
            Frame(
                name=depth.stem,
                camera=seen_in(moment.camera, size, "the depth maps", path),
                color=color,
                depth=depth,
                depth_scale=scale,
                world_from_camera=moment.pose,
                timestamp=moment.timestamp,
                color_camera=moment.camera,
                confidence=by_number.get(numbers(depth.stem)),
                least_confidence=least,
            )
        )
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped))


def _confidence_folder(folder: Path) -> str:
    found = first_existing(folder, "confidence", "conf")
    return "confidence" if found is None else found.name


def _units_a_metre(depths: Sequence[Path]) -> float:
    """Return the depth units per metre, by the type of the values.

    Float depth is in metres, integer depth in millimetres.
    """
    kinds = (_kind(depth) for depth in depths)
    return 1.0 if next((kind for kind in kinds if kind is not None), "u") == "f" else 1000.0


def _kind(depth: Path) -> str | None:
    """Return the NumPy dtype kind of a depth file, or None.

    None if the file is unreadable.
    """
    try:
        return read_raw_depth(depth).dtype.kind
    except InputError:
        return None


def _read_archive(folder: Path, path: Path, options: ReadingParams) -> Scan:
    archive = opened_archive(path)
    entries = {entry.filename for entry in archive.infolist()}
    table = documents.parse_json(_text(_entry(archive, "metadata", path), path), path)
    found = sorted((n[0], name[5:-4]) for name in entries if (n := _number_of(name, ".jpg")))
    if not found:
        raise InputError(SCAN_FILES_MISSING, "the archive has no images named like rgbd/0.jpg.", path)
    stems = [stem for _, stem in found if f"rgbd/{stem}.depth" in entries]
    if not stems:
        raise without_depth(path, "In .r3d archives, Record3D stores depth as rgbd/0.depth and so on.")
    lacking = FRAME_IMAGE_MISSING.warning("its depth map is missing")
    skipped = [SkippedFrame(stem, lacking) for _, stem in found if stem not in set(stems)]
    moments = _moments(table, stems, path, options, folder)
    size = _depth_size(table, archive, [f"rgbd/{stem}.depth" for stem in stems], path)
    has_confidence = any(name.endswith(".conf") for name in entries)
    least = least_confidence(options, _LEVELS, folder) if has_confidence else 0
    frames = []
    for stem, moment in zip(stems, moments, strict=True):
        trust = f"rgbd/{stem}.conf"
        frames.append(
            Frame(
                name=stem,
                camera=seen_in(moment.camera, size, "the depth maps", path),
                color=_packed(path, f"rgbd/{stem}.jpg", _color, archive, moment.camera),
                depth=_packed(path, f"rgbd/{stem}.depth", _values, archive, size, np.float32),
                depth_scale=options.depth_scale or 1.0,
                world_from_camera=moment.pose,
                timestamp=moment.timestamp,
                color_camera=moment.camera,
                confidence=_packed(path, trust, _values, archive, size, np.uint8)
                if trust in entries
                else None,
                least_confidence=least,
            )
        )
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped))


def _number_of(name: str, suffix: str) -> tuple[int, ...]:
    stem = name[5 : -len(suffix)]
    return (int(stem),) if name == f"rgbd/{stem}{suffix}" and stem.isascii() and stem.isdigit() else ()


def _packed(path: Path, name: str, load: Any, archive: zipfile.ZipFile, *known: object) -> Packed:
    return Packed(path, name, functools.partial(load, archive, name, path, *known))


def _color(archive: zipfile.ZipFile, name: str, path: Path, camera: Camera) -> ColorImage:
    image = decode_color(_entry(archive, name, path), f"{path}: {name}")
    seen_in(camera, (image.shape[1], image.shape[0]), f"the pixels of {name}", path)
    return image


def _values(
    archive: zipfile.ZipFile, name: str, path: Path, size: tuple[int, int], kind: type[np.generic]
) -> NDArray[Any]:
    """Decompress an LZFSE entry into an image (h, w).

    Parameters
    ----------
    size : (width, height) in pixels.
    kind : dtype of the pixels.
    """
    width, height = size
    data = lzfse_blocks.decompress(
        _entry(archive, name, path), width * height * np.dtype(kind).itemsize, f"{path}: {name}"
    )
    return np.frombuffer(data, np.dtype(kind).newbyteorder("<")).reshape(height, width)


def _entry(archive: zipfile.ZipFile, name: str, path: Path) -> bytes:
    return entry_content(archive, name, path, _MAX_ENTRY_BYTES)


def _text(data: bytes, path: Path) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(SCAN_TABLE_DAMAGED, "metadata.json is not valid UTF-8.", path) from error


def _depth_size(table: object, archive: zipfile.ZipFile, names: Sequence[str], path: Path) -> tuple[int, int]:
    """Return the size (width, height) of the depth maps.

    Taken from the metadata, or else the usual size that has the same number of pixels.
    """
    stated = tuple(table.get(key) for key in ("dw", "dh")) if isinstance(table, dict) else (None, None)
    if stated != (None, None):
        return _pixels(stated[0], "dw", path), _pixels(stated[1], "dh", path)
    width, height = (
        (_pixels(table.get(key), key, path) for key in "wh") if isinstance(table, dict) else (1, 1)
    )
    # Several entries, because the first may be damaged.
    counts = {lzfse_blocks.raw_size(_entry(archive, name, path)) for name in names[:8]}
    for size in _DEPTH_SIZES:
        if 4 * size[0] * size[1] in counts and (size[0] > size[1]) == (width > height):
            return size
    raise InputError(SCAN_TABLE_DAMAGED, "the metadata lacks the size of the depth maps (dw, dh).", path)


def _moments(
    table: object, names: Sequence[str], path: Path, options: ReadingParams, folder: Path
) -> list[_Moment]:
    """Return pose, timestamp and camera of each frame."""
    if not isinstance(table, dict):
        raise InputError(SCAN_TABLE_DAMAGED, "the metadata must be a JSON object.", path)
    shared = _camera(table, path, options, folder)
    times, own = table.get("frameTimestamps"), table.get("perFrameIntrinsicCoeffs")
    entries = table.get("poses")
    if not isinstance(entries, list) or not entries:
        raise InputError(SCAN_TABLE_DAMAGED, "the metadata has no list of poses.", path)
    given = options.file("poses", folder)
    said: list[tuple[object, object, object]] = [
        (entry, _at(times, i, len(entries)), _at(own, i, len(entries))) for i, entry in enumerate(entries)
    ]
    moments = []
    for name, (entry, time, coefficients) in zip(
        names, trajectories.by_number(said, names, path, "poses"), strict=True
    ):
        moments.append(
            _Moment(
                _pose(entry, path, f"frame {name}") if given is None else None,
                _nanoseconds(time, path, name),
                shared if coefficients is None else _own_camera(coefficients, shared, path, f"frame {name}"),
            )
        )
    if given is None:
        return moments
    poses = trajectories.match(trajectories.read_trajectory(given), names, given)
    return [_Moment(pose, m.timestamp, m.camera) for pose, m in zip(poses, moments, strict=True)]


def _at(values: object, position: int, count: int) -> object:
    """Return the value of a frame from a per-frame list, or None.

    None if the list does not have one value per frame.
    """
    return values[position] if isinstance(values, list) and len(values) == count else None


def _camera(table: dict[str, Any], path: Path, options: ReadingParams, folder: Path) -> Camera:
    width, height = (_pixels(table.get(key), key, path) for key in "wh")
    stated = stated_camera(options, folder, width, height)
    if stated is not None:
        return stated
    row = number_row(table.get("K"), "K", path)
    if len(row) != 9:
        raise InputError(SCAN_TABLE_DAMAGED, "K in the metadata must be 9 numbers.", path)
    matrix = np.reshape(row, (3, 3)).T
    if not np.allclose(matrix[2], (0, 0, 1)):
        raise InputError(SCAN_TABLE_DAMAGED, "the third row of K must be 0 0 1 (K is column-major).", path)
    return calibration.matrix_camera(matrix, (), width, height, path)


def _own_camera(value: object, shared: Camera, path: Path, where: str) -> Camera:
    row = number_row(value, f"perFrameIntrinsicCoeffs of {where}", path)
    if len(row) != 4:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "perFrameIntrinsicCoeffs of {place} must be 4 numbers: fx, fy, cx, cy.",
            path,
            place=where,
        )
    fx, fy, cx, cy = row
    return calibration.checked(Camera(shared.width, shared.height, fx, fy, cx, cy), path)


def _pose(entry: object, path: Path, where: str) -> Pose | None:
    row = number_row(entry, f"the pose of {where}", path)
    if len(row) != 7:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "the pose of {place} must be 7 numbers: qx qy qz qw tx ty tz.",
            path,
            place=where,
        )
    pose = pose_from_quaternion(row[4:], row[:4], path, where)
    return None if pose is None else from_opengl(pose)


def _nanoseconds(seconds: object, path: Path, name: str) -> int | None:
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


def _pixels(value: object, key: str, path: Path) -> int:
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
    text="metadata.json, rgb/, depth/*.exr|npy|png, or .r3d (Record3D)",
    matches=_matches,
    read=_read,
    suffixes=(".r3d",),
    up=Y_UP,
    is_level=True,
)
