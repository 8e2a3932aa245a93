"""Our own plain RGB-D layout: `scan.json` beside images, everything a reader must know stated in it.

    {
      "version": 1,
      "camera": {"width": 640, "height": 480, "fx": 585, "fy": 585, "cx": 320, "cy": 240, "distortion": []},
      "depth_scale": 1000,            units of a depth file a metre
      "depth_missing": [65535],       raw values that mark a missing depth, beside 0
      "frames": [
        {
          "name": "000000",
          "color": "color/000000.png",   8 bits a channel; optional
          "depth": "depth/000000.png",   16-bit, or .npy float; optional
          "world_from_camera": [[r, r, r, x], [r, r, r, y], [r, r, r, z], [0, 0, 0, 1]],   metres; null: lost
          "timestamp": 33000000,         nanoseconds; optional
          "camera": {…}                  optional: this frame's own camera
        }
      ]
    }

A camera of `"distortion_model": "equidistant"` is a fisheye (OpenCV's model, four coefficients).
Paths are relative to the file. Axes are OpenCV's (x right, y down, z forward); the pixel centre of the top
left pixel is (0, 0); depth is along the optical axis. The depth stage leaves its result in this form too.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stages.errors import InputError
from stages.formats import calibration, documents, trajectories
from stages.layouts.files import inside
from stages.layouts.layout import Layout
from stages.scan import Camera, Frame, Scan

if TYPE_CHECKING:
    from stages.layouts.params import ScanParams

VERSION = 1
FILE = "scan.json"


def write_scan_json(folder: Path, frames: Sequence[Frame]) -> Path:
    """Write `folder/scan.json` for frames whose images are files inside the folder; return its path.

    Parameters
    ----------
    folder : an existing folder.
    frames : with `color` and `depth` as paths under `folder` (or None), sharing one depth scale and markers.

    Raises
    ------
    ValueError
        If there are no frames, an image is not a file under the folder, or the depth scales differ.
    """
    if not frames:
        raise ValueError("no frames to write")
    first = frames[0]
    if any((f.depth_scale, f.depth_missing) != (first.depth_scale, first.depth_missing) for f in frames):
        raise ValueError("all frames of a scan.json share one depth scale and missing values")
    document = {
        "version": VERSION,
        "camera": _camera_table(first.camera),
        "depth_scale": first.depth_scale,
        "depth_missing": list(first.depth_missing),
        "frames": [_frame_table(frame, folder, first.camera) for frame in frames],
    }
    path = folder / FILE
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return path


def _frame_table(frame: Frame, folder: Path, camera: Camera) -> dict[str, Any]:
    pose = frame.world_from_camera
    table: dict[str, Any] = {"name": frame.name}
    for key, image in (("color", frame.color), ("depth", frame.depth)):
        if image is None:
            continue
        if not isinstance(image, Path):
            raise ValueError(f"frame {frame.name}: {key} is not a file")
        table[key] = image.relative_to(folder).as_posix()
    table["world_from_camera"] = None if pose is None else pose.tolist()
    if frame.timestamp is not None:
        table["timestamp"] = frame.timestamp
    if frame.camera != camera:
        table["camera"] = _camera_table(frame.camera)
    return table


def _camera_table(camera: Camera) -> dict[str, Any]:
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
    return FILE if (folder / FILE).is_file() else None


def _read(folder: Path, options: ScanParams) -> Scan:
    path = folder / FILE
    document = documents.read_json(path)
    if not isinstance(document, dict) or not isinstance(document.get("frames"), list):
        raise InputError("it holds no list of frames.", path)
    if document.get("version") != VERSION:
        raise InputError(f"its version is {document.get('version')!r}; this program reads {VERSION}.", path)
    given = options.file("poses", folder)
    entries = document["frames"]
    names = [_name(entry, i, path) for i, entry in enumerate(entries)]
    poses = None if given is None else trajectories.match(trajectories.read_trajectory(given), names, given)
    scale = options.depth_scale or _positive(document.get("depth_scale", 1000.0), path)
    missing = _integers(document.get("depth_missing", []), path)
    shared = _camera(document["camera"], options, path) if document.get("camera") is not None else None
    frames: list[Frame] = []
    for i, (name, entry) in enumerate(zip(names, entries, strict=True)):
        camera = _camera(entry["camera"], options, path) if entry.get("camera") is not None else shared
        if camera is None:
            raise InputError(f"frame {name} has no camera, and neither has the scan.", path)
        pose = _pose(entry, name, path) if poses is None else poses[i]
        frames.append(
            Frame(
                name=name,
                camera=camera,
                color=_image(entry, "color", name, path),
                depth=_image(entry, "depth", name, path),
                depth_scale=scale,
                depth_missing=missing,
                world_from_camera=pose,
                timestamp=_timestamp(entry, name, path),
            )
        )
    posed = any(frame.world_from_camera is not None for frame in frames)
    lacking = (
        () if posed or not frames else ("poses: no frame has one; name a trajectory with scan.poses=FILE",)
    )
    return Scan(LAYOUT.name, frames, None, folder, missing=lacking)


def _name(entry: object, position: int, path: Path) -> str:
    name = entry.get("name", f"{position:06d}") if isinstance(entry, dict) else None
    if not isinstance(name, str):
        raise InputError(f"frame {position} is not a table with a name.", path)
    return name


def _image(entry: dict[str, Any], key: str, name: str, path: Path) -> Path | None:
    value = entry.get(key)
    if value is None:
        return None
    return inside(path.parent, value, f"frame {name}: {key}", path)


def _pose(entry: dict[str, Any], name: str, path: Path) -> Any:
    value = entry.get("world_from_camera")
    if value is None:
        return None
    where = f"frame {name}"
    return trajectories.rigid(trajectories.matrix_of(value, path, where), path, where)


def _timestamp(entry: dict[str, Any], name: str, path: Path) -> int | None:
    value = entry.get("timestamp")
    if value is not None and (not isinstance(value, int) or abs(value) >= 1 << 62):
        raise InputError(f"frame {name}: timestamp is not a whole number of nanoseconds.", path)
    return value


def _camera(table: object, options: ScanParams, path: Path) -> Camera:
    if not isinstance(table, dict):
        raise InputError("a camera must be a table of names and values.", path)
    width, height = table.get("width"), table.get("height")
    if not isinstance(width, int) or not isinstance(height, int) or not 0 < width * height <= 1 << 27:
        raise InputError("a camera needs its width and height in pixels.", path)
    return options.camera(width, height) or calibration.camera_from_table(table, width, height, path)


def _positive(value: object, path: Path) -> float:
    if not isinstance(value, (int, float)) or not 0 < value < 1e12:
        raise InputError(f"depth_scale is {value!r}; it must be a positive number.", path)
    return float(value)


def _integers(values: object, path: Path) -> tuple[int, ...]:
    if not isinstance(values, list) or not all(isinstance(value, int) for value in values):
        raise InputError("depth_missing must be a list of whole numbers.", path)
    return tuple(values)


LAYOUT = Layout(
    name="plain-rgbd",
    text="scan.json, color/, depth/ (our own; see stages/layouts/scan_json.py)",
    matches=_matches,
    read=_read,
)
