"""NYU Depth V2, raw: Kinect colour (.ppm) and disparity (.pgm), without poses.

    r-1294886363.011060-3118787619.ppm   colour: timestamp in seconds, then the clock of the device
    d-1294886362.793814-3139264120.pgm   disparity, with its own timestamp; byte-swapped

Depth is 351.3 / (1092.5 - v) metres for disparity v. All constants are from the toolbox of the data
set.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_DEPTH_FORMAT
from scanloom.stages.files.images import read_raw_depth
from scanloom.stages.scans.calibration.camera_resolution import get_stated_camera
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING, SCAN_FILES_MISSING
from scanloom.stages.scans.image_folders.image_files import find_common_size
from scanloom.stages.scans.image_folders.timestamp_matching import match_timestamps
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import (
    Camera,
    Frame,
    PackedImage,
    Pose,
    Scan,
    SkippedFrame,
    scale_camera,
)
from scanloom.stages.scans.trajectory.timed_poses import match_poses_by_time

_FILE_NAME = re.compile(r"([rd])-(\d{1,10}\.\d+)-\d+\.p[pg]m")
# Nanoseconds; both streams run at up to 30 Hz and are not synchronised.
_TOLERANCE_NS = 50_000_000
_DEPTH_CAMERA = Camera(
    640,
    480,
    582.624481677379,
    582.691032709886,
    313.044758708047,
    238.443896266203,
    (-0.099897236553, 0.390653246027, 0.001929059287, -0.001942202247, -0.510317250534),
)
_COLOR_CAMERA = Camera(
    640,
    480,
    518.857901174501,
    519.469611121274,
    325.582449411190,
    253.736166334004,
    (0.207966153188, -0.586138251639, 0.000722313631, 0.001047962719, 0.498569866847),
)
# The toolbox states -R and +t, which projects like R and -t: the colour camera is 25 mm right of the depth
# camera.
_COLOR_FROM_DEPTH = np.array(
    [
        [0.999977989408, -0.005035991948, -0.004319662492, -0.025031875059],
        [0.005051841938, 0.999980518611, 0.003666236574, 0.000293423129],
        [0.004301115201, -0.003687978130, 0.999983949483, -0.000662387470],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
# Lower disparities are invalid, since the sensor starts at 0.7 m. Beyond ten metres, one disparity step is
# half a metre.
_MIN_DISPARITY = 600
_MAX_DEPTH_M = 10.0


def _matches(folder: Path) -> str | None:
    names: dict[str, str] = {}
    for path in folder.glob("*.p[pg]m"):
        if match := _FILE_NAME.fullmatch(path.name):
            names.setdefault(match[1], path.name)
    return f"files named like {names['d']} and {names['r']}" if len(names) == 2 else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    depths, colors = _list_stream(folder, "d", ".pgm"), _list_stream(folder, "r", ".ppm")
    if not depths or not colors:
        raise InputError(
            SCAN_FILES_MISSING,
            "files named like d-1294886362.79-313.pgm and r-1294886363.01-311.ppm are required.",
            folder,
        )
    size = find_common_size([path for _, path in depths])
    camera = get_stated_camera(options, folder, *size) or scale_camera(_DEPTH_CAMERA, *size)
    given = options.resolve_file("poses", folder)
    depth_times, color_times = (
        np.array([time for time, _ in stream], np.int64) for stream in (depths, colors)
    )
    partners = match_timestamps(depth_times, color_times, _TOLERANCE_NS)
    skipped = [
        SkippedFrame(depth.stem, FRAME_IMAGE_MISSING.warning("no colour image within 0.05 s"))
        for (_, depth), partner in zip(depths, partners.tolist(), strict=True)
        if partner < 0
    ]
    paired = [(*one, at) for one, at in zip(depths, partners.tolist(), strict=True) if at >= 0]
    poses: list[Pose | None] = [None] * len(paired)
    if given is not None:
        moments, names = [time for time, *_ in paired], [depth.stem for _, depth, _ in paired]
        poses = match_poses_by_time(given, moments, names, _TOLERANCE_NS, options)
    frames: list[Frame] = []
    for (time, depth, partner), pose in zip(paired, poses, strict=True):
        frames.append(
            Frame(
                name=depth.stem,
                camera=camera,
                color=colors[partner][1],
                depth=PackedImage(depth, "depth", partial(_read_depth, depth)),
                depth_scale=options.depth_scale or 1.0,
                world_from_camera=pose,
                timestamp=time,
                color_camera=_COLOR_CAMERA,
                color_from_depth=_COLOR_FROM_DEPTH,
            )
        )
    missing = (describe_missing_poses("the data set contains no poses"),) if given is None else ()
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=missing)


def _list_stream(folder: Path, letter: str, suffix: str) -> list[tuple[int, Path]]:
    """Return the timestamps (ns) and files of a stream, sorted by time."""
    found = [
        (round(float(match[2]) * 1e9), path)
        for path in folder.iterdir()
        if path.suffix == suffix and (match := _FILE_NAME.fullmatch(path.name)) and match[1] == letter
    ]
    return sorted(found)


def _read_depth(path: Path) -> NDArray[np.float32]:
    """Convert a disparity file to depth in metres, 0 where invalid."""
    raw = read_raw_depth(path)
    if raw.dtype != np.uint16:
        raise InputError(FILE_DEPTH_FORMAT, "a 16-bit disparity image is expected.", path)
    disparity = raw.byteswap().astype(np.float32)
    gap = 1092.5 - disparity
    known = (disparity >= _MIN_DISPARITY) & (gap > 351.3 / _MAX_DEPTH_M)
    return np.where(known, 351.3 / np.where(known, gap, 1), 0).astype(np.float32)


LAYOUT = Layout(
    name="nyu",
    description="r-SECONDS-CLOCK.ppm and d-SECONDS-CLOCK.pgm (NYU Depth V2, raw)",
    matches=_matches,
    read=_read,
)
