"""Reader of COLMAP's sparse models, their points, and depth maps.

Converts COLMAP's conventions: world-to-camera poses, quaternions with the scalar first, and pixel coordinates
relative to the corner of the top left pixel.
"""

from __future__ import annotations

import mmap
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import MACHINE_BUSY
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.files.codes import FILE_DAMAGED, FILE_DEPTH_FORMAT, FILE_TEXT_INVALID, FILE_UNREADABLE
from scanloom.stages.files.image_bytes import MAX_PIXELS
from scanloom.stages.files.input_files import open_input, read_input_bytes
from scanloom.stages.scans.calibration.camera_files import check_camera_values
from scanloom.stages.scans.calibration.fov_lens import convert_fov_to_fisheye
from scanloom.stages.scans.codes import CAMERA_LENS_UNKNOWN, FILE_COLMAP_INVALID
from scanloom.stages.scans.model.poses import create_pose_from_quaternion, invert_pose
from scanloom.stages.scans.model.scan import Camera, Pose


@dataclass(frozen=True)
class _CameraModel:
    """COLMAP camera model: name, parameter count, and mapping to OpenCV parameters.

    `intrinsic_indices` holds the parameter indices of fx, fy, cx, cy; `distortion_indices` those for k1, k2,
    p1, p2 …, with None for a coefficient of 0. For a fisheye, they are k1 to k4 of OpenCV's fisheye model.
    """

    name: str
    parameter_count: int
    intrinsic_indices: tuple[int, int, int, int] | None = None
    distortion_indices: tuple[int | None, ...] = ()
    is_fisheye: bool = False


# In the order of COLMAP's model IDs. Models without `intrinsic_indices` have no OpenCV equivalent.
_CAMERA_MODELS = (
    _CameraModel("SIMPLE_PINHOLE", 3, (0, 0, 1, 2)),
    _CameraModel("PINHOLE", 4, (0, 1, 2, 3)),
    _CameraModel("SIMPLE_RADIAL", 4, (0, 0, 1, 2), (3, None, None, None)),
    _CameraModel("RADIAL", 5, (0, 0, 1, 2), (3, 4, None, None)),
    _CameraModel("OPENCV", 8, (0, 1, 2, 3), (4, 5, 6, 7)),
    _CameraModel("OPENCV_FISHEYE", 8, (0, 1, 2, 3), (4, 5, 6, 7), is_fisheye=True),
    _CameraModel("FULL_OPENCV", 12, (0, 1, 2, 3), (4, 5, 6, 7, 8, 9, 10, 11)),
    _CameraModel("FOV", 5, (0, 1, 2, 3)),
    _CameraModel("SIMPLE_RADIAL_FISHEYE", 4, (0, 0, 1, 2), (3, None, None, None), is_fisheye=True),
    _CameraModel("RADIAL_FISHEYE", 5, (0, 0, 1, 2), (3, 4, None, None), is_fisheye=True),
    _CameraModel("THIN_PRISM_FISHEYE", 12),
    _CameraModel("RAD_TAN_THIN_PRISM_FISHEYE", 16),
)
_STEMS = ("cameras", "images")
_FILE_SUFFIXES = (".bin", ".txt")
_MAX_NAME_BYTES = 4096
# Points beyond this many units are outliers and ignored.
_MAX_COORDINATE = 1e9
_POINT2D_BYTES = 24
# Binary point record: ID, position, colour, error, track length; then 8 bytes per track element.
_POINT_FORMAT, _TRACK_ELEMENT_BYTES = "<Q3d3BdQ", 8
# Header of a depth map: width, height, channels. Only the first 64 bytes are searched.
_DEPTH_HEADER = re.compile(rb"(\d{1,9})&(\d{1,9})&(\d{1,9})&")
_DEPTH_HEADER_BYTES = 64


@dataclass(frozen=True, eq=False)
class ColmapImage:
    """Registered image of a model.

    Attributes
    ----------
    image_id : image ID in the model.
    name : path relative to the image folder, with `/`.
    camera : pixel centres at integer coordinates.
    world_from_camera : (4, 4) float64, in the unit of the model; None if it is not finite.
    """

    image_id: int
    name: str
    camera: Camera
    world_from_camera: Pose | None


def has_model(folder: Path) -> bool:
    """Return True if a folder holds a model: cameras and images."""
    return any(all((folder / f"{stem}{end}").is_file() for stem in _STEMS) for end in _FILE_SUFFIXES)


def read_model(folder: Path) -> list[ColmapImage]:
    """Read the images of a model with their cameras, in file order.

    Binary files are preferred to text files.

    Raises
    ------
    InputError
        If a file cannot be read, is truncated or damaged, or a camera model has no OpenCV equivalent.
    """
    end = next(
        (end for end in _FILE_SUFFIXES if all((folder / f"{stem}{end}").is_file() for stem in _STEMS)), None
    )
    if end is None:
        raise InputError(
            FILE_COLMAP_INVALID,
            "the cameras and images of a model (both .txt or both .bin) are required.",
            folder,
        )
    cameras_path, images_path = (folder / f"{stem}{end}" for stem in _STEMS)
    if end == ".bin":
        return list(_parse_binary_images(images_path, dict(_parse_binary_cameras(cameras_path))))
    return list(_parse_text_images(images_path, dict(_parse_text_cameras(cameras_path))))


def count_images(folder: Path) -> int:
    """Return the number of images in a model.

    Raises
    ------
    InputError
        As for `read_model`.
    """
    path = folder / "images.bin"
    if not (path.is_file() and (folder / "cameras.bin").is_file()):
        return len(read_model(folder))
    (count,), _ = _unpack_at("<Q", _map_file(path), 0, path)
    return int(count)


def read_points(folder: Path) -> dict[int, NDArray[np.float64]]:
    """Read the observed points of each image of a model.

    Returns
    -------
    dict
        By image ID, (n, 3) float64 points in the unit of the model. Empty if there is no points3D.bin or
        .txt, or it contains no points.

    Raises
    ------
    InputError
        If the file cannot be read, is truncated or damaged.
    """
    path = next(
        (folder / f"points3D{end}" for end in _FILE_SUFFIXES if (folder / f"points3D{end}").is_file()), None
    )
    if path is None:
        return {}
    points: list[tuple[float, ...]] = []
    images: list[NDArray[np.int64]] = []
    for point, seen_in in _parse_binary_points(path) if path.suffix == ".bin" else _parse_text_points(path):
        points.append(point)
        images.append(seen_in)
    if not points:
        return {}
    places = np.array(points, np.float64)
    image = np.concatenate(images)
    which = np.repeat(np.arange(len(points)), [len(seen_in) for seen_in in images])
    sound = np.asarray((np.abs(places) < _MAX_COORDINATE).all(axis=1))
    image, which = image[sound[which]], which[sound[which]]
    if not image.size:
        return {}
    order = np.argsort(image, kind="stable")
    names, starts = np.unique(image[order], return_index=True)
    return {
        int(name): places[part] for name, part in zip(names, np.split(which[order], starts[1:]), strict=True)
    }


def read_depth_map_size(path: Path) -> tuple[int, int]:
    """Return (width, height) of a depth map, from its header.

    Raises
    ------
    InputError
        If the file cannot be read, or its length does not match its header.
    """
    try:
        with open_input(path) as file:
            start = file.read(_DEPTH_HEADER_BYTES)
        size = path.stat().st_size
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "the depth map cannot be read ({strerror}).", path, strerror=error.strerror
        ) from error
    width, height, offset = _parse_depth_header(start, path)
    if size != offset + 4 * width * height:
        raise InputError(
            FILE_DAMAGED,
            "the file length does not match the stated {width}×{height} pixels",
            path,
            remedy="copy the file again.",
            width=width,
            height=height,
        )
    return width, height


def read_depth_map(path: Path) -> NDArray[np.float32]:
    """Read a depth map, (h, w) float32 in model units.

    Missing depth is 0.

    Raises
    ------
    InputError
        As for `read_depth_map_size`.
    """
    width, height = read_depth_map_size(path)
    try:
        data = read_input_bytes(path)
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "the depth map cannot be read ({strerror}).", path, strerror=error.strerror
        ) from error
    values = data[-4 * width * height :]
    if len(values) != 4 * width * height:
        raise InputError(MACHINE_BUSY, "the depth map was truncated while it was being read.", path)
    return np.frombuffer(values, "<f4").reshape(height, width).astype(np.float32)


def _parse_depth_header(start: bytes, path: Path) -> tuple[int, int, int]:
    """Parse a depth map header: width, height, and offset of the values."""
    header = _DEPTH_HEADER.match(start)
    if header is None:
        raise InputError(
            FILE_DEPTH_FORMAT, "a COLMAP depth map (`width&height&channels&`, then values) is expected.", path
        )
    width, height, channels = (int(digits) for digits in header.groups())
    if channels != 1 or not 0 < width * height <= MAX_PIXELS:
        raise InputError(
            FILE_DAMAGED,
            "the header is damaged: {width}×{height} pixels with {channels} channels.",
            path,
            width=width,
            height=height,
            channels=channels,
        )
    return width, height, header.end()


def _create_camera(
    model: _CameraModel, width: int, height: int, values: Sequence[float], camera_id: int, path: Path
) -> Camera:
    if model.intrinsic_indices is None:
        raise InputError(
            CAMERA_LENS_UNKNOWN,
            (
                "camera {identity} has the unsupported model {model_name}; undistort the images with "
                "COLMAP's image_undistorter and give its output folder."
            ),
            path,
            identity=camera_id,
            model_name=model.name,
        )
    if not 0 < width * height <= MAX_PIXELS:
        raise InputError(
            FILE_COLMAP_INVALID,
            "camera {identity} states an invalid size of {width}×{height} pixels.",
            path,
            identity=camera_id,
            width=width,
            height=height,
        )
    fx, fy, cx, cy = (values[at] for at in model.intrinsic_indices)
    distortion = tuple(0.0 if at is None else values[at] for at in model.distortion_indices)
    distortion = distortion if model.is_fisheye or any(distortion) else ()
    camera = check_camera_values(
        Camera(width, height, fx, fy, cx - 0.5, cy - 0.5, distortion, model.is_fisheye), path
    )
    return convert_fov_to_fisheye(camera, values[4], path) if model.name == "FOV" else camera


def _create_image(
    image_id: int,
    name: str,
    numbers: Sequence[float],
    camera: int,
    cameras: Mapping[int, Camera],
    path: Path,
) -> ColmapImage:
    """Create a view from a world-to-camera quaternion and translation.

    `numbers` are qw qx qy qz tx ty tz.
    """
    w, *rest = numbers
    if camera not in cameras:
        raise InputError(
            FILE_COLMAP_INVALID,
            "image {name} refers to camera {camera}, which does not exist.",
            path,
            name=name,
            camera=camera,
        )
    documents.require_inside(name, path, "an image")
    pose = create_pose_from_quaternion(rest[3:], [*rest[:3], w], path, f"image {name}")
    return ColmapImage(image_id, name, cameras[camera], None if pose is None else invert_pose(pose))


def _parse_text_cameras(path: Path) -> Iterator[tuple[int, Camera]]:
    """Yield cameras by ID from lines `id model width height parameters…`."""
    for number, text in documents.iterate_lines(path):
        words = text.split()
        model = next((one for one in _CAMERA_MODELS if one.name in words[1:2]), None)
        if model is None:
            raise InputError(
                FILE_TEXT_INVALID,
                "line {number} does not name a camera model of COLMAP (as in `id MODEL width height …`).",
                path,
                number=number,
            )
        try:
            identity, width, height = int(words[0]), int(words[2]), int(words[3])
            values = [float(word) for word in words[4:]]
        except (ValueError, IndexError) as error:
            raise InputError(
                FILE_TEXT_INVALID,
                "line {number} is not `id MODEL width height parameters…`.",
                path,
                number=number,
            ) from error
        if len(values) != model.parameter_count:
            raise InputError(
                FILE_TEXT_INVALID,
                "line {number}: {model_name} requires {model_count} parameters.",
                path,
                number=number,
                model_name=model.name,
                model_count=model.parameter_count,
            )
        yield identity, _create_camera(model, width, height, values, identity, path)


def _parse_text_images(path: Path, cameras: Mapping[int, Camera]) -> Iterator[ColmapImage]:
    """Yield the images of images.txt.

    Lines are `id qw qx qy qz tx ty tz camera name`.

    Each line is followed by a line of points, which is skipped.
    """
    after_image = False
    for number, line in enumerate(documents.read_text(path).splitlines(), 1):
        text = line.strip()
        # The line of points may be empty; some tools omit it.
        if after_image and (not text or _is_point_line(text)):
            after_image = False
            continue
        if not text or text.startswith("#"):
            continue
        words = text.split(maxsplit=9)
        try:
            identity, camera, name = int(words[0]), int(words[8]), words[9]
            numbers = [float(word) for word in words[1:8]]
        except (ValueError, IndexError) as error:
            raise InputError(
                FILE_TEXT_INVALID,
                "line {number} is not `id qw qx qy qz tx ty tz camera name`.",
                path,
                number=number,
            ) from error
        after_image = True
        yield _create_image(identity, name, numbers, camera, cameras, path)


def _is_point_line(text: str) -> bool:
    """Return True if a line repeats `x y point_id`."""
    words = text.split()
    return len(words) % 3 == 0 and all(re.fullmatch(r"[-+\d.eE]+|-?nan|-?inf", word) for word in words[-3:])


def _parse_binary_cameras(path: Path) -> Iterator[tuple[int, Camera]]:
    data = _map_file(path)
    (count,), at = _unpack_at("<Q", data, 0, path)
    for _ in range(count):
        (identity, number, width, height), at = _unpack_at("<IiQQ", data, at, path)
        if not 0 <= number < len(_CAMERA_MODELS):
            raise InputError(
                CAMERA_LENS_UNKNOWN,
                "camera {identity} has the unknown model {number}.",
                path,
                identity=identity,
                number=number,
            )
        model = _CAMERA_MODELS[number]
        values, at = _unpack_at(f"<{model.parameter_count}d", data, at, path)
        yield identity, _create_camera(model, width, height, values, identity, path)


def _parse_binary_images(path: Path, cameras: Mapping[int, Camera]) -> Iterator[ColmapImage]:
    data = _map_file(path)
    (count,), at = _unpack_at("<Q", data, 0, path)
    for _ in range(count):
        (identity, *numbers, camera), at = _unpack_at("<I7dI", data, at, path)
        end = data.find(b"\0", at, at + _MAX_NAME_BYTES)
        if end < 0:
            raise InputError(
                FILE_DAMAGED, "the file is truncated or damaged: an image name is not terminated.", path
            )
        try:
            name = data[at:end].decode()
        except UnicodeDecodeError as error:
            raise InputError(
                FILE_DAMAGED, "the file is damaged: an image name is not valid UTF-8.", path
            ) from error
        (points,), at = _unpack_at("<Q", data, end + 1, path)
        at += _POINT2D_BYTES * points
        if at > len(data):
            raise InputError(
                FILE_DAMAGED,
                "the file is truncated or damaged: points of image {name} are missing.",
                path,
                name=name,
            )
        yield _create_image(identity, name, numbers, camera, cameras, path)


def _parse_text_points(path: Path) -> Iterator[tuple[tuple[float, ...], NDArray[np.int64]]]:
    """Yield the points of points3D.txt, and the IDs of their images.

    Lines are `id x y z r g b error (image index)…`.
    """
    for number, text in documents.iterate_lines(path):
        words = text.split()
        try:
            point = tuple(float(word) for word in words[1:4])
            images = np.array([int(word) for word in words[8::2]], np.int64)
        except (ValueError, OverflowError):
            point, images = (), np.zeros(0, np.int64)
        if len(words) < 8 or len(words) % 2 or not point:
            raise InputError(
                FILE_TEXT_INVALID,
                "line {number} is not `id x y z r g b error (image index)…`.",
                path,
                number=number,
            )
        yield point, images


def _parse_binary_points(path: Path) -> Iterator[tuple[tuple[float, ...], NDArray[np.int64]]]:
    data = _map_file(path)
    (count,), at = _unpack_at("<Q", data, 0, path)
    for _ in range(count):
        (_, x, y, z, *_, seen), at = _unpack_at(_POINT_FORMAT, data, at, path)
        end = at + _TRACK_ELEMENT_BYTES * seen
        if end > len(data):
            raise InputError(
                FILE_DAMAGED, "the file is truncated or damaged", path, remedy="copy the file again."
            )
        yield (x, y, z), np.frombuffer(data[at:end], "<u4")[::2].astype(np.int64)
        at = end


def _map_file(path: Path) -> mmap.mmap | bytes:
    """Return the bytes of a file, memory-mapped.

    The point lists of large models are gigabytes, most of which are not read.
    """
    try:
        with open_input(path) as file:
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if path.stat().st_size else b""
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "the file cannot be read ({strerror}).", path, strerror=error.strerror
        ) from error


def _unpack_at(form: str, data: mmap.mmap | bytes, at: int, path: Path) -> tuple[tuple[Any, ...], int]:
    """Unpack values at an offset; returns the values and the next offset."""
    end = at + struct.calcsize(form)
    if end > len(data):
        raise InputError(
            FILE_DAMAGED, "the file is truncated or damaged", path, remedy="copy the file again."
        )
    return struct.unpack_from(form, data, at), end
