"""Reader of MCAP files, as ROS 2 writes them.

A record consists of an opcode, a length and a body. Messages are stored directly in the file or in
chunks, and each chunk is followed by its index.

Reference: the MCAP format specification, version 0 (mcap.dev/spec).
"""

from __future__ import annotations

import struct
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import zstd_blocks
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
from scanloom.stages.scans.recordings.recording import (
    Recording,
    TopicMessages,
    decompress_message,
    to_ros_1_type,
)

_MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _INDEX = 2, 3, 4, 5, 6, 7
_INDEX_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])
# Record prefix: opcode and length. Message head: channel, sequence number, log time and publish time.
_PREFIX, _MESSAGE_HEAD = struct.Struct("<BQ"), struct.Struct("<HIQQ")
# Maximum bytes of a chunk record before its data, and of a message type definition.
_MAX_CHUNK_HEAD_BYTES, _MAX_DESCRIPTION_BYTES = 1 << 10, 1 << 22
# Encodings of ROS messages; True for CDR, the encoding of ROS 2.
_ENCODINGS = {"cdr": True, "ros1": False}
# Nanoseconds. Later times are damaged; the limit also clamps damaged offsets into int64.
_MAX_TIME_NS = 1 << 62


def read_mcap(path: Path) -> Recording:
    """Index an MCAP file. Records after a damaged one are ignored.

    Messages in encodings unknown to ROS get a type name that no reader recognises.

    Raises
    ------
    InputError
        If the file cannot be read or is not an MCAP file.
    """
    with open_span(path) as file:
        if file.read(0, min(len(_MAGIC), file.size)) != _MAGIC:
            raise InputError(
                RECORDING_WRONG_KIND, "this is not an MCAP file: the file must begin with `MCAP0`.", path
            )
        recording = read_chunked_recording(
            path, file, len(_MAGIC), partial(_index_record, {0: ""}), _locate_message
        )
    topics = {
        name: replace(topic, read=partial(_read_decompressed, path, topic)) if topic.is_cdr else topic
        for name, topic in recording.topics.items()
    }
    return replace(recording, topics=topics)


def _read_decompressed(path: Path, messages: TopicMessages, number: int, byte_count: int | None) -> bytes:
    data = messages.read(number, byte_count)
    if byte_count is not None and data.startswith(zstd_blocks.ZSTD_MAGIC):
        # The beginning of a compressed message requires the whole message.
        data = messages.read(number, None)
    return decompress_message(data, f"message {number} of its topic", path)[:byte_count]


def _index_record(schemas: dict[int, str], found: RecordIndex, chunk: int, span: ByteSpan, at: int) -> int:
    operation, start, length = _read_record(span, at)
    if operation in (_SCHEMA, _CHANNEL) and length <= _MAX_DESCRIPTION_BYTES:
        _index_description(schemas, found, operation, span.read(start, length))
    elif operation == _MESSAGE and chunk not in found.indexed_chunks:
        writer, _, time, _ = _MESSAGE_HEAD.unpack(span.read(start, _MESSAGE_HEAD.size))
        found.add_messages(writer, min(time, _MAX_TIME_NS), chunk, at)
    elif operation == _CHUNK and chunk == FILE_CHUNK:
        head = span.read(start, min(length, _MAX_CHUNK_HEAD_BYTES))
        _, _, size, _ = struct.unpack_from("<QQQI", head)
        compression, behind = _read_string(head, 28)
        (stored,) = struct.unpack_from("<Q", head, behind)
        if behind + 8 + stored > length:
            raise EOFError
        found.chunks.append(Chunk(start + behind + 8, stored, compression, size))
    elif operation == _INDEX and chunk == FILE_CHUNK and len(found.chunks) > 1:
        writer, size = struct.unpack("<HI", span.read(start, 6))
        if 6 + size > length:
            raise EOFError
        entries = np.frombuffer(span.read(start + 6, size), _INDEX_ENTRY)
        indexed = len(found.chunks) - 1
        found.indexed_chunks.add(indexed)
        times, offsets = (
            np.minimum(entries[name], _MAX_TIME_NS).astype(np.int64) for name in ("time", "offset")
        )
        found.add_messages(writer, times, indexed, offsets)
    return span.size if operation == _FOOTER else start + length


def _index_description(schemas: dict[int, str], found: RecordIndex, operation: int, body: bytes) -> None:
    """Record a message type, or a channel whose type is known.

    Channels before their type are ignored: chunks repeat both.
    """
    (number,) = struct.unpack_from("<H", body)
    if operation == _SCHEMA:
        schemas.setdefault(number, to_ros_1_type(_read_string(body, 2)[0]))
        return
    (schema,) = struct.unpack_from("<H", body, 2)
    topic, at = _read_string(body, 4)
    encoding, _ = _read_string(body, at)
    if schema in schemas:
        kind = schemas[schema] if encoding in _ENCODINGS else f"{schemas[schema]} as {encoding}"
        found.connections.setdefault(number, Connection(topic, kind, _ENCODINGS.get(encoding, False)))


def _locate_message(span: ByteSpan, at: int, writers: frozenset[int]) -> tuple[int, int]:
    operation, start, length = _read_record(span, at)
    writer = _MESSAGE_HEAD.unpack(span.read(start, _MESSAGE_HEAD.size))[0]
    if operation != _MESSAGE or writer not in writers or length < _MESSAGE_HEAD.size:
        raise ValueError("unexpected record type")
    return start + _MESSAGE_HEAD.size, length - _MESSAGE_HEAD.size


def _read_record(span: ByteSpan, at: int) -> tuple[int, int, int]:
    """Return opcode, body start and body length of a record."""
    operation, length = _PREFIX.unpack(span.read(at, _PREFIX.size))
    start = at + _PREFIX.size
    if not operation or start + length > span.size:
        raise EOFError
    return operation, start, length


def _read_string(data: bytes, at: int) -> tuple[str, int]:
    """Read a length-prefixed string; returns the text and the offset after it."""
    (length,) = struct.unpack_from("<I", data, at)
    end = at + 4 + length
    if end > len(data):
        raise EOFError
    return data[at + 4 : end].decode("utf-8", "replace"), end
