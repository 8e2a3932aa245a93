"""Reader of ScanNet `.sens` files: all frames of a scan, individually compressed.

The file is indexed without reading the images; images are read on demand. All numbers are
little-endian.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import MACHINE_BUSY
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_UNREADABLE, RECORDING_DAMAGED
from scanloom.stages.files.image_bytes import MAX_PIXELS
from scanloom.stages.files.images import decode_color
from scanloom.stages.files.input_files import open_input
from scanloom.stages.scans.codes import RECORDING_ENCODING_UNKNOWN, RECORDING_WRONG_KIND
from scanloom.stages.scans.model.scan import ColorImage

_FORMAT_VERSION = 4
_MAX_NAME_BYTES = 1 << 16
_MATRIX = struct.Struct("<16f")
_SETTINGS = struct.Struct("<iiIIIIfQ")
_FRAME = struct.Struct("<16fQQQQ")
_RAW_COLOR, _PNG_COLOR, _JPEG_COLOR = 0, 1, 2
_RAW_DEPTH, _ZLIB_DEPTH = 0, 1
# Depth units per metre, for units from 1 km down to 1 nm; other values are damaged.
_DEPTH_SCALE_RANGE = (1e-3, 1e9)
# Maximum bytes per pixel and fixed overhead of an encoded image; a larger blob is damaged.
_MAX_BYTES_PER_PIXEL, _MAX_OVERHEAD_BYTES = 8, 1 << 20


@dataclass(frozen=True)
class Blob:
    """Byte range of an image in the file."""

    start: int
    size: int


@dataclass(frozen=True, eq=False)
class SensFrame:
    """Index entry of one frame.

    Attributes
    ----------
    pose : (4, 4) float64 world-from-camera as stored; -inf if tracking was lost.
    color, depth : byte ranges of the images; a colour blob of size 0 means no image.
    """

    pose: NDArray[np.float64]
    color: Blob
    depth: Blob


@dataclass(frozen=True, eq=False)
class SensFile:
    """Header and frame index of a `.sens` file.

    Attributes
    ----------
    color_matrix, depth_matrix : (4, 4) float64 intrinsics, for images of `color_size` and `depth_size`.
    color_extrinsic, depth_extrinsic : (4, 4) float64; the identity in the data set.
    color_compression, depth_compression : compression of the images, by the numbers of the format.
    color_size, depth_size : (width, height), pixels.
    depth_scale : depth units per metre.
    stated_frame_count : frame count stated in the header; `frames` holds only the complete frames.
    """

    path: Path
    color_matrix: NDArray[np.float64]
    color_extrinsic: NDArray[np.float64]
    depth_matrix: NDArray[np.float64]
    depth_extrinsic: NDArray[np.float64]
    color_compression: int
    depth_compression: int
    color_size: tuple[int, int]
    depth_size: tuple[int, int]
    depth_scale: float
    stated_frame_count: int
    frames: Sequence[SensFrame]


def read_sens(path: Path) -> SensFile:
    """Read the header and the frame index of a `.sens` file.

    Frames after the first truncated or damaged frame cannot be located and are ignored.

    Raises
    ------
    InputError
        If the file cannot be read, its header is truncated or damaged, or its compression is unknown.
        Also if the file has no complete frame.
    """
    try:
        with open_input(path) as file:
            return _read_file(file, path.stat().st_size, path)
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "the file cannot be read ({strerror}).", path, strerror=error.strerror
        ) from error


def read_color(sens: SensFile, blob: Blob, name: str) -> ColorImage:
    """Read a colour image, (h, w, 3) uint8 RGB.

    Parameters
    ----------
    name : name of the image in messages.

    Raises
    ------
    InputError
        If the image cannot be read or does not decode.
    """
    data = _read_blob(sens.path, blob, name)
    if sens.color_compression != _RAW_COLOR:
        return decode_color(data, f"{sens.path}: {name}")
    width, height = sens.color_size
    if len(data) != 3 * width * height:
        raise InputError(
            RECORDING_DAMAGED,
            "the data does not match the image size {width}×{height} pixels.",
            f"{sens.path}: {name}",
            width=width,
            height=height,
        )
    return np.frombuffer(data, np.uint8).reshape(height, width, 3)


def read_depth(sens: SensFile, blob: Blob, name: str) -> NDArray[np.uint16]:
    """Read a depth map, (h, w) uint16 in the file's unit.

    Parameters
    ----------
    name : name of the image in messages.

    Raises
    ------
    InputError
        If the image cannot be read or does not decompress to the size stated in the header.
    """
    data = _read_blob(sens.path, blob, name)
    width, height = sens.depth_size
    size = 2 * width * height
    if sens.depth_compression == _ZLIB_DEPTH:
        try:
            # Request one byte more than expected to detect excess data, but no more: a blob of zeros could
            # fill the memory.
            data = zlib.decompressobj().decompress(data, size + 1)
        except zlib.error as error:
            raise InputError(
                RECORDING_DAMAGED,
                "the depth map does not decompress: the data is damaged.",
                f"{sens.path}: {name}",
            ) from error
    if len(data) != size:
        raise InputError(
            RECORDING_DAMAGED,
            "the data does not match the depth map size {width}×{height} pixels.",
            f"{sens.path}: {name}",
            width=width,
            height=height,
        )
    return np.frombuffer(data, "<u2").reshape(height, width).astype(np.uint16)


def _read_file(file: BinaryIO, file_size: int, path: Path) -> SensFile:
    version, name_size = struct.unpack("<IQ", _read_exactly(file, 12, path))
    if version != _FORMAT_VERSION:
        raise InputError(
            RECORDING_WRONG_KIND,
            "unsupported format version {version}; version {format_version} is expected.",
            path,
            format_version=_FORMAT_VERSION,
            version=version,
        )
    if name_size > _MAX_NAME_BYTES:
        raise InputError(
            RECORDING_DAMAGED,
            "the header is damaged: the sensor name has {name_size} bytes.",
            path,
            name_size=name_size,
        )
    _read_exactly(file, name_size, path)
    color_matrix, color_extrinsic, depth_matrix, depth_extrinsic = (
        _parse_matrix(_read_exactly(file, _MATRIX.size, path)) for _ in range(4)
    )
    settings = _SETTINGS.unpack(_read_exactly(file, _SETTINGS.size, path))
    color_coder, depth_coder, color_width, color_height, width, height, scale, promised = settings
    if color_coder not in (_RAW_COLOR, _PNG_COLOR, _JPEG_COLOR):
        raise InputError(
            RECORDING_ENCODING_UNKNOWN,
            "unknown colour compression {color_coder}; raw (0), PNG (1) and JPEG (2) are supported.",
            path,
            color_coder=color_coder,
        )
    if depth_coder not in (_RAW_DEPTH, _ZLIB_DEPTH):
        raise InputError(
            RECORDING_ENCODING_UNKNOWN,
            "unknown depth compression {depth_coder}; raw (0) and zlib (1) are supported.",
            path,
            depth_coder=depth_coder,
        )
    if color_width * color_height > MAX_PIXELS or not 0 < width * height <= MAX_PIXELS:
        raise InputError(
            RECORDING_DAMAGED,
            (
                "the header is damaged: invalid image sizes, colour {color_width}×{color_height} and "
                "depth {width}×{height} pixels."
            ),
            path,
            color_width=color_width,
            color_height=color_height,
            width=width,
            height=height,
        )
    if not _DEPTH_SCALE_RANGE[0] <= scale <= _DEPTH_SCALE_RANGE[1]:
        raise InputError(
            RECORDING_DAMAGED, "the header is damaged: {scale:g} depth units per metre.", path, scale=scale
        )
    limits = [
        _MAX_BYTES_PER_PIXEL * pixels + _MAX_OVERHEAD_BYTES
        for pixels in (color_width * color_height, width * height)
    ]
    frames = _read_frames(file, file_size, promised, limits)
    if not frames:
        raise InputError(
            RECORDING_DAMAGED,
            "none of the {promised} frames stated in the header is complete",
            path,
            remedy="copy the file again.",
            promised=promised,
        )
    return SensFile(
        path=path,
        color_matrix=color_matrix,
        color_extrinsic=color_extrinsic,
        depth_matrix=depth_matrix,
        depth_extrinsic=depth_extrinsic,
        color_compression=color_coder,
        depth_compression=depth_coder,
        color_size=(color_width, color_height),
        depth_size=(width, height),
        depth_scale=scale,
        stated_frame_count=promised,
        frames=frames,
    )


def _read_frames(file: BinaryIO, file_size: int, stated_count: int, limits: Sequence[int]) -> list[SensFrame]:
    """Index the complete frames, up to the first damaged one.

    `limits` are the maximum sizes of a colour and a depth image, bytes.
    """
    frames: list[SensFrame] = []
    while len(frames) < stated_count:
        header = file.read(_FRAME.size)
        if len(header) < _FRAME.size:
            break
        *_, color_size, depth_size = _FRAME.unpack(header)
        start = file.tell()
        end = start + color_size + depth_size
        if end > file_size or color_size > limits[0] or not 0 < depth_size <= limits[1]:
            break
        pose = _parse_matrix(header[: _MATRIX.size])
        frames.append(SensFrame(pose, Blob(start, color_size), Blob(start + color_size, depth_size)))
        file.seek(end)
    return frames


def _parse_matrix(data: bytes) -> NDArray[np.float64]:
    return np.array(_MATRIX.unpack(data)).reshape(4, 4)


def _read_exactly(file: BinaryIO, size: int, path: Path) -> bytes:
    data = file.read(size)
    if len(data) < size:
        raise InputError(
            RECORDING_DAMAGED, "the file is truncated within its header", path, remedy="copy the file again."
        )
    return data


def _read_blob(path: Path, blob: Blob, name: str) -> bytes:
    try:
        with open_input(path) as file:
            file.seek(blob.start)
            data = file.read(blob.size)
    except OSError as error:
        raise InputError(
            RECORDING_DAMAGED,
            "the image cannot be read ({strerror}).",
            f"{path}: {name}",
            strerror=error.strerror,
        ) from error
    if len(data) < blob.size:
        raise InputError(MACHINE_BUSY, "the file was truncated while it was being read.", f"{path}: {name}")
    return data
