"""nerfstudio, instant-ngp and Blender: `transforms.json` with views, cameras and poses.

Cameras use OpenGL axes (y up, z back). `applied_transform` A and `applied_scale` s define the stored
world, p_file = s · A p. The result is in the world of p, in which depth is metric. If no frame has a
depth map, all frames are single views. Masks (`mask_path`) and transparency mark background pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.camera_resolution import get_stated_camera
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_CONTRADICTORY,
    CAMERA_CALIBRATION_INVALID,
    CAMERA_LENS_UNKNOWN,
    FRAME_IMAGE_MISSING,
    SCAN_ASSUMED,
    SCAN_FILES_MISSING,
    SCAN_TABLE_DAMAGED,
)
from scanloom.stages.scans.image_folders.image_files import IMAGE_SUFFIXES, extract_numbers, find_common_size
from scanloom.stages.scans.image_folders.path_remapping import find_listed_file, find_listed_images
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.phone_scans import scale_to_size
from scanloom.stages.scans.layouts.shared.posed_views import (
    create_view_frame,
    find_transparency_mask,
    to_metres,
)
from scanloom.stages.scans.model.poses import (
    check_rigid_pose,
    from_opengl,
    invert_pose,
    normalise_homogeneous,
    parse_pose_matrix,
)
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, Frame, PackedImage, Pose, Scan, SkippedFrame
from scanloom.stages.scans.model.world import Z_UP, WorldUp, create_layout_up
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

_PREFERRED_LISTS = ("transforms.json", "transforms_train.json")
# Relative tolerance between a stated focal length and a stated field of view, which are both rounded.
_FOCAL_LENGTH_TOLERANCE = 0.02
_SIZE_KEYS = ("w", "h")
_DISTORTION_KEYS = ("k1", "k2", "p1", "p2", "k3")
# Keys that may appear once for the whole file or in every frame, but not in both.
_CAMERA_KEYS = (
    *_SIZE_KEYS,
    *("fl_x", "fl_y", "cx", "cy", "camera_angle_x", "camera_angle_y"),
    *_DISTORTION_KEYS,
    *("k4", "camera_model", "is_fisheye"),
)
_PINHOLE_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
# Names of OpenCV's fisheye model, whose k1 … k4 multiply powers of the angle.
_FISHEYE_MODELS = ("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
_FISHEYE_DISTORTION_KEYS = ("k1", "k2", "k3", "k4")
# Depth map keys of nerfstudio and instant-ngp.
_DEPTH_KEYS = ("depth_file_path", "depth_path")


def _matches(folder: Path) -> str | None:
    found = _find_view_list(folder)
    return None if found is None else found.name


def _find_view_list(folder: Path) -> Path | None:
    found = sorted(folder.glob("transforms*.json"))
    preferred = [folder / name for name in _PREFERRED_LISTS if folder / name in found]
    return next(iter(preferred + found), None)


def _read(folder: Path, options: ReadingParams) -> Scan:
    path = _find_view_list(folder)
    if path is None:
        raise InputError(SCAN_FILES_MISSING, "transforms.json is missing.", folder)
    document = documents.read_json(path)
    entries = document.get("frames") if isinstance(document, dict) else None
    if not isinstance(document, dict) or not isinstance(entries, list) or not entries:
        raise InputError(SCAN_TABLE_DAMAGED, "the file has no list of frames.", path)
    entries = _sort_entries(entries, path)
    _require_unmixed(document, entries, path)
    used = [entry for entry in entries if _get_depth_path(entry) is not None] or entries
    labels = [f"frame {_get_name(entry)}: file_path" for entry in used]
    colors = find_listed_images(folder, [entry["file_path"] for entry in used], labels, path)
    depths = [
        find_listed_file(folder, _get_depth_path(entry), f"frame {_get_name(entry)}: its depth", path)
        for entry in used
        if _get_depth_path(entry) is not None
    ]
    masks = [_find_mask(folder, entry, color, path) for entry, color in zip(used, colors, strict=True)]
    cameras = _read_cameras(folder, options, [document | entry for entry in used], colors, path)
    given = options.resolve_file("poses", folder)
    if given is None:
        poses = _parse_poses(document, used, path)
    else:
        names = [_get_name(entry) for entry in used]
        poses = trajectories.match_poses_to_frames(trajectories.read_trajectory(given), names, given)
    _warn_other_lists(folder, path)
    if not depths:
        if given is None:
            # Without depth maps, depth_scale defines the unit of the poses.
            poses = [to_metres(pose, options.depth_scale) for pose in poses]
        is_metric = given is not None or options.depth_scale is not None
        views = [_create_view(*one) for one in zip(used, cameras, colors, masks, poses, strict=True)]
        frames = [one for one in views if isinstance(one, Frame)]
        skipped = [one for one in views if isinstance(one, SkippedFrame)]
    else:
        in_units = _parse_depth_scale(document, path)
        scale = options.depth_scale or in_units
        # Renderers and instant-ngp write depth in world units, which have no known scale.
        is_rendered = in_units is not None or any(depth.suffix.lower() == ".exr" for depth in depths)
        is_metric = options.depth_scale is not None or not is_rendered
        frames = _create_frames(used, cameras, colors, masks, depths, poses, scale, path)
        skipped = [
            SkippedFrame(
                _get_name(entry), FRAME_IMAGE_MISSING.warning("it has no depth_file_path or depth_path")
            )
            for entry in entries
            if _get_depth_path(entry) is None
        ]
    return Scan(
        LAYOUT.name,
        frames,
        None,
        folder,
        tuple(skipped),
        up=_find_up(document, entries),
        is_metric=is_metric,
    )


def _find_up(document: dict[str, Any], entries: Sequence[dict[str, Any]]) -> WorldUp | None:
    """Return the up direction of Blender's NeRF script files, or None.

    Blender's world has z up. Files of photo reconstructions have the same structure, but state a focal
    length or image size; their world orientation is arbitrary.
    """
    is_plain = document.keys() == {"camera_angle_x", "frames"}
    is_blenders = is_plain and all("rotation" in entry for entry in entries)
    return create_layout_up(LAYOUT.name, Z_UP) if is_blenders else None


def _create_view(
    entry: dict[str, Any], camera: Camera, color: Path, mask: Path | PackedImage | None, pose: Pose | None
) -> Frame | SkippedFrame:
    try:
        return create_view_frame(_get_name(entry), camera, color, pose, mask=mask)
    except InputError as error:
        return SkippedFrame(_get_name(entry), error.diagnostic)


def _create_frames(
    entries: Sequence[dict[str, Any]],
    cameras: Sequence[Camera],
    colors: Sequence[Path],
    masks: Sequence[Path | PackedImage | None],
    depths: Sequence[Path],
    poses: Sequence[Pose | None],
    scale: float | None,
    path: Path,
) -> list[Frame]:
    """Create the frames of views with depth."""
    depth_cameras = _scale_to_depth_maps(cameras, depths, path)
    return [
        Frame(
            name=_get_name(entry),
            camera=depth_camera,
            color=color,
            depth=depth,
            # OpenEXR depth comes from renderers, in world units.
            depth_scale=scale or (1.0 if depth.suffix.lower() == ".exr" else 1000.0),
            world_from_camera=pose,
            color_camera=None if camera == depth_camera else camera,
            mask=mask,
        )
        for entry, camera, depth_camera, color, mask, depth, pose in zip(
            entries, cameras, depth_cameras, colors, masks, depths, poses, strict=True
        )
    ]


def _warn_other_lists(folder: Path, path: Path) -> None:
    """Warn about other transforms*.json files, which are not read."""
    others = [other.name for other in sorted(folder.glob("transforms*.json")) if other != path]
    if others:
        emit(
            SCAN_ASSUMED.warning(
                "only {file} is read; {others} are ignored", file=path.name, others=", ".join(others)
            )
        )


def _sort_entries(entries: list[Any], path: Path) -> list[dict[str, Any]]:
    """Return the frames sorted by the numbers in their names.

    Reconstruction tools list frames in any order.
    """
    for position, entry in enumerate(entries):
        if (
            not isinstance(entry, dict)
            or not isinstance(entry.get("file_path"), str)
            or not entry["file_path"]
        ):
            raise InputError(
                SCAN_TABLE_DAMAGED,
                "frame {position} is not an object with a file_path.",
                path,
                position=position,
            )
    return sorted(entries, key=lambda entry: (extract_numbers(_get_name(entry)), entry["file_path"]))


def _get_name(entry: dict[str, Any]) -> str:
    # Path.stem would cut Blender's names, which have no extension but may contain a dot.
    name = entry["file_path"].replace("\\", "/").rsplit("/", 1)[-1]
    suffix = next((suffix for suffix in IMAGE_SUFFIXES if name.lower().endswith(suffix)), "")
    return str(name[: len(name) - len(suffix)])


def _get_depth_path(entry: dict[str, Any]) -> object:
    return next((entry[key] for key in _DEPTH_KEYS if entry.get(key) is not None), None)


def _find_mask(folder: Path, entry: dict[str, Any], color: Path, path: Path) -> Path | PackedImage | None:
    """Return the mask file of a view, or its transparency as mask."""
    if entry.get("mask_path") is not None:
        return find_listed_file(folder, entry["mask_path"], f"frame {_get_name(entry)}: mask_path", path)
    return find_transparency_mask(color)


def _require_unmixed(document: dict[str, Any], entries: Sequence[dict[str, Any]], path: Path) -> None:
    for key in _CAMERA_KEYS:
        having = [entry for entry in entries if key in entry]
        if having and (key in document or len(having) < len(entries)):
            where = "the whole file" if key in document else "other frames"
            lacking = " as well as" if key in document else ", unlike"
            raise InputError(
                SCAN_TABLE_DAMAGED,
                "frame {name} states {key}{lacking} {place}.",
                path,
                remedy="State it once for the whole file, or in every frame.",
                key=key,
                name=_get_name(having[0]),
                lacking=lacking,
                place=where,
            )


def _read_cameras(
    folder: Path,
    options: ReadingParams,
    tables: Sequence[dict[str, Any]],
    colors: Sequence[Path],
    path: Path,
) -> list[Camera]:
    """Return the camera of each colour image."""
    sizes: list[tuple[int, int]] = []
    for table in tables:
        width, height = (table.get(key) for key in _SIZE_KEYS)
        if width is None or height is None:
            sizes = [find_common_size(colors)] * len(tables)
            break
        sizes.append((_parse_pixels(width, "w", path), _parse_pixels(height, "h", path)))
    stated = {size: get_stated_camera(options, folder, *size) for size in set(sizes)}
    return [
        _apply_stated_camera(stated[size], table, size, path)
        for table, size in zip(tables, sizes, strict=True)
    ]


def _apply_stated_camera(
    given_camera: Camera | None, table: dict[str, Any], size: tuple[int, int], path: Path
) -> Camera:
    """Return the camera of a frame, with intrinsics given by the user.

    A fisheye camera keeps its lens model and distortion coefficients.
    """
    is_fisheye = _is_fisheye(table, path)
    if given_camera is None:
        return _parse_camera(table, *size, path)
    if given_camera.fisheye or not is_fisheye:
        return given_camera
    return replace(
        given_camera, distortion=_parse_distortion(table, _FISHEYE_DISTORTION_KEYS, path), fisheye=True
    )


def _is_fisheye(table: dict[str, Any], path: Path) -> bool:
    """Return True for a fisheye camera, False for a pinhole camera.

    Raises
    ------
    InputError
        If the camera model is neither of them.
    """
    model = table.get("camera_model", "OPENCV")
    if model in _FISHEYE_MODELS:
        return True
    if model not in _PINHOLE_MODELS:
        raise InputError(
            CAMERA_LENS_UNKNOWN,
            (
                "unsupported camera_model {model!r}: pinhole cameras with OpenCV distortion and OpenCV "
                "fisheyes are supported. Undistort the images and depth maps to PINHOLE first."
            ),
            path,
            model=str(model)[:40],
        )
    return bool(table.get("is_fisheye"))


def _parse_distortion(table: dict[str, Any], keys: Sequence[str], path: Path) -> tuple[float, ...]:
    return tuple(_parse_number(table, key, path, 0.0) for key in keys)


def _parse_camera(table: dict[str, Any], width: int, height: int, path: Path) -> Camera:
    is_fisheye = _is_fisheye(table, path)
    if not is_fisheye and _parse_number(table, "k4", path, 0.0):
        raise InputError(
            CAMERA_LENS_UNKNOWN,
            "k4 is not 0, but OpenCV's pinhole model has no such term. Undistort the images first.",
            path,
        )
    fx = _parse_focal_length(table, "x", width, path)
    fy = _parse_focal_length(table, "y", height, path) or fx
    fx = fx or fy
    if fx is None or fy is None:
        raise InputError(
            CAMERA_CALIBRATION_INVALID, "no focal length: fl_x and camera_angle_x are missing.", path
        )
    # Convert from COLMAP's convention (pixel corner at 0), which most files use.
    cx = _parse_number(table, "cx", path, width / 2) - 0.5
    cy = _parse_number(table, "cy", path, height / 2) - 0.5
    if is_fisheye:
        distortion = _parse_distortion(table, _FISHEYE_DISTORTION_KEYS, path)
    else:
        distortion = distortion if any(distortion := _parse_distortion(table, _DISTORTION_KEYS, path)) else ()
    return calibration.check_camera_values(
        Camera(width, height, fx, fy, cx, cy, distortion, is_fisheye), path
    )


def _parse_focal_length(table: dict[str, Any], axis: str, pixels: int, path: Path) -> float | None:
    """Return the focal length in pixels, or None.

    Taken from fl_x or fl_y, or from the field of view.

    None if neither is stated. If both contradict each other, the focal length is used, with a warning.
    """
    stated, key = None, f"camera_angle_{axis}"
    if table.get(f"fl_{axis}") is not None:
        stated = _parse_number(table, f"fl_{axis}", path, math.nan)
    if table.get(key) is None:
        return stated
    angle = _parse_number(table, key, path, math.nan)
    if not 0 < angle < math.pi:
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "{key} is {angle:g}; it must be an angle between 0 and π radians.",
            path,
            key=key,
            angle=angle,
        )
    by_angle = 0.5 * pixels / math.tan(0.5 * angle)
    if stated is not None and abs(by_angle - stated) > _FOCAL_LENGTH_TOLERANCE * abs(stated):
        emit(
            CAMERA_CALIBRATION_CONTRADICTORY.warning(
                "the focal length {stated:.4g} px (fl_{axis}) contradicts {by_angle:.4g} px ({key}, for "
                "{pixels} px): fl_{axis} is used",
                path,
                stated=stated,
                axis=axis,
                by_angle=by_angle,
                key=key,
                pixels=pixels,
            )
        )
    return by_angle if stated is None else stated


def _parse_number(table: dict[str, Any], key: str, path: Path, default: float) -> float:
    value = table.get(key)
    if value is None:
        return default
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < 1e12:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "{key} is {value!r}; a number is expected.",
            path,
            key=key,
            value=str(value)[:40],
        )
    return float(value)


def _parse_pixels(value: object, key: str, path: Path) -> int:
    # Some tools write all numbers as floats.
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < 1 << 16:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "{key} is {value!r}; an image size in pixels is expected.",
            path,
            key=key,
            value=str(value)[:40],
        )
    if value != int(value):
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "{key} is {value}; a whole number of pixels is expected.",
            path,
            key=key,
            value=value,
        )
    return int(value)


def _scale_to_depth_maps(cameras: Sequence[Camera], depths: Sequence[Path], path: Path) -> list[Camera]:
    """Return the camera of each depth map: its colour camera, scaled.

    Depth map sizes are determined per size of the colour camera.
    """
    files: dict[tuple[int, int], list[Path]] = {}
    for camera, depth in zip(cameras, depths, strict=True):
        files.setdefault((camera.width, camera.height), []).append(depth)
    sizes = {size: find_common_size(group) for size, group in files.items()}
    return [
        camera
        if (size := sizes[camera.width, camera.height]) == (camera.width, camera.height)
        else scale_to_size(camera, size, "the depth maps", path)
        for camera in cameras
    ]


def _parse_poses(
    document: dict[str, Any], entries: Sequence[dict[str, Any]], path: Path
) -> list[Pose | None]:
    """Return the poses in the original world, with OpenCV axes."""
    applied = check_rigid_pose(
        parse_pose_matrix(document.get("applied_transform", np.eye(4)), path, "applied_transform"),
        path,
        "applied_transform",
    )
    scale = _parse_number(document, "applied_scale", path, 1.0)
    if applied is None or scale <= 0:
        raise InputError(
            SCAN_TABLE_DAMAGED,
            "applied_transform and applied_scale must be finite, and the scale positive.",
            path,
        )
    original = invert_pose(applied)
    poses: list[Pose | None] = []
    for entry in entries:
        where = f"frame {_get_name(entry)}"
        matrix = parse_pose_matrix(entry.get("transform_matrix"), path, f"{where}: transform_matrix")
        pose = check_rigid_pose(normalise_homogeneous(matrix), path, where)
        if pose is not None:
            pose[:3, 3] /= scale
            pose = from_opengl(original @ pose)
        poses.append(pose)
    return poses


def _parse_depth_scale(document: dict[str, Any], path: Path) -> float | None:
    """Return the depth units per world unit from instant-ngp's `integer_depth_scale`, or None."""
    if document.get("integer_depth_scale") is None:
        return None
    step = _parse_number(document, "integer_depth_scale", path, math.nan)
    if step < 1e-12:
        raise InputError(
            SCAN_TABLE_DAMAGED, "integer_depth_scale is {step:g}; it must be positive.", path, step=step
        )
    return 1 / step


LAYOUT = Layout(
    name="nerfstudio",
    description="transforms.json, with or without depth_file_path (nerfstudio, instant-ngp, Blender)",
    matches=_matches,
    read=_read,
)
