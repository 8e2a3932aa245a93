"""SUN RGB-D and SUN3D: image/, depth/ with rotated bits, and intrinsics.txt.

    image/0000103.jpg   depth/0000103.png   intrinsics.txt   extrinsics/20150118235401.txt

SUN RGB-D folders hold one frame. SUN3D folders hold sequences with the same files; their extrinsics/
has a 3x4 camera-to-world pose per frame. In SUN RGB-D, it holds only the tilt of the camera.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import read_raw_depth
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.camera_resolution import find_or_guess_camera, get_stated_camera
from scanloom.stages.scans.codes import (
    FRAME_IMAGE_MISSING,
    SCAN_ASSUMED,
    SCAN_FILES_MISSING,
    SCAN_IMAGES_UNPAIRED,
)
from scanloom.stages.scans.image_folders.image_files import find_common_size, list_images, match_by_number
from scanloom.stages.scans.image_folders.rotated_bits import read_rotated
from scanloom.stages.scans.image_folders.timestamp_matching import match_timestamps
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, PackedImage, Pose, Scan, SkippedFrame
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

_UNITS_PER_METRE = 1000.0
# SUN3D names: frame number, then timestamp in microseconds.
_STAMPED_NAME = re.compile(r"\d+-\d{1,15}")
_TOLERANCE_NS = 50_000_000
# Other contents of the data set's folders, which exports of other programs lack.
_DATA_SET_FILES = ("extrinsics", "depth_bfx", "fullres", "scene.txt", "annotation", "annotation2Dfinal")
# In rotated values, the lowest three bits are 0 below 8 m and 1 up to 16 m; in plain values they are
# arbitrary.
_PLAIN_BITS = 0b110
_MAX_PLAIN_RATIO = 0.1


def _matches(folder: Path) -> str | None:
    if not all((folder / name).is_dir() for name in ("image", "depth")):
        return None
    data_set_file = next((name for name in _DATA_SET_FILES if (folder / name).exists()), None)
    if data_set_file is None or not (folder / "intrinsics.txt").is_file():
        return None
    return f"image/, depth/, intrinsics.txt and {data_set_file}"


def _read(folder: Path, options: ReadingParams) -> Scan:
    if not all((folder / name).is_dir() for name in ("image", "depth")):
        raise InputError(SCAN_FILES_MISSING, "the folders image/ and depth/ are required.", folder)
    depths, colors = list_images(folder / "depth"), list_images(folder / "image")
    if len(colors) > 1 and all(_STAMPED_NAME.fullmatch(path.stem) for path in (*depths, *colors)):
        pairs, skipped = _match_by_time(depths, colors)
    else:
        pairs, skipped = match_by_number(depths, colors, "depth/", "image/", folder)
    if not pairs:
        raise InputError(
            SCAN_IMAGES_UNPAIRED, "no image in image/ has a depth map in depth/ within 0.05 s.", folder
        )
    size = find_common_size([depth for depth, _ in pairs])
    camera = _find_camera(folder, options, *size)
    poses, missing = _read_poses(folder, options, [color for _, color in pairs], colors)
    rotated = _is_rotated([depth for depth, _ in pairs])
    if not rotated:
        emit(
            SCAN_ASSUMED.warning(
                "the depth values are not stored with rotated bits, unlike in SUN RGB-D: they are read as "
                "plain values"
            )
        )
    frames = [
        Frame(
            name=depth.stem,
            camera=camera,
            color=color,
            depth=PackedImage(depth, "depth", partial(read_rotated, depth)) if rotated else depth,
            depth_scale=options.depth_scale or _UNITS_PER_METRE,
            world_from_camera=pose,
        )
        for (depth, color), pose in zip(pairs, poses, strict=True)
    ]
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=missing)


def _find_camera(folder: Path, options: ReadingParams, width: int, height: int) -> Camera:
    stated, path = get_stated_camera(options, folder, width, height), folder / "intrinsics.txt"
    if stated is None and not path.exists():
        return find_or_guess_camera(folder, width, height)[0]
    return stated or calibration.read_camera(path, width, height)


def _match_by_time(
    depths: Sequence[Path], colors: Sequence[Path]
) -> tuple[list[tuple[Path, Path]], list[SkippedFrame]]:
    """Match colour and depth by time, because both streams are numbered independently."""
    times = [
        np.array([int(path.stem.rpartition("-")[2]) * 1000 for path in files], np.int64)
        for files in (colors, depths)
    ]
    partners = match_timestamps(times[0], times[1], _TOLERANCE_NS).tolist()
    pairs = [(depths[at], color) for color, at in zip(colors, partners, strict=True) if at >= 0]
    alone = [
        SkippedFrame(color.stem, FRAME_IMAGE_MISSING.warning("no depth map within 0.05 s"))
        for color, at in zip(colors, partners, strict=True)
        if at < 0
    ]
    return pairs, alone


def _read_poses(
    folder: Path, options: ReadingParams, colors: Sequence[Path], all_colors: Sequence[Path]
) -> tuple[list[Pose | None], tuple[Diagnostic, ...]]:
    """Return a pose per image, and the diagnostics of missing poses.

    Parameters
    ----------
    colors : images that are frames.
    all_colors : all images; pose files have a pose for each of them.
    """
    path = options.resolve_file("poses", folder)
    # The latest of several optimisation results, as in the tools of the data set.
    found = sorted((folder / "extrinsics").glob("*.txt"))
    if path is not None:
        trajectory = trajectories.read_trajectory(path)
    elif found and len(all_colors) > 1:
        path = found[-1]
        trajectory = trajectories.read_sun3d(path)
    else:
        return [None] * len(colors), (describe_missing_poses("extrinsics/ has no pose file for a sequence"),)
    names = [color.stem for color in all_colors]
    by_image = dict(zip(names, trajectories.match_poses_to_frames(trajectory, names, path), strict=True))
    return [by_image[color.stem] for color in colors], ()


def _is_rotated(depths: Sequence[Path]) -> bool:
    for path in depths[:: max(1, len(depths) // 4)]:
        try:
            raw = read_raw_depth(path)
        except InputError:
            continue
        if raw.dtype != np.uint16:
            return False
        known = raw[raw > 0]
        if known.size:
            return bool(np.count_nonzero(known & _PLAIN_BITS) <= _MAX_PLAIN_RATIO * known.size)
    return True


LAYOUT = Layout(
    name="sun-rgbd",
    description="image/, depth/, intrinsics.txt, extrinsics/ (SUN RGB-D, SUN3D)",
    matches=_matches,
    read=_read,
)
