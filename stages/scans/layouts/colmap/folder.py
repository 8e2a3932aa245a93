"""COLMAP: a sparse model, optionally with dense depth maps.

images/                                    the images; undistorted in a dense workspace
sparse/cameras.bin, images.bin             or .txt; also in sparse/0/, next to images/, in colmap/sparse/0/ …
sparse/points3D.bin                        or .txt: determines the depth range of each image
stereo/depth_maps/<name>.geometric.bin     or .photometric.bin
depth/<name>.npy                           or depth_maps/, depths/: maps that a network predicted, in the unit
                                           of the model, optionally with conf/<name>.npy

Without depth maps, the images are single views.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import read_array, read_image_size
from scanloom.stages.scans.codes import (
    DEPTH_RANGE_UNKNOWN,
    FILE_COLMAP_INVALID,
    FRAME_IMAGE_MISSING,
    SCAN_ASSUMED,
    SCAN_FILES_MISSING,
)
from scanloom.stages.scans.image_folders.image_files import extract_numbers
from scanloom.stages.scans.layouts.colmap import model_files as colmap
from scanloom.stages.scans.layouts.colmap.model_files import ColmapImage
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.posed_views import create_view_frame, to_metres
from scanloom.stages.scans.layouts.shared.predicted_maps import choose_min_confidence, read_levels, read_map
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
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

# nerfstudio stores the model below colmap/. Numbered subfolders hold disconnected models.
_MODEL_FOLDERS = ("sparse", ".", "colmap/sparse", "colmap")
# Dense workspace locations of COLMAP's own scripts, relative to the scan folder.
_WORKSPACE_FOLDERS = (".", "dense", "dense/0")
_DEPTH_MAP_KINDS = ("geometric", "photometric")
_PREDICTED_DEPTH_FOLDERS = ("depth", "depth_maps", "depths")
_CONFIDENCE_FOLDERS = ("conf", "confidence")
# Relative tolerance of the aspect ratio: COLMAP rounds sizes to whole pixels when it downscales images.
_ASPECT_RATIO_TOLERANCE = 0.02
# Number of views whose images are checked against the cameras of the model.
_SAMPLE_COUNT = 8


def _matches(folder: Path) -> str | None:
    models = next(filter(None, map(_find_models, _list_workspaces(folder))), None)
    return None if models is None else f"cameras and images in {models[0].relative_to(folder).as_posix()}/"


def _list_workspaces(folder: Path) -> list[Path]:
    return [folder / name for name in _WORKSPACE_FOLDERS]


def _find_models(folder: Path) -> list[Path]:
    """Return the models at the first location that has any.

    Several models are disconnected reconstructions of parts of the images.
    """
    for place in (folder / name for name in _MODEL_FOLDERS):
        if colmap.has_model(place):
            return [place]
        inner = [one for one in place.iterdir() if one.name.isdecimal()] if place.is_dir() else []
        found = sorted((one for one in inner if colmap.has_model(one)), key=lambda one: int(one.name))
        if found:
            return found
    return []


def _select_largest_model(models: Sequence[Path]) -> Path:
    """Return the model with the most images, and warn about the others."""
    if len(models) == 1:
        return models[0]
    counts = [colmap.count_images(model) for model in models]
    largest = models[counts.index(max(counts))]
    emit(
        SCAN_ASSUMED.warning(
            "the folder has {count} models without a common world frame: {largest}/ is read, which "
            "has the most images ({sizes})",
            count=len(models),
            largest=largest.name,
            sizes=", ".join(f"{one.name}/ ({n})" for one, n in zip(models, counts, strict=True)),
        )
    )
    return largest


def _read(folder: Path, options: ReadingParams) -> Scan:
    workspaces = [one for one in _list_workspaces(folder) if _find_models(one)]
    if not workspaces:
        raise InputError(
            SCAN_FILES_MISSING,
            "a COLMAP model (cameras and images, .bin or .txt) is required in the folder, in sparse/ "
            "or in sparse/0/.",
            folder,
        )
    workspace = _select_workspace(folder, workspaces)
    model = _select_largest_model(_find_models(workspace))
    views = sorted(colmap.read_model(model), key=lambda view: (extract_numbers(view.name), view.name))
    depths = {view.name: _find_depth_map(workspace, view) for view in views}
    has_no_depth = not any(depths.values())
    points = colmap.read_points(model) if has_no_depth else {}
    images = _get_image_folder(workspace)
    poses = _read_poses(folder, views, options)
    frames: list[Frame] = []
    skipped: list[SkippedFrame] = []
    for view, pose in zip(views, poses, strict=True):
        depth = depths[view.name]
        name = PurePosixPath(view.name).with_suffix("").as_posix()
        camera = _apply_stated_camera(view.camera, options)
        try:
            if has_no_depth:
                found = _get_observed_points(points, view, options)
                frames.append(create_view_frame(name, camera, images / view.name, pose, points=found))
                continue
            if depth is None:
                raise InputError(FRAME_IMAGE_MISSING, "its depth map is missing.")
            frames.append(_create_frame(name, view, camera, pose, images / view.name, depth, options))
        except InputError as error:
            skipped.append(SkippedFrame(name, error.diagnostic))
    is_depth_predicted = any(depth is not None and depth.suffix == ".npy" for depth in depths.values())
    if is_depth_predicted:
        frames = _add_confidence(frames, workspace, options)
    _check_depths(frames)
    if has_no_depth and not points:
        emit(
            DEPTH_RANGE_UNKNOWN.warning(
                "the model has no points (points3D.bin or .txt): the depth range is estimated from the "
                "images alone",
                remedy="set depth.min_depth and depth.max_depth if that fails",
            )
        )
    # Poses given by the user are in metres. Depth maps stay in the unit of the model.
    is_metric = options.depth_scale is not None or (has_no_depth and options.poses is not None)
    return Scan(
        LAYOUT.name,
        frames,
        None,
        folder,
        tuple(skipped),
        is_metric=is_metric,
        is_depth_predicted=is_depth_predicted,
    )


def _select_workspace(folder: Path, workspaces: Sequence[Path]) -> Path:
    """Choose the folder to read among those with a model.

    Folders whose images exist and match the cameras are preferred, then those with depth maps.
    """
    fitting = [one for one in workspaces if _has_matching_images(one)] or workspaces
    workspace = next((one for one in fitting if (one / "stereo" / "depth_maps").is_dir()), fitting[0])
    if workspaces[0] not in fitting:
        emit(
            SCAN_ASSUMED.warning(
                "the images of {model}/ are missing or have another shape: {other}/, whose images match, "
                "is read instead",
                model=_find_models(workspaces[0])[0].relative_to(folder).as_posix(),
                other=workspace.relative_to(folder).as_posix(),
            )
        )
    return workspace


def _has_matching_images(workspace: Path) -> bool:
    """Return True if the images of a model match its cameras.

    A sample is tested: the first image that exists must have the shape of its camera.
    """
    try:
        with collecting(forward=False):
            model = _select_largest_model(_find_models(workspace))
        views = colmap.read_model(model)
        for view in views[:: max(1, len(views) // _SAMPLE_COUNT)]:
            image = _get_image_folder(workspace) / view.name
            if image.is_file():
                width, height = read_image_size(image)
                camera = view.camera
                return math.isclose(
                    width / camera.width, height / camera.height, rel_tol=_ASPECT_RATIO_TOLERANCE
                )
    except InputError:
        pass  # Reported when the model is read.
    return False


def _get_image_folder(workspace: Path) -> Path:
    return workspace / "images" if (workspace / "images").is_dir() else workspace


def _apply_stated_camera(camera: Camera, options: ReadingParams) -> Camera:
    """Return the camera with the intrinsics given by the user.

    A fisheye camera keeps its lens model and distortion coefficients.
    """
    stated = options.get_camera(camera.width, camera.height)
    if stated is None or not camera.fisheye:
        return stated or camera
    return replace(stated, distortion=camera.distortion, fisheye=True)


def _get_observed_points(
    points: Mapping[int, NDArray[np.float64]], view: ColmapImage, options: ReadingParams
) -> NDArray[np.float64] | None:
    """Return the points (n, 3) observed in a view, metres, or None.

    None if the user gave the poses: their world frame differs from the frame of the points.
    """
    if options.poses is not None or view.image_id not in points:
        return None
    return points[view.image_id] / (options.depth_scale or 1.0)


def _find_depth_map(workspace: Path, view: ColmapImage) -> Path | None:
    maps = workspace / "stereo" / "depth_maps"
    files = [maps / f"{view.name}.{kind}.bin" for kind in _DEPTH_MAP_KINDS]
    stem = PurePosixPath(view.name).with_suffix(".npy")
    files += [workspace / folder / stem for folder in _PREDICTED_DEPTH_FOLDERS]
    return next((path for path in files if path.is_file()), None)


def _add_confidence(frames: list[Frame], workspace: Path, options: ReadingParams) -> list[Frame]:
    """Add the confidence maps of predicted depth, if each frame has one."""
    folder = next((workspace / name for name in _CONFIDENCE_FOLDERS if (workspace / name).is_dir()), None)
    paths = [None if folder is None else folder / f"{frame.name}.npy" for frame in frames]
    found = [path for path in paths if path is not None and path.is_file()]
    if len(found) < len(frames):
        return frames
    sizes = [(frame.camera.height, frame.camera.width) for frame in frames]
    maps = [
        PackedImage(path, "confidence", partial(read_levels, path, size))
        for path, size in zip(found, sizes, strict=True)
    ]
    least = choose_min_confidence(maps, options)
    return [
        replace(frame, confidence=one, min_confidence=least) for frame, one in zip(frames, maps, strict=True)
    ]


def _read_poses(folder: Path, views: Sequence[ColmapImage], options: ReadingParams) -> Sequence[Pose | None]:
    """Return the camera-to-world poses of the views.

    In metres if the scale is known.
    """
    given = options.resolve_file("poses", folder)
    if given is not None:
        return trajectories.match_poses_to_frames(
            trajectories.read_trajectory(given), [view.name for view in views], given
        )
    # Model lengths and depth maps have the same unit, so `choose_depth_scale` applies to both.
    return [to_metres(view.world_from_camera, options.depth_scale) for view in views]


def _create_frame(
    name: str,
    view: ColmapImage,
    full_camera: Camera,
    pose: Pose | None,
    color: Path,
    depth: Path,
    options: ReadingParams,
) -> Frame:
    """Create a frame with depth.

    Raises
    ------
    InputError
        If the depth map is unreadable or its shape differs from the shape of its camera.
    """
    is_predicted = depth.suffix == ".npy"
    width, height = _read_array_size(depth) if is_predicted else colmap.read_depth_map_size(depth)
    if not math.isclose(
        width / full_camera.width, height / full_camera.height, rel_tol=_ASPECT_RATIO_TOLERANCE
    ):
        raise InputError(
            FILE_COLMAP_INVALID,
            (
                "the depth map is {width}×{height} pixels, which differs in shape from its camera with "
                "{full_width}×{full_height}."
            ),
            depth,
            width=width,
            height=height,
            full_width=full_camera.width,
            full_height=full_camera.height,
        )
    return Frame(
        name=name,
        camera=scale_camera(full_camera, width, height),
        color=color,
        depth=PackedImage(
            depth,
            view.name,
            partial(read_map, depth, (height, width))
            if is_predicted
            else partial(colmap.read_depth_map, depth),
        ),
        depth_scale=options.depth_scale or 1.0,
        world_from_camera=pose,
    )


def _read_array_size(path: Path) -> tuple[int, int]:
    shape = [side for side in read_array(path, "the depth map").shape if side != 1]
    if len(shape) != 2:
        raise InputError(
            FILE_COLMAP_INVALID,
            "the depth map is {shape}; (height, width) is expected.",
            path,
            shape=tuple(shape),
        )
    return shape[1], shape[0]


def _check_depths(frames: Sequence[Frame]) -> None:
    """Warn about depth maps of another model, and about photometric ones."""
    computed = [
        one for one in frames if isinstance(one.depth, PackedImage) and one.depth.file.suffix == ".bin"
    ]
    if any(frame.camera.distortion for frame in computed):
        emit(
            SCAN_ASSUMED.warning(
                "the cameras have lens distortion, but COLMAP computes depth maps only for undistorted "
                "images: the model may not belong to the depth maps"
            )
        )
    unchecked = sum(
        isinstance(one.depth, PackedImage) and ".photometric." in one.depth.file.name for one in frames
    )
    if unchecked:
        emit(
            SCAN_ASSUMED.warning(
                "{count} depth maps are photometric, without a geometric consistency check: expect more "
                "noise",
                count=unchecked,
            )
        )


LAYOUT = Layout(
    name="colmap",
    description="cameras and images .bin|txt (also in sparse/ …), images/, optionally stereo/depth_maps/ or "
    "depth/*.npy (COLMAP)",
    matches=_matches,
    read=_read,
)
