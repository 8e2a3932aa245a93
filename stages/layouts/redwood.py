"""Open3D and Redwood style: colour and depth in a folder each, a trajectory, perhaps an intrinsic.json."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from stages.errors import InputError
from stages.formats import calibration, trajectories
from stages.layouts.files import DEPTHS, common_size, first_existing, images, pair
from stages.layouts.layout import Layout
from stages.scan import Camera, Frame, Pose, Scan

if TYPE_CHECKING:
    from stages.layouts.params import ScanParams

_COLORS = ("color", "rgb", "image")
_INTRINSICS = ("intrinsic.json", "camera_intrinsic.json", "intrinsics.json", "camera_primesense.json")
_TRAJECTORIES = ("trajectory.log", "trajectory.json", "trajectory.txt", "poses.txt")
# The PrimeSense default that Open3D itself falls back to.
_DEFAULT = (525.0, 525.0, 319.5, 239.5)


def _matches(folder: Path) -> str | None:
    color = first_existing(folder, *_COLORS)
    return f"{color.name}/ and depth/" if color and color.is_dir() and (folder / "depth").is_dir() else None


def _read(folder: Path, options: ScanParams) -> Scan:
    color = first_existing(folder, *_COLORS)
    if color is None or not (folder / "depth").is_dir():
        raise InputError("a folder color/ (or rgb/, image/) and a folder depth/ are needed.", folder)
    pairs, skipped = pair(images(folder / "depth", DEPTHS), images(color), "depth/", f"{color.name}/", folder)
    names = [depth.stem for depth, _ in pairs]
    path = options.file("poses", folder) or _trajectory(folder)
    poses: list[Pose | None] = [None] * len(pairs)
    missing: tuple[str, ...] = ()
    if path is not None:
        poses = trajectories.match(trajectories.read_trajectory(path), names, path)
    else:
        missing = ("poses: trajectory.log (or .json) is missing; name a trajectory with scan.poses=FILE",)
    camera, scale, warnings = _camera(folder, options, *common_size([depth for depth, _ in pairs]))
    frames = [
        Frame(
            name=depth.stem,
            camera=camera,
            color=image,
            depth=depth,
            depth_scale=scale,
            world_from_camera=pose,
        )
        for (depth, image), pose in zip(pairs, poses, strict=True)
    ]
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), tuple(warnings), missing)


def _trajectory(folder: Path) -> Path | None:
    """Return the trajectory: by its usual name or as the only file that looks like one.

    It is looked for beside the images, where Open3D's reconstruction leaves it, and in the folder above.
    """
    for place in (folder, folder / "scene", folder.resolve().parent):
        others = [*place.glob("*traj*.log"), *place.glob("*traj*.txt")]
        found = first_existing(place, *_TRAJECTORIES) or (others[0] if len(others) == 1 else None)
        if found is not None:
            return found
    return None


def _camera(folder: Path, options: ScanParams, width: int, height: int) -> tuple[Camera, float, list[str]]:
    """Return the camera, the depth scale and what is to be said about them."""
    # Open3D's own examples keep one camera file beside several scans.
    path = options.file("calibration", folder) or first_existing(
        folder, *_INTRINSICS, *(f"../{name}" for name in _INTRINSICS)
    )
    stated = options.camera(width, height)
    scale = options.depth_scale or (1000.0 if path is None else calibration.read_depth_scale(path))
    if stated is not None:
        return stated, scale, []
    if path is None:
        return (
            Camera(width, height, *_DEFAULT),
            scale,
            [
                "the folder has no intrinsic.json: the default 525,525,319.5,239.5 is used; "
                "if another camera made it, set scan.intrinsics=fx,fy,cx,cy"
            ],
        )
    said = (
        [] if path.parent.samefile(folder) else [f"the intrinsics come from {path.name} in the folder above"]
    )
    return calibration.read_camera(path, width, height), scale, said


LAYOUT = Layout(
    name="redwood",
    text="color/ (or rgb/, image/), depth/, trajectory.log|json, intrinsic.json (Open3D, Redwood)",
    matches=_matches,
    read=_read,
)
