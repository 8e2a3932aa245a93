"""Depth and cameras predicted by a network, such as VGGT, Depth Anything 3, MapAnything or CUT3R.

    predictions.npz                       arrays with one item per view: depth, confidence, cameras, images;
                                          or results.npz (Depth Anything 3), or the only such archive
    images/                               the photos, optional: their colours are finer than the archive's

or, as CUT3R writes them, one file per view:

    depth/000000.npy  conf/000000.npy  color/000000.png  camera/000000.npz

Lengths have no unit. Scale and offset of the depth of each view are corrected by `align_predicted_depth`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.array_archives import ArchivedArray, list_arrays
from scanloom.stages.files.image_bytes import MAX_PIXELS
from scanloom.stages.files.images import read_array
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration.named_arrays import read_small_arrays
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING, SCAN_PREDICTION_INVALID
from scanloom.stages.scans.image_folders.image_files import list_images
from scanloom.stages.scans.layouts.plain_views import find_photo_folder
from scanloom.stages.scans.layouts.shared.layout import Layout
from scanloom.stages.scans.layouts.shared.predicted_maps import (
    choose_min_confidence,
    create_shape_error,
    read_levels,
    read_map,
    to_confidence_levels,
)
from scanloom.stages.scans.layouts.shared.prediction_photos import match_photos
from scanloom.stages.scans.model.missing_data import describe_missing_poses
from scanloom.stages.scans.model.poses import check_rigid_pose, invert_pose, parse_pose_matrix
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import ColorImage, Frame, PackedImage, Pose, Scan, SkippedFrame
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories

# Archives by name, before any other archive of the folder.
_ARCHIVES = ("predictions.npz", "results.npz", "exports/npz/results.npz", "exports/mini_npz/results.npz")
_MAX_ARCHIVES = 8
# Names of arrays, the first one counts. Extrinsics map from world to camera, poses from camera to world.
_DEPTH_NAMES = ("depth", "depths", "depth_map", "depth_z")
_CONFIDENCE_NAMES = ("depth_conf", "conf", "confidence", "depth_confidence")
_IMAGE_NAMES = ("images", "image")
_EXTRINSICS_NAMES = ("extrinsic", "extrinsics", "world_to_camera", "w2c")
_POSE_NAMES = ("camera_poses", "poses", "pose", "cam2world", "cams2world", "camera_to_world", "c2w")
_INTRINSICS_NAMES = ("intrinsic", "intrinsics", "K")
_FOCAL_NAMES = ("focals", "focal")
_CAMERA_NAMES = (_EXTRINSICS_NAMES, _POSE_NAMES, _INTRINSICS_NAMES, _FOCAL_NAMES)


@dataclass(frozen=True)
class _Prediction:
    """Predicted views.

    Attributes
    ----------
    source : the archive or folder.
    names : of the views.
    size : (width, height) of the depth maps.
    depths, confidences, colors : by view; `colors` holds None without images.
    matrices : camera matrices.
    poses : camera-to-world; None where a view has none.
    """

    source: Path
    names: list[str]
    size: tuple[int, int]
    depths: list[PackedImage]
    confidences: list[PackedImage] | None
    colors: Sequence[PackedImage | Path | None]
    matrices: list[NDArray[np.float64]]
    poses: list[Pose | None]


def _matches(folder: Path) -> str | None:
    if _has_view_files(folder):
        return "depth/*.npy and camera/*.npz"
    archive = _find_archive(folder)
    return None if archive is None else f"{archive.relative_to(folder)} with depth and cameras"


def _has_view_files(folder: Path) -> bool:
    return (folder / "camera").is_dir() and bool(
        _list(folder / "camera", ".npz") and _list(folder / "depth", ".npy")
    )


def _list(folder: Path, suffix: str) -> list[Path]:
    return sorted(folder.glob(f"*{suffix}"))


def _find_archive(folder: Path) -> Path | None:
    named = [folder / name for name in _ARCHIVES if (folder / name).is_file()]
    for path in (*named, *_list(folder, ".npz")[:_MAX_ARCHIVES]):
        try:
            arrays = list_arrays(path)
        except InputError:
            continue
        if _select(arrays, _DEPTH_NAMES) and any(_select(arrays, names) for names in _CAMERA_NAMES):
            return path
    return None


def _select(arrays: dict[str, ArchivedArray], names: Sequence[str]) -> ArchivedArray | None:
    return next((arrays[name] for name in names if name in arrays), None)


def _read(folder: Path, options: ReadingParams) -> Scan:
    if folder.is_file():
        prediction, photo_folder = _read_archive(folder), find_photo_folder(folder.parent)
    elif _has_view_files(folder):
        prediction, photo_folder = _read_view_files(folder), None
    else:
        archive = _find_archive(folder)
        if archive is None:
            raise InputError(
                SCAN_PREDICTION_INVALID,
                "a .npz archive with the arrays depth, extrinsic and intrinsic is required.",
                folder,
            )
        prediction, photo_folder = _read_archive(archive), find_photo_folder(folder)
    return _create_scan(
        prediction, [] if photo_folder is None else list_images(photo_folder), folder, options
    )


def _create_scan(
    prediction: _Prediction, photos: Sequence[Path], folder: Path, options: ReadingParams
) -> Scan:
    width, height = prediction.size
    source, names = prediction.source, prediction.names
    stated = options.get_camera(width, height)
    given = options.resolve_file("calibration", folder if folder.is_dir() else folder.parent)
    if stated is None and given is not None:
        stated = calibration.read_camera(given, width, height)
    matched = match_photos(photos, prediction.colors, prediction.size, source)
    if matched is not None:
        names = [photo.stem for photo in photos]
    elif not any(prediction.colors):
        raise InputError(
            SCAN_PREDICTION_INVALID,
            "it holds no images.",
            source,
            remedy="Put the photos, one per view in the order of the views, into images/ in the scan folder.",
        )
    poses, missing = prediction.poses, []
    path = options.resolve_file("poses", folder if folder.is_dir() else folder.parent)
    if path is not None:
        poses = trajectories.match_poses_to_frames(trajectories.read_trajectory(path), names, path)
    if not any(pose is not None for pose in poses):
        missing.append(describe_missing_poses("{file} has no array extrinsic", file=source.name))
    least = choose_min_confidence(prediction.confidences, options)
    frames, skipped = [], []
    for place, name in enumerate(names):
        try:
            camera = stated or calibration.create_camera_from_matrix(
                prediction.matrices[place], (), width, height, source
            )
        except InputError as error:
            skipped.append(SkippedFrame(name, error.diagnostic))
            continue
        color, color_camera = prediction.colors[place], None
        if matched is not None:
            color, color_camera = photos[place], matched[place].apply(camera)
        if color is None:
            skipped.append(SkippedFrame(name, FRAME_IMAGE_MISSING.warning("its colour image is missing")))
            continue
        frames.append(
            Frame(
                name=name,
                camera=camera,
                color=color,
                depth=prediction.depths[place],
                depth_scale=options.depth_scale or 1.0,
                world_from_camera=poses[place],
                color_camera=color_camera,
                confidence=None if prediction.confidences is None else prediction.confidences[place],
                min_confidence=least,
            )
        )
    return Scan(
        LAYOUT.name,
        frames,
        None,
        folder,
        tuple(skipped),
        missing=tuple(missing),
        is_metric=options.depth_scale is not None,
        is_depth_predicted=True,
    )


def _read_archive(path: Path) -> _Prediction:
    arrays = list_arrays(path)
    depth = _select(arrays, _DEPTH_NAMES)
    if depth is None:
        raise create_shape_error(path, "depth", "missing", "(n, height, width)")
    shape = _get_view_shape(depth.shape)
    if shape is None or not 0 < shape[1] * shape[2] <= MAX_PIXELS or depth.kind not in "fiu":
        raise create_shape_error(path, depth.entry, str(depth.shape), "(n, height, width)")
    count, height, width = shape
    confidence, images = _select(arrays, _CONFIDENCE_NAMES), _select(arrays, _IMAGE_NAMES)
    if confidence is not None and _get_view_shape(confidence.shape) != shape:
        raise create_shape_error(
            path, confidence.entry, str(confidence.shape), f"({count}, {height}, {width})"
        )
    names = [f"{place:06d}" for place in range(count)]
    colors: list[PackedImage | None] = [None] * count
    if images is not None:
        colors = list(_pack(images, names, "image", partial(_read_image, images, shape)))
    extrinsics, poses = _select(arrays, _EXTRINSICS_NAMES), _select(arrays, _POSE_NAMES)
    return _Prediction(
        source=path,
        names=names,
        size=(width, height),
        depths=_pack(depth, names, "depth", partial(_read_map, depth, shape)),
        confidences=None
        if confidence is None
        else _pack(confidence, names, "confidence", partial(_read_confidence, confidence, shape)),
        colors=colors,
        matrices=_read_matrices(arrays, count, (width, height), path),
        poses=_read_poses(extrinsics or poses, count, is_inverse=extrinsics is not None),
    )


def _get_view_shape(shape: tuple[int, ...]) -> tuple[int, int, int] | None:
    """Return (n, h, w) of depth maps, which may have a batch of one and one channel."""
    if len(shape) >= 4 and shape[-1] == 1:
        shape = shape[:-1]
    if len(shape) == 4 and shape[0] == 1:
        shape = shape[1:]
    return (shape[0], shape[1], shape[2]) if len(shape) == 3 and shape[0] > 0 else None


def _pack(
    array: ArchivedArray, names: Sequence[str], kind: str, load: Callable[[int], NDArray[Any]]
) -> list[PackedImage]:
    return [
        PackedImage(array.path, f"{kind} {name}", partial(load, place)) for place, name in enumerate(names)
    ]


def _read_map(array: ArchivedArray, shape: tuple[int, int, int], place: int) -> NDArray[np.float32]:
    # Values beyond single precision become infinite, which is missing depth.
    with np.errstate(over="ignore"):
        return np.array(array.read().reshape(shape)[place], np.float32)


def _read_confidence(array: ArchivedArray, shape: tuple[int, int, int], place: int) -> NDArray[np.uint8]:
    return to_confidence_levels(_read_map(array, shape, place))


def _read_image(array: ArchivedArray, shape: tuple[int, int, int], place: int) -> ColorImage:
    """Read an image of integers from 0 to 255 or floats from 0 to 1, channels first or last."""
    count, height, width = shape
    for layout, to_last in (((count, 3, height, width), (1, 2, 0)), ((count, height, width, 3), (0, 1, 2))):
        if array.shape in (layout, (1, *layout)):
            image = array.read().reshape(layout)[place].transpose(to_last)
            if image.dtype.kind == "f":
                image = np.rint(np.nan_to_num(image).clip(0, 1) * 255)
            image = image.astype(np.int64).clip(0, 255)
            return np.ascontiguousarray(image, np.uint8)
    raise create_shape_error(array.path, array.entry, str(array.shape), f"({count}, {height}, {width}, 3)")


def _read_matrices(
    arrays: dict[str, ArchivedArray], count: int, size: tuple[int, int], path: Path
) -> list[NDArray[np.float64]]:
    """Return the camera matrix of each view, of one array of matrices or of focal lengths."""
    stored, focal = _select(arrays, _INTRINSICS_NAMES), _select(arrays, _FOCAL_NAMES)
    if stored is not None:
        if stored.shape[-2:] != (3, 3) or stored.shape not in ((3, 3), (count, 3, 3), (1, count, 3, 3)):
            raise create_shape_error(path, stored.entry, str(stored.shape), f"({count}, 3, 3)")
        values = np.asarray(stored.read(), np.float64).reshape(-1, 3, 3)
        return list(np.broadcast_to(values, (count, 3, 3)))
    if focal is None or int(np.prod(focal.shape)) not in (1, count):
        raise create_shape_error(path, "intrinsic", "missing", f"({count}, 3, 3)")
    lengths = np.broadcast_to(np.asarray(focal.read(), np.float64).ravel(), count)
    return [np.array([[f, 0, size[0] / 2], [0, f, size[1] / 2], [0, 0, 1]]) for f in lengths.tolist()]


def _read_poses(stored: ArchivedArray | None, count: int, *, is_inverse: bool) -> list[Pose | None]:
    if stored is None:
        return [None] * count
    rows = stored.shape[-2] if len(stored.shape) >= 2 else 0
    if rows not in (3, 4) or stored.shape not in ((count, rows, 4), (1, count, rows, 4)):
        raise create_shape_error(stored.path, stored.entry, str(stored.shape), f"({count}, 3, 4)")
    matrices = np.asarray(stored.read(), np.float64).reshape(count, rows, 4)
    poses = [check_rigid_pose(matrix, stored.path, f"view {place}") for place, matrix in enumerate(matrices)]
    return [invert_pose(pose) if is_inverse and pose is not None else pose for pose in poses]


def _read_view_files(folder: Path) -> _Prediction:
    """Read one file of depth, confidence, colour and camera per view."""
    cameras = {path.stem: path for path in _list(folder / "camera", ".npz")}
    depths = {path.stem: path for path in _list(folder / "depth", ".npy")}
    names = sorted(cameras.keys() & depths.keys())
    if not names:
        raise InputError(
            SCAN_PREDICTION_INVALID, "no file of depth/ has the name of a file of camera/.", folder
        )
    shape = _get_view_shape((1, *read_array(depths[names[0]], "the depth map").shape))
    if shape is None or not 0 < shape[1] * shape[2] <= MAX_PIXELS:
        raise create_shape_error(depths[names[0]], "depth", "no map", "(height, width)")
    tables = [read_small_arrays(cameras[name]) for name in names]
    if not all("pose" in table and "intrinsics" in table for table in tables):
        raise create_shape_error(folder / "camera", "pose or intrinsics", "missing", "(4, 4) or (3, 3)")
    confidences = {path.stem: path for path in _list(folder / "conf", ".npy")}
    colors = (
        {path.stem: path for path in list_images(folder / "color")} if (folder / "color").is_dir() else {}
    )
    size = shape[1:]
    return _Prediction(
        source=folder,
        names=names,
        size=(shape[2], shape[1]),
        depths=[PackedImage(depths[name], "depth", partial(read_map, depths[name], size)) for name in names],
        confidences=[
            PackedImage(confidences[name], "confidence", partial(read_levels, confidences[name], size))
            for name in names
        ]
        if all(name in confidences for name in names)
        else None,
        colors=[colors.get(name) for name in names],
        matrices=[
            _parse_matrix(table["intrinsics"], cameras[name])
            for name, table in zip(names, tables, strict=True)
        ],
        poses=[
            check_rigid_pose(parse_pose_matrix(table["pose"], cameras[name], "pose"), cameras[name])
            for name, table in zip(names, tables, strict=True)
        ],
    )


def _parse_matrix(value: object, path: Path) -> NDArray[np.float64]:
    try:
        matrix = np.array(value, np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape != (3, 3):
        raise create_shape_error(path, "intrinsics", str(matrix.shape), "(3, 3)")
    return matrix


LAYOUT = Layout(
    name="predictions",
    description="predictions.npz or results.npz with depth, extrinsic and intrinsic (VGGT, Depth Anything "
    "3), or depth/, conf/, color/, camera/ (CUT3R)",
    matches=_matches,
    read=_read,
    suffixes=(".npz",),
)
