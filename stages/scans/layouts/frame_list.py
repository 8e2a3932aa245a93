"""A JSON list of frames, each with its camera, its pose and the unit of its depth (align3d, its relatives).

    frames.json                        {"root": [{"info": {…}, …}, …]}, the images' names in it or beside it
    frame_00000_rgb.png  frame_00000_depth.png  …

Of a frame's info: `kcam.matrix` 3x3, `kcam.undist_coeff`, `kcam.image_size`; `depth_scale`, metres of a unit;
`rt_cam.matrix` 4x4, camera-to-world.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stages.errors import InputError
from stages.files import documents
from stages.files.noting import only_looking
from stages.scans.formats import calibration, trajectories
from stages.scans.reading.files import DEPTHS, IMAGES, common_size, inside, numbers
from stages.scans.reading.layout import Layout
from stages.scans.reading.params import ReadingParams
from stages.scans.reading.stated import stated_camera
from stages.scans.scan import Camera, Frame, Pose, Scan

_NAMES = ("frames.json", "info.json", "data.json", "scan_info.json", "dataset.json")
_COLOR = ("rgb", "color", "colour")


def _matches(folder: Path) -> str | None:
    with only_looking():
        found = _list_of_frames(folder)
    return None if found is None else f"{found[0].name}, a list of frames with kcam and rt_cam"


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
    if found is None:
        raise InputError("a JSON list of frames with kcam and rt_cam is needed.", folder)
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
    frames = [
        Frame(
            name=name,
            camera=stated or _camera(_info(entry), size, path),
            color=color,
            depth=depth,
            depth_scale=options.depth_scale or _depth_scale(_info(entry), path),
            world_from_camera=pose,
        )
        for name, entry, (color, depth), pose in zip(names, entries, images, poses, strict=True)
    ]
    return Scan(LAYOUT.name, frames, None, folder)


def _images(folder: Path, entry: dict[str, Any], number: int, path: Path) -> tuple[Path | None, Path]:
    """Return the colour image and the depth map of a frame: those it names, or those of its number."""
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
        raise InputError(f"frame {number} names no depth map, and there is none of its number.", path)
    return color, depth


def _camera(info: dict[str, Any], size: tuple[int, int], path: Path) -> Camera:
    table = info["kcam"] if isinstance(info["kcam"], dict) else {}
    return calibration.camera_from_table(
        {"matrix": table.get("matrix"), "distortion": table.get("undist_coeff")}, *size, path
    )


def _depth_scale(info: dict[str, Any], path: Path) -> float:
    """Return units a metre; the file says metres a unit."""
    step = info.get("depth_scale", 0.001)
    if isinstance(step, bool) or not isinstance(step, (int, float)) or not 1e-9 < step < 1e9:
        raise InputError(f"depth_scale is {str(step)[:40]}; it must be a positive number.", path)
    return 1 / step


def _pose(entry: dict[str, Any], number: int, path: Path) -> Pose | None:
    held = _info(entry)["rt_cam"]
    matrix = held.get("matrix") if isinstance(held, dict) else held
    where = f"frame {number}: rt_cam"
    return trajectories.rigid(trajectories.matrix_of(matrix, path, where), path, where)


LAYOUT = Layout(
    name="frame-list",
    text="frames.json, a list of frames with kcam and rt_cam, and their images (align3d)",
    matches=_matches,
    read=_read,
)
