"""7-Scenes and BundleFusion: three files per frame in one folder.

Each frame has a colour image, a depth map, and a pose.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.files.image_bytes import MAX_PIXELS
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_INVALID,
    CAMERA_INTRINSICS_GUESSED,
    FRAME_IMAGE_MISSING,
    FRAME_POSE_MISSING,
    SCAN_ASSUMED,
    SCAN_FILES_MISSING,
    SCAN_TABLE_DAMAGED,
)
from scanloom.stages.scans.image_folders.image_files import find_common_size, find_first_existing
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, SkippedFrame
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories
from scanloom.stages.scans.trajectory.pose_files import read_pose_files

_DEPTH_NAME = re.compile(r"frame-(\d+)\.depth\.png")
# Kinect intrinsics from the page of the data set; BundleFusion and others provide a file.
_DEFAULT_INTRINSICS = (585.0, 585.0, 320.0, 240.0)
# BundleFusion's file, and the one that ScanNet's tool extracts from a .sens file.
_INFO_FILES = ("info.txt", "_info.txt")
# Depth intrinsics are preferred. Files with only colour intrinsics imply depth registered to colour.
_INTRINSICS_FILES = (
    "camera-intrinsics.txt",
    "camera-intrinsics.depth.txt",
    "camera-intrinsics.color.txt",
    "intrinsics.K.txt",
    "intrinsics.txt",
    "camera_intrinsics.txt",
)


def _matches(folder: Path) -> str | None:
    found = next((p.name for p in folder.glob("frame-*.depth.png") if _DEPTH_NAME.fullmatch(p.name)), None)
    return f"files named like {found}" if found else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    depths = sorted(
        (int(match[1]), path) for path in folder.iterdir() if (match := _DEPTH_NAME.fullmatch(path.name))
    )
    if not depths:
        raise InputError(
            SCAN_FILES_MISSING, "the folder has no depth images named like frame-000000.depth.png.", folder
        )
    camera, scale = _find_camera(folder, options, *find_common_size([path for _, path in depths]))
    color_camera = _read_color_camera(folder, options, camera)
    given = options.resolve_file("poses", folder)
    stems = [depth.name.removesuffix(".depth.png") for _, depth in depths]
    poses: dict[str, Pose | None] = {}
    skipped = _skip_without_depth(folder, stems)
    missing: tuple[Diagnostic, ...] = ()
    if given is not None:
        matched = trajectories.match_poses_to_frames(trajectories.read_trajectory(given), stems, given)
        poses = dict(zip(stems, matched, strict=True))
    elif any(folder.glob("frame-*.pose.txt")):
        files = {stem: file for stem in stems if (file := folder / f"{stem}.pose.txt").exists()}
        poses, damaged = read_pose_files(files)
        skipped += damaged
        absent = [stem for stem in stems if stem not in files]
        skipped += [
            SkippedFrame(stem, FRAME_POSE_MISSING.warning("{stem}.pose.txt is missing", stem=stem))
            for stem in absent
        ]
    else:
        poses = dict.fromkeys(stems)
        missing = (describe_missing_poses("files like frame-000000.pose.txt are missing"),)

    colors = [find_first_existing(folder, f"{stem}.color.png", f"{stem}.color.jpg") for stem in stems]
    frames: list[Frame] = []
    for (_, depth), stem, color in zip(depths, stems, colors, strict=True):
        if stem not in poses:
            continue
        if color is None and any(colors):
            skipped.append(SkippedFrame(stem, FRAME_IMAGE_MISSING.warning("its colour image is missing")))
            continue
        frames.append(
            Frame(
                name=stem,
                camera=camera,
                color=color,
                depth=depth,
                depth_scale=options.depth_scale or scale,
                depth_missing=(65535,),
                world_from_camera=poses[stem],
                color_camera=None if color is None else color_camera,
            )
        )
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=missing)


def _skip_without_depth(folder: Path, stems: Sequence[str]) -> list[SkippedFrame]:
    """Return the frames that have a colour image but no depth map."""
    known = set(stems)
    others = sorted({path.name.partition(".")[0] for path in folder.glob("frame-*.color.*")} - known)
    return [SkippedFrame(stem, FRAME_IMAGE_MISSING.warning("its depth map is missing")) for stem in others]


def _find_camera(folder: Path, options: ReadingParams, width: int, height: int) -> tuple[Camera, float]:
    """Return the depth camera, and the depth scale in units per metre."""
    unregistered = SCAN_ASSUMED.warning(
        "depth and colour of 7-Scenes are from two cameras and not registered: colour is off by a "
        "few pixels unless the stage adjust corrects it"
    )
    stated = options.get_camera(width, height)
    if stated is not None:
        return stated, 1000.0
    info = find_first_existing(folder, *_INFO_FILES)
    if options.calibration is None and info is not None:
        return _read_bundle_fusion(info, width, height)
    # 3DMatch shares one file between all sequences of a scene.
    path = options.resolve_file("calibration", folder) or find_first_existing(
        folder, *_INTRINSICS_FILES, *(f"../{name}" for name in _INTRINSICS_FILES)
    )
    if path is not None:
        camera = calibration.read_camera(path, width, height)
        if (camera.fx, camera.fy, camera.cx, camera.cy) == _DEFAULT_INTRINSICS:
            emit(unregistered)
        return camera, 1000.0
    emit(
        CAMERA_INTRINSICS_GUESSED.warning(
            "camera-intrinsics.txt is missing: the 7-Scenes default 585,585,320,240 is used",
            remedy="for another camera, set scan.intrinsics=fx,fy,cx,cy",
        ),
        unregistered,
    )
    return Camera(width, height, *_DEFAULT_INTRINSICS), 1000.0


def _read_bundle_fusion(info: Path, width: int, height: int) -> tuple[Camera, float]:
    """Read depth camera and depth scale from BundleFusion's info.txt.

    Lines: `m_calibrationDepthIntrinsic = 16 numbers`, `m_depthShift = 1000`.
    """
    values = _read_settings(info)
    try:
        scale = float(values.get("m_depthShift", 1000))
        camera = _parse_camera(values["m_calibrationDepthIntrinsic"], width, height, info)
    except (KeyError, ValueError, IndexError) as error:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "m_calibrationDepthIntrinsic or m_depthShift is missing or invalid.",
            info,
        ) from error
    if not 0 < scale < 1e12:
        raise InputError(
            SCAN_TABLE_DAMAGED, "m_depthShift is {scale:g}; it must be positive.", info, scale=scale
        )
    return camera, scale


def _read_color_camera(folder: Path, options: ReadingParams, camera: Camera) -> Camera | None:
    """Return the colour camera in info.txt, if it is a separate one."""
    info = find_first_existing(folder, *_INFO_FILES)
    if info is None or options.calibration is not None or options.intrinsics is not None:
        return None
    values = _read_settings(info)
    try:
        width, height = int(values["m_colorWidth"]), int(values["m_colorHeight"])
        matrix = values["m_calibrationColorIntrinsic"]
        if not 0 < width * height <= MAX_PIXELS or float(matrix.split()[0]) == 0:
            return None
        color_camera = _parse_camera(matrix, width, height, info)
    except KeyError:
        return None
    except (ValueError, IndexError) as error:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "m_colorWidth, m_colorHeight or m_calibrationColorIntrinsic is invalid.",
            info,
        ) from error
    return None if color_camera == camera else color_camera


def _read_settings(info: Path) -> dict[str, str]:
    return documents.parse_assignments(documents.read_text(info))


def _parse_camera(text: str, width: int, height: int, info: Path) -> Camera:
    """Return the camera of a 4x4 matrix given as 16 row-major numbers."""
    row = [float(word) for word in text.split()]
    return calibration.check_camera_values(Camera(width, height, row[0], row[5], row[2], row[6]), info)


LAYOUT = Layout(
    name="7scenes",
    description="frame-000000.color.png|jpg, .depth.png, .pose.txt (7-Scenes, BundleFusion)",
    matches=_matches,
    read=_read,
)
