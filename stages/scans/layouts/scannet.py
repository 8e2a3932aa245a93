"""ScanNet, extracted: color/, depth/, pose/ and intrinsic/, with one file per frame.

Colour images are larger than depth maps. Exports for novel view synthesis omit depth/; they are read as
single views.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.camera_resolution import find_or_guess_camera, get_stated_camera
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_ASSUMED,
    CAMERA_CALIBRATION_SCALED,
    FRAME_POSE_MISSING,
    SCAN_ASSUMED,
    SCAN_FILES_MISSING,
)
from scanloom.stages.scans.image_folders.image_files import (
    COLOR_FOLDERS,
    DEPTH_SUFFIXES,
    find_common_size,
    find_first_existing,
    list_images,
    match_by_number,
    warn_if_paired_by_position,
)
from scanloom.stages.scans.layouts.shared.axis_alignment import find_scannet_up
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.posed_views import create_view_frame
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, SkippedFrame, scale_camera
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories
from scanloom.stages.scans.trajectory.pose_files import read_pose_files

_UNITS_PER_METRE = 1000.0
# Size of the original colour images. Intrinsics of downscaled exports still refer to it.
_ORIGINAL_COLOR_SIZE = (1296, 968)
_MAX_CENTRE_OFFSET_RATIO = 0.2
# If one of these files exists, it states camera or poses, and pose/ belongs to another layout.
_OTHER_LAYOUT_FILES = ("intrinsic.json", "camera_intrinsic.json", "trajectory.log", "trajectory.json")


def _matches(folder: Path) -> str | None:
    views = _find_views_folder(folder)
    if views is not None:
        return f"{views.name}/, pose/ and intrinsics"
    color = _find_color_folder(folder)
    if color is None:
        return None
    if (folder / "intrinsic").is_dir():
        return f"{color.name}/, depth/, pose/ and intrinsic/"
    path = _find_intrinsics(folder, "depth")
    if path is not None:
        return f"{color.name}/, depth/, pose/ and {path.name}"
    is_alone = (
        any((folder / "pose").glob("*.txt")) and find_first_existing(folder, *_OTHER_LAYOUT_FILES) is None
    )
    return f"{color.name}/, depth/ and pose/" if is_alone else None


def _find_color_folder(folder: Path) -> Path | None:
    """Return the colour folder if depth/ and pose/ exist, else None."""
    color = find_first_existing(folder, *COLOR_FOLDERS)
    return (
        color if color and all(path.is_dir() for path in (color, folder / "depth", folder / "pose")) else None
    )


def _find_views_folder(folder: Path) -> Path | None:
    """Return the colour folder of posed views without depth, or None."""
    color = find_first_existing(folder, *COLOR_FOLDERS)
    known = _find_intrinsics(folder, "color") or _find_intrinsics(folder, "depth")
    is_posed = color is not None and color.is_dir() and (folder / "pose").is_dir() and known is not None
    return color if is_posed and not (folder / "depth").exists() else None


def _read(folder: Path, options: ReadingParams) -> Scan:
    views = _find_views_folder(folder)
    if views is not None:
        return _read_views(folder, views, options)
    color_folder = _find_color_folder(folder)
    if color_folder is None:
        raise InputError(SCAN_FILES_MISSING, "the folders color/, depth/ and pose/ are required.", folder)
    depths, colors = list_images(folder / "depth", DEPTH_SUFFIXES), list_images(color_folder)
    pairs, skipped = match_by_number(depths, colors, "depth/", f"{color_folder.name}/", folder)
    camera, color_camera = _read_cameras(folder, options, pairs)
    warn_if_paired_by_position(pairs, "depth/", f"{color_folder.name}/")
    names = [depth.stem for depth, _ in pairs]
    poses, damaged, missing = _read_poses(folder, options, names)
    skipped += damaged
    skipped += _skip_without_pose(names, poses, damaged, missing)
    frames = [
        Frame(
            name=depth.stem,
            camera=camera,
            color=color,
            depth=depth,
            depth_scale=options.depth_scale or _UNITS_PER_METRE,
            world_from_camera=poses.get(depth.stem),
            color_camera=color_camera,
        )
        for depth, color in pairs
        if depth.stem in poses or missing
    ]
    up = find_scannet_up(folder, LAYOUT.name)
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=missing, up=up)


def _read_views(folder: Path, image_folder: Path, options: ReadingParams) -> Scan:
    """Read posed images without depth."""
    colors = list_images(image_folder)
    if not colors:
        raise InputError(
            SCAN_FILES_MISSING,
            "no images in {place_name}/; at least one is needed.",
            folder,
            place_name=image_folder.name,
        )
    names = [color.stem for color in colors]
    poses, damaged, missing = _read_poses(folder, options, names)
    camera = _find_views_camera(folder, options, find_common_size(colors))
    frames: list[Frame] = []
    skipped = [*damaged, *_skip_without_pose(names, poses, damaged, missing)]
    for name, color in zip(names, colors, strict=True):
        if name not in poses and not missing:
            continue
        try:
            frames.append(create_view_frame(name, camera, color, poses.get(name)))
        except InputError as error:
            skipped.append(SkippedFrame(name, error.diagnostic))
    up = find_scannet_up(folder, LAYOUT.name)
    return Scan(LAYOUT.name, frames, None, folder, tuple(skipped), missing=missing, up=up)


def _find_views_camera(folder: Path, options: ReadingParams, size: tuple[int, int]) -> Camera:
    """Return the camera of the images: colour intrinsics, or else depth intrinsics."""
    stated = get_stated_camera(options, folder, *size)
    if stated is not None:
        return stated
    path = _find_intrinsics(folder, "color") or _find_intrinsics(folder, "depth")
    if path is None:
        return find_or_guess_camera(folder, *size)[0]
    return _read_color_camera(path, size)


def _skip_without_pose(
    names: Sequence[str],
    poses: Mapping[str, Pose | None],
    damaged: Sequence[SkippedFrame],
    missing: Sequence[Diagnostic],
) -> list[SkippedFrame]:
    """Return the frames without a pose file.

    Empty if all pose files are missing.
    """
    known = {*poses, *(one.name for one in damaged)}
    return [
        SkippedFrame(name, FRAME_POSE_MISSING.warning("pose/{name}.txt is missing", name=name))
        for name in names
        if name not in known and not missing
    ]


def _read_poses(
    folder: Path, options: ReadingParams, names: Sequence[str]
) -> tuple[dict[str, Pose | None], list[SkippedFrame], tuple[Diagnostic, ...]]:
    """Return poses by frame, frames with damaged poses, and missing-pose diagnostics.

    A pose is None if tracking was lost.
    """
    given = options.resolve_file("poses", folder)
    if given is not None:
        matched = trajectories.match_poses_to_frames(trajectories.read_trajectory(given), names, given)
        return dict(zip(names, matched, strict=True)), [], ()
    files = {name: folder / "pose" / f"{name}.txt" for name in names}
    poses, damaged = read_pose_files({name: path for name, path in files.items() if path.exists()})
    lacking = describe_missing_poses("files like pose/{name}.txt are missing", name=names[0])
    return poses, damaged, () if poses else (lacking,)


def _read_cameras(
    folder: Path, options: ReadingParams, pairs: Sequence[tuple[Path, Path]]
) -> tuple[Camera, Camera | None]:
    """Return the depth camera, and the colour camera (None if unknown)."""
    size = find_common_size([depth for depth, _ in pairs])
    camera, path = get_stated_camera(options, folder, *size), _find_intrinsics(folder, "depth")
    if camera is None and path is not None:
        camera = calibration.read_camera(path, *size)
    if camera is None:
        camera, _ = find_or_guess_camera(folder, *size)
    color_path = _find_intrinsics(folder, "color")
    extrinsics_files = [
        name
        for name in ("extrinsic_color.txt", "extrinsic_depth.txt")
        if (folder / "intrinsic" / name).exists() and not _is_identity(folder / "intrinsic" / name)
    ]
    for name in extrinsics_files:
        emit(SCAN_ASSUMED.warning("intrinsic/{name} is not the identity matrix; it is ignored", name=name))
    if color_path is None:
        emit(
            CAMERA_CALIBRATION_ASSUMED.warning(
                "intrinsic_color.txt is missing: colour is assumed to have the same view as depth, at its "
                "own resolution"
            )
        )
        return camera, None
    return camera, _read_color_camera(color_path, find_common_size([color for _, color in pairs]))


def _read_color_camera(path: Path, size: tuple[int, int]) -> Camera:
    """Read the colour camera for images of this size.

    If the principal point does not fit the size, the intrinsics are scaled from the original size.
    """
    original = calibration.create_camera_from_matrix(
        calibration.read_bare_matrix(path), (), *_ORIGINAL_COLOR_SIZE, path
    )
    if abs(original.cx - size[0] / 2) <= _MAX_CENTRE_OFFSET_RATIO * size[0]:
        return replace(original, width=size[0], height=size[1])
    emit(
        CAMERA_CALIBRATION_SCALED.warning(
            "the intrinsics do not fit colour images of {width}×{height} pixels: they are assumed to "
            "be for {own_width}×{own_height} (original size) and scaled",
            path,
            width=size[0],
            height=size[1],
            own_width=_ORIGINAL_COLOR_SIZE[0],
            own_height=_ORIGINAL_COLOR_SIZE[1],
        )
    )
    return scale_camera(original, *size)


def _find_intrinsics(folder: Path, stream: str) -> Path | None:
    names = (f"intrinsic_{stream}.txt", f"intrinsics_{stream}.txt")
    return find_first_existing(folder, *(f"intrinsic/{name}" for name in names), *names)


def _is_identity(path: Path) -> bool:
    try:
        values = [float(word) for word in documents.read_text(path).split()]
    except ValueError:
        return False
    return len(values) == 16 and bool(np.allclose(values, np.eye(4).ravel(), atol=1e-4))


LAYOUT = Layout(
    name="scannet",
    description="color/, depth/, pose/, intrinsic/ (ScanNet, extracted), or views without depth/",
    matches=_matches,
    read=_read,
)
