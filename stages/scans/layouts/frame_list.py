"""JSON list of frames, each with camera, pose and depth unit (align3d).

    frames.json                        {"root": [{"info": {…}, …}, …]}; may name the images
    frame_00000_rgb.png  frame_00000_depth.png  …

Fields of `info`: `kcam.matrix` 3x3, `kcam.undist_coeff`, `kcam.image_size`; `depth_scale`, metres per
depth unit; `depth_bias`, metres added to every depth; `depth_max`, maximum valid depth in depth units;
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
from scanloom.stages.files.images import read_raw_depth
from scanloom.stages.files.noting import only_looking
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.resolution import stated_camera
from scanloom.stages.scans.codes import SCAN_ASSUMED, SCAN_FILES_MISSING, SCAN_TABLE_DAMAGED
from scanloom.stages.scans.image_folders.image_files import DEPTHS, IMAGES, common_size, inside, numbers
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.poses import divided, matrix_of, rigid
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Packed, Pose, Scan
from scanloom.stages.scans.trajectory import files as trajectories

_NAMES = ("frames.json", "info.json", "data.json", "scan_info.json", "dataset.json")
_COLOR = ("rgb", "color", "colour")
_KCAM = {"matrix": "matrix", "undist_coeff": "distortion", "image_size": "image_size"}
_LOOKED_AT = 4
# If more than this ratio of the depth exceeds depth_max, depth_max has another unit than the depth.
_MOST_BEYOND = 0.5
# Smaller ratios of depth beyond depth_max are not reported.
_LEAST_TOLD = 0.001
_FARTHEST_BIAS_M = 10.0


def _matches(folder: Path) -> str | None:
    with only_looking():
        found = _list_of_frames(folder)
        path = _named_in(folder) if found is None else found[0]
    return None if path is None else f"{path.name}, a list of frames with kcam and rt_cam"


def _named_in(folder: Path) -> Path | None:
    """Return a file with the keys of a frame list, even if damaged."""
    for path in (folder / name for name in _NAMES):
        try:
            text = documents.read_text(path) if path.is_file() else ""
        except InputError:
            continue
        if all(f'"{word}"' in text for word in ("kcam", "rt_cam")):
            return path
    return None


def _list_of_frames(folder: Path) -> tuple[Path, list[dict[str, Any]]] | None:
    for path in (folder / name for name in _NAMES):
        try:
            document = documents.read_json(path) if path.is_file() else None
        except InputError:
            continue
        entries = document.get("root") if isinstance(document, dict) else document
        if not isinstance(entries, list) or not entries or not all(isinstance(one, dict) for one in entries):
            continue
        if all("kcam" in _info(one) and "rt_cam" in _info(one) for one in entries):
            return path, entries
    return None


def _info(entry: dict[str, Any]) -> dict[str, Any]:
    info = entry.get("info", entry)
    return info if isinstance(info, dict) else {}


def _read(folder: Path, options: ReadingParams) -> Scan:
    found = _list_of_frames(folder)
    if found is None and (damaged := _named_in(folder)) is not None:
        documents.read_json(damaged)
    if found is None:
        raise InputError(
            SCAN_FILES_MISSING, "a JSON list of frames with kcam and rt_cam is required.", folder
        )
    path, entries = found
    images = [_images(folder, entry, number, path) for number, entry in enumerate(entries)]
    size = common_size([depth for _, depth in images])
    stated = stated_camera(options, folder, *size)
    given = options.file("poses", folder)
    names = [depth.stem for _, depth in images]
    trajectory = None if given is None else trajectories.read_trajectory(given)
    poses = (
        [_pose(entry, number, path) for number, entry in enumerate(entries)]
        if trajectory is None or given is None
        else trajectories.match(trajectory, names, given)
    )
    meanings = [_meaning(_info(entry), options, path) for entry in entries]
    meanings = _checked(meanings, [depth for _, depth in images], path)
    frames = [
        Frame(
            name=name,
            camera=stated or _camera(_info(entry), size, path),
            color=color,
            depth=_meant(depth, meaning),
            depth_scale=meaning.scale,
            world_from_camera=pose,
        )
        for name, entry, (color, depth), meaning, pose in zip(
            names, entries, images, meanings, poses, strict=True
        )
    ]
    return Scan(LAYOUT.name, frames, None, folder)


def _images(folder: Path, entry: dict[str, Any], number: int, path: Path) -> tuple[Path | None, Path]:
    """Return colour image (or None) and depth map of a frame.

    The files are those that the entry names, or those with the number of the frame.
    """
    named = {
        key: inside(folder, value, f"frame {number}: {key}", path)
        for key, value in (*entry.items(), *_info(entry).items())
        if isinstance(value, str) and value.lower().endswith(DEPTHS)
    }
    color = next((file for key, file in named.items() if any(word in key.lower() for word in _COLOR)), None)
    depth = next((file for key, file in named.items() if "depth" in key.lower()), None)
    if depth is None:
        beside = [one for one in folder.iterdir() if numbers(one.stem)[:1] == (number,)]
        depth = next((one for one in beside if "depth" in one.stem and one.suffix.lower() in DEPTHS), None)
        color = color or next(
            (
                one
                for one in beside
                if any(word in one.stem for word in _COLOR) and one.suffix.lower() in IMAGES
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


def _camera(info: dict[str, Any], size: tuple[int, int], path: Path) -> Camera:
    table = info["kcam"] if isinstance(info["kcam"], dict) else {}
    return calibration.camera_from_table(
        {"matrix": None} | {name: table[key] for key, name in _KCAM.items() if key in table}, *size, path
    )


@dataclass(frozen=True)
class _Meaning:
    """Interpretation of stored depth values.

    `scale` is in units per metre, `bias_m` in metres, `most` the maximum valid value in units.
    """

    scale: float
    bias_m: float
    most: float | None


def _meaning(info: dict[str, Any], options: ReadingParams, path: Path) -> _Meaning:
    step = info.get("depth_scale", 0.001)
    if not _is_number(step) or not 1e-9 < step < 1e9:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "depth_scale is {step}; it must be a positive number.",
            path,
            step=str(step)[:40],
        )
    bias, most = info.get("depth_bias", 0.0), info.get("depth_max")
    if not _is_number(bias) or abs(bias) > _FARTHEST_BIAS_M:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "depth_bias is {bias}; it must be an offset in metres, at most ±10.",
            path,
            bias=str(bias)[:40],
        )
    if most is not None and (not _is_number(most) or not most > 0):
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "depth_max is {most}; it must be a positive number.",
            path,
            most=str(most)[:40],
        )
    # The file states metres per unit.
    return _Meaning(options.depth_scale or 1 / step, float(bias), None if most is None else float(most))


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _checked(meanings: Sequence[_Meaning], depths: Sequence[Path], path: Path) -> list[_Meaning]:
    """Drop depth_max from all frames if it would discard most depth.

    A sample of the depth maps decides. Warns if depth is discarded or depth_max is ignored.
    """
    limits = {meaning.most for meaning in meanings} - {None}
    beyond = _share_beyond(meanings, depths)
    if not limits or beyond < _LEAST_TOLD:
        return list(meanings)
    most, scale = max(one for one in limits if one is not None), meanings[0].scale
    far = most / scale
    if beyond <= _MOST_BEYOND:
        emit(
            SCAN_ASSUMED.warning(
                "{beyond:.1%} of the sampled depth exceeds depth_max in {file} ({far:.3g} m) and is ignored",
                beyond=beyond,
                file=path.name,
                far=far,
            )
        )
        return list(meanings)
    emit(
        SCAN_ASSUMED.warning(
            "{beyond:.0%} of the sampled depth exceeds depth_max in {file} ({far:.3g} m), so its unit "
            "seems wrong: depth_max is not applied",
            remedy="set fuse.max_depth=METRES to ignore distant depth",
            beyond=beyond,
            file=path.name,
            far=far,
        )
    )
    return [_Meaning(one.scale, one.bias_m, None) for one in meanings]


def _share_beyond(meanings: Sequence[_Meaning], depths: Sequence[Path]) -> float:
    known = beyond = 0
    step = max(1, len(depths) // _LOOKED_AT)
    for meaning, depth in list(zip(meanings, depths, strict=True))[::step]:
        try:
            raw = read_raw_depth(depth)
        except InputError:
            continue
        known += int(np.count_nonzero(raw > 0))
        beyond += 0 if meaning.most is None else int(np.count_nonzero(raw > meaning.most))
    return beyond / max(known, 1)


def _meant(depth: Path, meaning: _Meaning) -> Path | Packed:
    """Return the corrected depth map, or the unchanged file."""
    if not meaning.bias_m and meaning.most is None:
        return depth
    name = f"depth + {meaning.bias_m:.9g} m" if meaning.bias_m else "depth"
    name += "" if meaning.most is None else f" to {meaning.most:.9g}"
    return Packed(depth, name, partial(_read_meant, depth, meaning))


def _read_meant(path: Path, meaning: _Meaning) -> NDArray[np.float32]:
    raw = read_raw_depth(path)
    is_known = raw > 0 if meaning.most is None else (raw > 0) & (raw <= meaning.most)
    return np.where(is_known, raw + meaning.bias_m * meaning.scale, 0).astype(np.float32)


def _pose(entry: dict[str, Any], number: int, path: Path) -> Pose | None:
    held = _info(entry)["rt_cam"]
    matrix = held.get("matrix") if isinstance(held, dict) else held
    where = f"frame {number}: rt_cam"
    return rigid(divided(matrix_of(matrix, path, where)), path, where)


LAYOUT = Layout(
    name="frame-list",
    text="frames.json, a list of frames with kcam and rt_cam, and their images (align3d)",
    matches=_matches,
    read=_read,
)
