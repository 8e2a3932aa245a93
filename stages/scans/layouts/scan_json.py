"""scanloom's own RGB-D layout: `scan.json`, which describes a folder of images completely.

    {
      "version": 1,
      "camera": {"width": 640, "height": 480, "fx": 585, "fy": 585, "cx": 320, "cy": 240, "distortion": []},
      "depth_scale": 1000,            depth units per metre
      "depth_missing": [65535],       raw values that mark missing depth, in addition to 0
      "up": [0, 0, 1],                up direction in the world of the poses; optional
      "up_source": "a level",         origin of the up direction; optional
      "metric": true,                 false: lengths and depth have an unknown unit; optional
      "frames": [
        {
          "name": "000000",
          "color": "color/000000.png",   8-bit per channel; optional
          "depth": "depth/000000.png",   16-bit, or .npy float; optional
          "world_from_camera": [[r, r, r, x], [r, r, r, y], [r, r, r, z], [0, 0, 0, 1]],   metres; null: lost
          "timestamp": 33000000,         nanoseconds; optional
          "camera": {…},                 camera of this frame, instead of the shared one; optional
          "color_camera": {…},           separate camera of the colour image; optional
          "color_from_depth": [[…], …],  4x4, metres: from the depth camera to the colour camera; optional
          "confidence": "confidence/000000.png",   8-bit confidence of the depth map; optional
          "min_confidence": 1,         depth with a lower confidence is missing
          "mask": "mask/000000.png",     8-bit; 0 marks background; optional
          "up": [0, -1, 0],              up direction in camera axes, from an accelerometer; optional
          "depth_range": [0.5, 4.0],     metres, search range for depth estimation; optional
          "shutter_turn": [0.01, 0, 0]   rotation vector, radians, of the camera from the first
                                         to the last image row (rolling shutter); optional
        }
      ]
    }

A camera with `"distortion_model": "equidistant"` is a fisheye (OpenCV's model, four coefficients).
Paths are relative to the file. Axes are OpenCV's (x right, y down, z forward); the centre of the top
left pixel is (0, 0); depth is along the optical axis. The depth stage writes its result in this format,
too.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.files.codes import FILE_TEXT_INVALID
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.codes import SCAN_TABLE_DAMAGED
from scanloom.stages.scans.image_folders.image_files import resolve_inside
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.poses import check_rigid_pose, parse_pose_matrix, parse_shutter_turn
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan
from scanloom.stages.scans.model.world import Direction, WorldUp
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

FORMAT_VERSION = 1
SCAN_FILE = "scan.json"
_IMAGE_KEYS = ("color", "depth", "confidence", "mask")
_MAX_DEPTH_M = 1e9
# Maximum absolute value of a direction component, so that its square stays finite.
_MAX_COMPONENT = 1e9


def write_scan_json(
    folder: Path, frames: Sequence[Frame], *, up: WorldUp | None = None, is_metric: bool = True
) -> Path:
    """Write `scan.json` for frames whose images are files inside the folder.

    Parameters
    ----------
    folder : an existing folder.
    frames : frames with images as paths inside `folder` (or None), and a common depth scale and missing
        values.
    up : up direction of the scan, or None.
    is_metric : False if lengths have an unknown unit.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    ValueError
        If there are no frames, an image is not a file inside the folder, or the depth scales differ.
    """
    if not frames:
        raise ValueError("no frames to write")
    first = frames[0]
    if any((f.depth_scale, f.depth_missing) != (first.depth_scale, first.depth_missing) for f in frames):
        raise ValueError("all frames of a scan.json must have the same depth scale and missing values")
    document = {
        "version": FORMAT_VERSION,
        "camera": _to_camera_table(first.camera),
        "depth_scale": first.depth_scale,
        "depth_missing": list(first.depth_missing),
        **({} if up is None else up.to_dict()),
        **({} if is_metric else {"metric": False}),
        "frames": [_to_frame_table(frame, folder, first.camera) for frame in frames],
    }
    path = folder / SCAN_FILE
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8", newline="\n")
    return path


def _to_frame_table(frame: Frame, folder: Path, camera: Camera) -> dict[str, Any]:
    pose = frame.world_from_camera
    table: dict[str, Any] = {"name": frame.name}
    for key in _IMAGE_KEYS:
        image = getattr(frame, key)
        if image is None:
            continue
        if not isinstance(image, Path):
            raise ValueError(f"frame {frame.name}: {key} is not a file")
        table[key] = image.relative_to(folder).as_posix()
    table["world_from_camera"] = None if pose is None else pose.tolist()
    if frame.timestamp is not None:
        table["timestamp"] = frame.timestamp
    if frame.camera != camera:
        table["camera"] = _to_camera_table(frame.camera)
    if frame.color_camera is not None:
        table["color_camera"] = _to_camera_table(frame.color_camera)
    if frame.color_from_depth is not None:
        table["color_from_depth"] = frame.color_from_depth.tolist()
    if frame.confidence is not None:
        table["min_confidence"] = frame.min_confidence
    if frame.depth_range is not None:
        table["depth_range"] = list(frame.depth_range)
    if frame.up is not None:
        table["up"] = frame.up.tolist()
    if frame.shutter_turn is not None:
        table["shutter_turn"] = frame.shutter_turn.tolist()
    return table


def _to_camera_table(camera: Camera) -> dict[str, Any]:
    return {
        "width": camera.width,
        "height": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "distortion": list(camera.distortion),
        **({"distortion_model": "equidistant"} if camera.fisheye else {}),
    }


def _matches(folder: Path) -> str | None:
    return SCAN_FILE if (folder / SCAN_FILE).is_file() else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    path = folder / SCAN_FILE
    document = documents.read_json(path)
    if not isinstance(document, dict) or not isinstance(document.get("frames"), list):
        raise InputError(SCAN_TABLE_DAMAGED, "the file has no list of frames.", path)
    if document.get("version") != FORMAT_VERSION:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "unsupported version {document!r}; version {format_version} is expected.",
            path,
            document=document.get("version"),
            format_version=FORMAT_VERSION,
        )
    given = options.resolve_file("poses", folder)
    entries = document["frames"]
    names = [_parse_name(entry, i, path) for i, entry in enumerate(entries)]
    poses = (
        None
        if given is None
        else trajectories.match_poses_to_frames(trajectories.read_trajectory(given), names, given)
    )
    scale = options.depth_scale or _parse_positive(document.get("depth_scale", 1000.0), path)
    missing = _parse_integers(document.get("depth_missing", []), path)
    is_metric = document.get("metric", True)
    if not isinstance(is_metric, bool):
        raise InputError(
            FILE_TEXT_INVALID,
            "metric is {is_metric!r}; it must be true or false.",
            path,
            is_metric=str(is_metric)[:40],
        )
    shared = _parse_camera(document["camera"], options, path) if document.get("camera") is not None else None
    frames: list[Frame] = []
    for i, (name, entry) in enumerate(zip(names, entries, strict=True)):
        camera = _parse_camera(entry["camera"], options, path) if entry.get("camera") is not None else shared
        if camera is None:
            raise InputError(
                SCAN_TABLE_DAMAGED,
                "frame {name} has no camera, and the file states no shared one.",
                path,
                name=name,
            )
        pose = _parse_pose(entry, "world_from_camera", name, path) if poses is None else poses[i]
        own = entry.get("color_camera")
        images = {key: _resolve_image(entry, key, name, path) for key in _IMAGE_KEYS}
        frames.append(
            Frame(
                name=name,
                camera=camera,
                color=images["color"],
                depth=images["depth"],
                depth_scale=scale,
                depth_missing=missing,
                world_from_camera=pose,
                timestamp=_parse_timestamp(entry, name, path),
                color_camera=None if own is None else _parse_camera(own, None, path),
                color_from_depth=_parse_pose(entry, "color_from_depth", name, path),
                confidence=images["confidence"],
                min_confidence=_parse_min_confidence(entry, options, name, path),
                mask=images["mask"],
                depth_range=_parse_depth_range(entry, name, path),
                up=None
                if (up := _parse_direction(entry, f"frame {name}: up", path)) is None
                else np.array(up),
                shutter_turn=_parse_shutter_turn(entry, name, path),
            )
        )
    posed = any(frame.world_from_camera is not None for frame in frames)
    lacking = () if posed or not frames else (describe_missing_poses("no frame has a pose"),)
    return Scan(
        LAYOUT.name, frames, None, folder, missing=lacking, up=_parse_up(document, path), is_metric=is_metric
    )


def _parse_up(document: dict[str, Any], path: Path) -> WorldUp | None:
    direction, source = _parse_direction(document, "up", path), document.get("up_source", SCAN_FILE)
    if direction is None:
        return None
    if not isinstance(source, str):
        raise InputError(FILE_TEXT_INVALID, "up_source must be a string.", path)
    return WorldUp(direction, source)


def _parse_direction(table: dict[str, Any], where: str, path: Path) -> Direction | None:
    value = table.get("up")
    if value is None:
        return None
    numbers = value if isinstance(value, list) and all(type(one) in (int, float) for one in value) else []
    length = (
        math.hypot(*numbers) if len(numbers) == 3 and max(map(abs, numbers)) < _MAX_COMPONENT else math.nan
    )
    if not length > 1 / _MAX_COMPONENT:
        raise InputError(FILE_TEXT_INVALID, "{place} must be three numbers, not all 0.", path, place=where)
    x, y, z = (one / length for one in numbers)
    return x, y, z


def _parse_name(entry: object, position: int, path: Path) -> str:
    name = entry.get("name", f"{position:06d}") if isinstance(entry, dict) else None
    if not isinstance(name, str):
        raise InputError(
            SCAN_TABLE_DAMAGED, "frame {position} is not an object with a name.", path, position=position
        )
    return name


def _resolve_image(entry: dict[str, Any], key: str, name: str, path: Path) -> Path | None:
    value = entry.get(key)
    if value is None:
        return None
    return resolve_inside(path.parent, value, f"frame {name}: {key}", path)


def _parse_pose(entry: dict[str, Any], key: str, name: str, path: Path) -> Pose | None:
    value = entry.get(key)
    if value is None:
        return None
    where = f"frame {name}" if key == "world_from_camera" else f"frame {name}: {key}"
    return check_rigid_pose(parse_pose_matrix(value, path, where), path, where)


def _parse_min_confidence(entry: dict[str, Any], options: ReadingParams, name: str, path: Path) -> int:
    value = entry.get("min_confidence", 0) if options.min_confidence is None else options.min_confidence
    if not isinstance(value, int) or not 0 <= value <= 255:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "frame {name}: min_confidence must be a whole number from 0 to 255.",
            path,
            name=name,
        )
    return value


def _parse_depth_range(entry: dict[str, Any], name: str, path: Path) -> tuple[float, float] | None:
    value = entry.get("depth_range")
    if value is None:
        return None
    numbers = value if isinstance(value, list) and all(isinstance(one, (int, float)) for one in value) else []
    if len(numbers) != 2 or not 0 < numbers[0] < numbers[1] < _MAX_DEPTH_M:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "frame {name}: depth_range must be two numbers in metres, minimum < maximum.",
            path,
            name=name,
        )
    return float(numbers[0]), float(numbers[1])


def _parse_shutter_turn(entry: dict[str, Any], name: str, path: Path) -> NDArray[np.float64] | None:
    value = entry.get("shutter_turn")
    return None if value is None else parse_shutter_turn(value, path, f"frame {name}")


def _parse_timestamp(entry: dict[str, Any], name: str, path: Path) -> int | None:
    value = entry.get("timestamp")
    if value is not None and (not isinstance(value, int) or abs(value) >= 1 << 62):
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "frame {name}: timestamp must be a whole number of nanoseconds.",
            path,
            name=name,
        )
    return value


def _parse_camera(table: object, options: ReadingParams | None, path: Path) -> Camera:
    """Read a camera table, unless `options` give the camera."""
    if not isinstance(table, dict):
        raise InputError(SCAN_TABLE_DAMAGED, "a camera must be a JSON object.", path)
    width, height = table.get("width"), table.get("height")
    if not isinstance(width, int) or not isinstance(height, int) or not 0 < width * height <= 1 << 27:
        raise InputError(
            SCAN_TABLE_DAMAGED, "width and height of a camera in pixels are missing or invalid.", path
        )
    stated = None if options is None else options.get_camera(width, height)
    return stated or calibration.parse_camera_table(table, width, height, path)


def _parse_positive(value: object, path: Path) -> float:
    if not isinstance(value, (int, float)) or not 0 < value < 1e12:
        raise InputError(
            SCAN_TABLE_DAMAGED, "depth_scale is {value!r}; it must be a positive number.", path, value=value
        )
    return float(value)


def _parse_integers(values: object, path: Path) -> tuple[int, ...]:
    if not isinstance(values, list) or not all(isinstance(value, int) for value in values):
        raise InputError(SCAN_TABLE_DAMAGED, "depth_missing must be a list of whole numbers.", path)
    return tuple(values)


LAYOUT = Layout(
    name="plain-rgbd",
    description="scan.json, color/, depth/ (scanloom's own)",
    matches=_matches,
    read=_read,
)
