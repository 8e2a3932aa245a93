"""JSON list of frames, each with camera, pose and depth unit (align3d).

    frames.json                        {"root": [{"info": {…}, …}, …]}; may name the images
    frame_00000_rgb.png  frame_00000_depth.png  …

Fields of `info`: `kcam.matrix` 3x3, `kcam.undist_coeff`, `kcam.read_image_size`; `choose_depth_scale`, metres
per depth unit; `depth_bias`, metres added to every depth; `depth_max`, maximum valid depth in depth units;
`rt_cam.matrix` 4x4, camera-to-world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.files.file_access_log import pause_recording
from scanloom.stages.files.images import read_raw_depth
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.camera_resolution import get_stated_camera
from scanloom.stages.scans.codes import SCAN_ASSUMED, SCAN_FILES_MISSING, SCAN_TABLE_DAMAGED
from scanloom.stages.scans.image_folders.image_files import (
    DEPTH_SUFFIXES,
    IMAGE_SUFFIXES,
    extract_numbers,
    find_common_size,
    resolve_inside,
)
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.poses import check_rigid_pose, normalise_homogeneous, parse_pose_matrix
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, PackedImage, Pose, Scan
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

_LIST_NAMES = ("frames.json", "info.json", "data.json", "scan_info.json", "dataset.json")
_COLOR_WORDS = ("rgb", "color", "colour")
_KCAM_KEYS = {"matrix": "matrix", "undist_coeff": "distortion", "image_size": "image_size"}
_SAMPLE_COUNT = 4
# If more than this ratio of the depth exceeds depth_max, depth_max has another unit than the depth.
_MAX_BEYOND_RATIO = 0.5
# Smaller ratios of depth beyond depth_max are not reported.
_MIN_REPORTED_RATIO = 0.001
_MAX_BIAS_M = 10.0


def _matches(folder: Path) -> str | None:
    with pause_recording():
        found = _find_frame_list(folder)
        path = _find_damaged_list(folder) if found is None else found[0]
    return None if path is None else f"{path.name}, a list of frames with kcam and rt_cam"


def _find_damaged_list(folder: Path) -> Path | None:
    """Return a file with the keys of a frame list, even if damaged."""
    for path in (folder / name for name in _LIST_NAMES):
        try:
            text = documents.read_text(path) if path.is_file() else ""
        except InputError:
            continue
        if all(f'"{word}"' in text for word in ("kcam", "rt_cam")):
            return path
    return None


def _find_frame_list(folder: Path) -> tuple[Path, list[dict[str, Any]]] | None:
    for path in (folder / name for name in _LIST_NAMES):
        try:
            document = documents.read_json(path) if path.is_file() else None
        except InputError:
            continue
        entries = document.get("root") if isinstance(document, dict) else document
        if not isinstance(entries, list) or not entries or not all(isinstance(one, dict) for one in entries):
            continue
        if all("kcam" in _get_info(one) and "rt_cam" in _get_info(one) for one in entries):
            return path, entries
    return None


def _get_info(entry: dict[str, Any]) -> dict[str, Any]:
    info = entry.get("info", entry)
    return info if isinstance(info, dict) else {}


def _read(folder: Path, options: ReadingParams) -> Scan:
    found = _find_frame_list(folder)
    if found is None and (damaged := _find_damaged_list(folder)) is not None:
        documents.read_json(damaged)
    if found is None:
        raise InputError(
            SCAN_FILES_MISSING, "a JSON list of frames with kcam and rt_cam is required.", folder
        )
    path, entries = found
    images = [_find_images(folder, entry, number, path) for number, entry in enumerate(entries)]
    size = find_common_size([depth for _, depth in images])
    stated = get_stated_camera(options, folder, *size)
    given = options.resolve_file("poses", folder)
    names = [depth.stem for _, depth in images]
    trajectory = None if given is None else trajectories.read_trajectory(given)
    poses = (
        [_parse_pose(entry, number, path) for number, entry in enumerate(entries)]
        if trajectory is None or given is None
        else trajectories.match_poses_to_frames(trajectory, names, given)
    )
    encodings = [_parse_depth_encoding(_get_info(entry), options, path) for entry in entries]
    encodings = _check_max_depth(encodings, [depth for _, depth in images], path)
    frames = [
        Frame(
            name=name,
            camera=stated or _parse_camera(_get_info(entry), size, path),
            color=color,
            depth=_wrap_depth(depth, encoding),
            depth_scale=encoding.units_per_metre,
            world_from_camera=pose,
        )
        for name, entry, (color, depth), encoding, pose in zip(
            names, entries, images, encodings, poses, strict=True
        )
    ]
    return Scan(LAYOUT.name, frames, None, folder)


def _find_images(folder: Path, entry: dict[str, Any], number: int, path: Path) -> tuple[Path | None, Path]:
    """Return colour image (or None) and depth map of a frame.

    The files are those that the entry names, or those with the number of the frame.
    """
    named = {
        key: resolve_inside(folder, value, f"frame {number}: {key}", path)
        for key, value in (*entry.items(), *_get_info(entry).items())
        if isinstance(value, str) and value.lower().endswith(DEPTH_SUFFIXES)
    }
    color = next(
        (file for key, file in named.items() if any(word in key.lower() for word in _COLOR_WORDS)), None
    )
    depth = next((file for key, file in named.items() if "depth" in key.lower()), None)
    if depth is None:
        beside = [one for one in folder.iterdir() if extract_numbers(one.stem)[:1] == (number,)]
        depth = next(
            (one for one in beside if "depth" in one.stem and one.suffix.lower() in DEPTH_SUFFIXES), None
        )
        color = color or next(
            (
                one
                for one in beside
                if any(word in one.stem for word in _COLOR_WORDS) and one.suffix.lower() in IMAGE_SUFFIXES
            ),
            None,
        )
    if depth is None:
        raise InputError(
            SCAN_FILES_MISSING,
            "frame {number} names no depth map, and the folder has none with this number.",
            path,
            number=number,
        )
    return color, depth


def _parse_camera(info: dict[str, Any], size: tuple[int, int], path: Path) -> Camera:
    table = info["kcam"] if isinstance(info["kcam"], dict) else {}
    return calibration.parse_camera_table(
        {"matrix": None} | {name: table[key] for key, name in _KCAM_KEYS.items() if key in table}, *size, path
    )


@dataclass(frozen=True)
class _DepthEncoding:
    """Interpretation of stored depth values.

    `units_per_metre` is in units per metre, `bias_m` in metres, `max_value` the maximum valid value in units.
    """

    units_per_metre: float
    bias_m: float
    max_value: float | None


def _parse_depth_encoding(info: dict[str, Any], options: ReadingParams, path: Path) -> _DepthEncoding:
    step = info.get("depth_scale", 0.001)
    if not _is_number(step) or not 1e-9 < step < 1e9:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "depth_scale is {step}; it must be a positive number.",
            path,
            step=str(step)[:40],
        )
    bias, max_value = info.get("depth_bias", 0.0), info.get("depth_max")
    if not _is_number(bias) or abs(bias) > _MAX_BIAS_M:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "depth_bias is {bias}; it must be an offset in metres, at most ±10.",
            path,
            bias=str(bias)[:40],
        )
    if max_value is not None and (not _is_number(max_value) or not max_value > 0):
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "depth_max is {most}; it must be a positive number.",
            path,
            most=str(max_value)[:40],
        )
    # The file states metres per unit.
    return _DepthEncoding(
        options.depth_scale or 1 / step, float(bias), None if max_value is None else float(max_value)
    )


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _check_max_depth(
    encodings: Sequence[_DepthEncoding], depths: Sequence[Path], path: Path
) -> list[_DepthEncoding]:
    """Drop depth_max from all frames if it would discard most depth.

    A sample of the depth maps decides. Warns if depth is discarded or depth_max is ignored.
    """
    limits = {meaning.max_value for meaning in encodings} - {None}
    beyond = _measure_ratio_beyond_max(encodings, depths)
    if not limits or beyond < _MIN_REPORTED_RATIO:
        return list(encodings)
    max_value, scale = max(one for one in limits if one is not None), encodings[0].units_per_metre
    max_depth_m = max_value / scale
    if beyond <= _MAX_BEYOND_RATIO:
        emit(
            SCAN_ASSUMED.warning(
                "{beyond:.1%} of the sampled depth exceeds depth_max in {file} ({far:.3g} m) and is ignored",
                beyond=beyond,
                file=path.name,
                far=max_depth_m,
            )
        )
        return list(encodings)
    emit(
        SCAN_ASSUMED.warning(
            "{beyond:.0%} of the sampled depth exceeds depth_max in {file} ({far:.3g} m), so its unit "
            "seems wrong: depth_max is not applied",
            remedy="set fuse.max_depth=METRES to ignore distant depth",
            beyond=beyond,
            file=path.name,
            far=max_depth_m,
        )
    )
    return [_DepthEncoding(one.units_per_metre, one.bias_m, None) for one in encodings]


def _measure_ratio_beyond_max(encodings: Sequence[_DepthEncoding], depths: Sequence[Path]) -> float:
    known = beyond = 0
    step = max(1, len(depths) // _SAMPLE_COUNT)
    for meaning, depth in list(zip(encodings, depths, strict=True))[::step]:
        try:
            raw = read_raw_depth(depth)
        except InputError:
            continue
        known += int(np.count_nonzero(raw > 0))
        beyond += 0 if meaning.max_value is None else int(np.count_nonzero(raw > meaning.max_value))
    return beyond / max(known, 1)


def _wrap_depth(depth: Path, encoding: _DepthEncoding) -> Path | PackedImage:
    """Return the corrected depth map, or the unchanged file."""
    if not encoding.bias_m and encoding.max_value is None:
        return depth
    name = f"depth + {encoding.bias_m:.9g} m" if encoding.bias_m else "depth"
    name += "" if encoding.max_value is None else f" to {encoding.max_value:.9g}"
    return PackedImage(depth, name, partial(_read_encoded_depth, depth, encoding))


def _read_encoded_depth(path: Path, encoding: _DepthEncoding) -> NDArray[np.float32]:
    raw = read_raw_depth(path)
    is_known = raw > 0 if encoding.max_value is None else (raw > 0) & (raw <= encoding.max_value)
    return np.where(is_known, raw + encoding.bias_m * encoding.units_per_metre, 0).astype(np.float32)


def _parse_pose(entry: dict[str, Any], number: int, path: Path) -> Pose | None:
    held = _get_info(entry)["rt_cam"]
    matrix = held.get("matrix") if isinstance(held, dict) else held
    where = f"frame {number}: rt_cam"
    return check_rigid_pose(normalise_homogeneous(parse_pose_matrix(matrix, path, where)), path, where)


LAYOUT = Layout(
    name="frame-list",
    description="frames.json, a list of frames with kcam and rt_cam, and their images (align3d)",
    matches=_matches,
    read=_read,
)
