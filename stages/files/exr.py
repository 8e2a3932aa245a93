"""Depth from OpenEXR files, as phones and renderers write it.

The header is parsed and validated here, before the OpenEXR library allocates memory for the image.
"""

from __future__ import annotations

import contextlib
import struct
import sys
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_DAMAGED, FILE_DEPTH_FORMAT, FILE_IMAGE_FORMAT, FILE_UNREADABLE
from scanloom.stages.files.image_bytes import MAX_PIXELS
from scanloom.stages.files.input_files import describe_os_error, open_input, read_input_bytes
from scanloom.stages.files.memory_check import check_memory_available

_MAX_HEADER_BYTES = 1 << 19
_EXR_MAGIC = b"v/1\x01"
# Version flags that are not supported: tiles, deep pixels, multiple parts.
_UNSUPPORTED_FLAGS = 0x200 | 0x800 | 0x1000
# Scan lines per chunk, by compression: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB.
_ROWS_PER_CHUNK = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256)
# Bytes per number: 32-bit values, held once by the decoder and once in the result.
_BYTES_PER_NUMBER = 8
# Channel names of depth, most specific first. A single channel may have any name.
_DEPTH_CHANNEL_NAMES = ("Z", "Depth.Z", "depth.Z", "depth", "Depth", "D", "Y", "V")
# The library reports errors with print(); redirecting stdout affects all threads.
_stdout_lock = threading.Lock()


@dataclass(frozen=True)
class _ExrHeader:
    """OpenEXR header; `chunk_table_offset` is the byte offset of the chunk table."""

    width: int
    height: int
    channels: int
    compression: int
    chunk_table_offset: int


def read_exr_size(path: Path) -> tuple[int, int]:
    """Read the (width, height) of an OpenEXR file from its header, pixels.

    Raises
    ------
    InputError
        If the file is missing, or its header is damaged.
    """
    try:
        with open_input(path) as file:
            header = _parse_header(file.read(_MAX_HEADER_BYTES), path)
    except (OSError, ValueError) as error:
        raise InputError(
            FILE_UNREADABLE, "the image cannot be opened ({reason}).", path, reason=describe_os_error(error)
        ) from error
    return header.width, header.height


def read_exr(path: Path) -> NDArray[Any]:
    """Read the depth channel of an OpenEXR file.

    Returns
    -------
    (h, w) float16, float32 or uint32, in the unit of the file.

    Raises
    ------
    InputError
        If the file is missing, damaged or cut short, or if its depth channel is ambiguous.
    """
    import OpenEXR

    try:
        data = read_input_bytes(path)
    except (OSError, ValueError) as error:
        raise InputError(
            FILE_UNREADABLE, "the image cannot be opened ({reason}).", path, reason=describe_os_error(error)
        ) from error
    header = _parse_header(data, path)
    if _has_truncated_chunk(data, header):
        raise InputError(
            FILE_DAMAGED, "the image is cut short", path, remedy="copy it again or leave the frame out."
        )
    try:
        with _stdout_lock, contextlib.redirect_stdout(sys.stderr):
            file = OpenEXR.File(str(path), separate_channels=True)
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    except (RuntimeError, ValueError, IndexError, MemoryError) as error:
        check_memory_available(_BYTES_PER_NUMBER * header.width * header.height * header.channels)
        raise InputError(FILE_DAMAGED, "the image does not decode; it is damaged.", path) from error
    depth = _select_depth(channels)
    if depth is None:
        names = ", ".join(sorted(channels))[:80]
        raise InputError(
            FILE_DEPTH_FORMAT,
            "the depth channel is ambiguous: the image has the channels {names}.",
            path,
            remedy="Write a single channel named Z.",
            names=names,
        )
    return depth


def _select_depth(channels: Mapping[str, NDArray[Any]]) -> NDArray[Any] | None:
    name = next((name for name in _DEPTH_CHANNEL_NAMES if name in channels), None)
    if len(channels) == 1 or name is not None:
        return channels[name or next(iter(channels))]
    colors = [channels[name] for name in "RGB" if name in channels]
    # Some exporters save depth as a grey RGB image.
    if len(colors) == 3 and all(colors[0].tobytes() == other.tobytes() for other in colors[1:]):
        return colors[0]
    return None


def _parse_header(data: bytes, path: Path) -> _ExrHeader:
    """Parse the header and check that its image size is plausible.

    Raises
    ------
    InputError
        If the header is damaged, or the file has tiles, several parts, deep pixels or unknown compression.
    """
    if data[:4] != _EXR_MAGIC or len(data) < 8:
        raise InputError(FILE_DAMAGED, "this is not an OpenEXR image, or its header is damaged.", path)
    if int.from_bytes(data[4:8], "little") & _UNSUPPORTED_FLAGS:
        raise InputError(
            FILE_IMAGE_FORMAT,
            "OpenEXR files with tiles, several parts or deep pixels are not supported",
            path,
            remedy="write a single part with scan lines.",
        )
    try:
        attributes, end = _parse_attributes(data)
        left, top, right, bottom = struct.unpack("<4i", attributes[b"dataWindow"])
        channels = _count_channels(attributes[b"channels"])
        compression = attributes[b"compression"][0]
    except (KeyError, ValueError, IndexError, struct.error) as error:
        raise InputError(FILE_DAMAGED, "the header of the image is damaged.", path) from error
    if compression >= len(_ROWS_PER_CHUNK):
        raise InputError(
            FILE_IMAGE_FORMAT,
            "its compression method is not supported",
            path,
            remedy="write it with ZIP compression.",
        )
    width, height = right - left + 1, bottom - top + 1
    if not (width > 0 and height > 0 and channels > 0 and width * height * channels <= MAX_PIXELS):
        raise InputError(
            FILE_DAMAGED,
            "its header is damaged: it states {width}×{height} pixels of {channels} channels.",
            path,
            width=width,
            height=height,
            channels=channels,
        )
    return _ExrHeader(width, height, channels, compression, end)


def _parse_attributes(data: bytes) -> tuple[dict[bytes, bytes], int]:
    """Parse the header attributes.

    Returns them by name, and the offset behind the header.

    Raises
    ------
    ValueError, IndexError
        If the header is cut short.
    """
    attributes: dict[bytes, bytes] = {}
    offset = 8
    while data[offset] != 0:
        name_end = data.index(0, offset)
        type_end = data.index(0, name_end + 1)
        size = int.from_bytes(data[type_end + 1 : type_end + 5], "little")
        start = type_end + 5
        if start + size >= len(data):
            raise ValueError("an attribute extends beyond the file")
        attributes[data[offset:name_end]] = data[start : start + size]
        offset = start + size
    return attributes, offset + 1


def _count_channels(table: bytes) -> int:
    """Count the channels of a `chlist` attribute.

    Each entry is a null-terminated name and 16 bytes of description.
    """
    count = at = 0
    while table[at] != 0:
        at = table.index(0, at) + 17
        count += 1
    return count


def _has_truncated_chunk(data: bytes, header: _ExrHeader) -> bool:
    """Return True if a chunk of the chunk table extends beyond the file."""
    count = -(-header.height // _ROWS_PER_CHUNK[header.compression])
    if header.chunk_table_offset + 8 * count > len(data):
        return True
    for (offset,) in struct.iter_unpack(
        "<Q", data[header.chunk_table_offset : header.chunk_table_offset + 8 * count]
    ):
        size = int.from_bytes(data[offset + 4 : offset + 8], "little")
        if offset < header.chunk_table_offset or offset + 8 + size > len(data):
            return True
    return False
