"""Reader of ROS 1 bags (format 2.0), including RealSense `.bag` files.

A record consists of a header of `name=value` fields, and data. Messages are stored in chunks, and each
chunk is followed by its index.

Reference: https://wiki.ros.org/Bags/Format/2.0
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import RECORDING_WRONG_KIND
from scanloom.stages.scans.recordings.chunked import (
    FILE_CHUNK,
    ByteSpan,
    Chunk,
    Connection,
    RecordIndex,
    open_span,
    read_chunked_recording,
)
from scanloom.stages.scans.recordings.recording import Recording

_MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _INDEX, _CHUNK, _CONNECTION = b"\x02", b"\x04", b"\x05", b"\x07"
_INDEX_ENTRY = np.dtype([("seconds", "<u4"), ("nanoseconds", "<u4"), ("offset", "<u4")])
# Maximum bytes. A header holds a few names and numbers; a connection record also holds the message
# definition.
_MAX_HEADER_BYTES, _MAX_CONNECTION_BYTES = 1 << 16, 1 << 20


class _Record(NamedTuple):
    fields: Mapping[bytes, bytes]
    start: int
    size: int

    @property
    def end(self) -> int:
        return self.start + self.size

    def read_number(self, name: bytes) -> int:
        return int.from_bytes(self.fields[name], "little")


def read_bag(path: Path) -> Recording:
    """Index a ROS 1 bag. Records after a damaged one are ignored.

    Raises
    ------
    InputError
        If the file cannot be read, is not a bag of format 2.0, or is encrypted.
    """
    with open_span(path) as file:
        start = file.read(0, min(len(_MAGIC), file.size))
        if start != _MAGIC:
            what = "a ROS bag of another version" if start.startswith(b"#ROSBAG") else "not a ROS bag"
            raise InputError(
                RECORDING_WRONG_KIND,
                "this is {what}; the file must begin with `#ROSBAG V2.0`.",
                path,
                what=what,
            )
        return read_chunked_recording(path, file, len(_MAGIC), _index_record, _locate_message)


def _index_record(found: RecordIndex, chunk: int, span: ByteSpan, at: int) -> int:
    record = _read_record(span, at)
    kind = record.fields[b"op"]
    if record.fields.get(b"encryptor"):
        raise InputError(
            RECORDING_WRONG_KIND, "the bag is encrypted; encrypted bags are not supported.", found.path
        )
    if kind == _CONNECTION and record.size <= _MAX_CONNECTION_BYTES:
        described = _parse_fields(span.read(record.start, record.size))
        writer = Connection(record.fields[b"topic"].decode(), described[b"type"].decode(), is_cdr=False)
        found.connections.setdefault(record.read_number(b"conn"), writer)
    elif kind == _CHUNK and chunk == FILE_CHUNK:
        compression = record.fields[b"compression"].decode("ascii")
        packed = "" if compression == "none" else compression
        found.chunks.append(Chunk(record.start, record.size, packed, record.read_number(b"size")))
    elif kind == _INDEX and chunk == FILE_CHUNK and len(found.chunks) > 1:
        entries = np.frombuffer(span.read(record.start, record.size), _INDEX_ENTRY)
        times = entries["seconds"].astype(np.int64) * 1_000_000_000 + entries["nanoseconds"]
        indexed = len(found.chunks) - 1
        found.indexed_chunks.add(indexed)
        found.add_messages(record.read_number(b"conn"), times, indexed, entries["offset"])
    return record.end


def _locate_message(span: ByteSpan, at: int, writers: frozenset[int]) -> tuple[int, int]:
    record = _read_record(span, at)
    # Index entries may point to the connection record that precedes the first message of a connection.
    while record.fields[b"op"] == _CONNECTION:
        record = _read_record(span, record.end)
    if record.fields[b"op"] != _MESSAGE or record.read_number(b"conn") not in writers:
        raise ValueError("unexpected record type")
    return record.start, record.size


def _read_record(span: ByteSpan, at: int) -> _Record:
    length = int.from_bytes(span.read(at, 4), "little")
    if length > _MAX_HEADER_BYTES:
        raise ValueError("header too long")
    block = span.read(at + 4, length + 4)
    record = _Record(_parse_fields(block[:length]), at + 8 + length, int.from_bytes(block[length:], "little"))
    if record.end > span.size:
        raise EOFError
    return record


def _parse_fields(block: bytes) -> dict[bytes, bytes]:
    fields, at = {}, 0
    while at < len(block):
        start = at + 4
        at = start + int.from_bytes(block[at:start], "little")
        name, is_there, value = block[start:at].partition(b"=")
        if not is_there or at > len(block):
            raise ValueError("not name=value")
        fields[name] = value
    return fields
