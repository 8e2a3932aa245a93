"""Index an MCAP file and read single messages from it, in any order.

The file is a row of records: messages stand by themselves or in chunks, which are compressed each for itself
and followed by their index. As of ROS 1 bags the records are walked from the front, over the chunks without
reading them: a recording that was not closed lacks the summary other readers start from, and no number in a
file makes the walk longer than the file.

Reference: the MCAP format specification, version 0 (mcap.dev/spec).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError
from stages.files import zstd_blocks

_MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _INDEX = 2, 3, 4, 5, 6, 7
_INDEX_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])
# An operation code and a length stand before each record; a message begins with its channel and times.
_PREFIX, _HEAD = struct.Struct("<BQ"), struct.Struct("<HIQQ")
# What stands before the data of a chunk, and the text of a message type.
_LONGEST_CHUNK_HEAD, _LONGEST_DESCRIPTION = 1 << 10, 1 << 22
# Recorders close a chunk at some megabytes or after one message; no camera makes a larger image.
_LARGEST_CHUNK = _LARGEST_MESSAGE = 1 << 28
# The chunk of messages that stand in none.
_ALONE = -1
# Nanoseconds; later times, and offsets beyond it, are damaged.
_LATEST = 1 << 62
_BROKEN = (struct.error, ValueError, KeyError, EOFError, RuntimeError)


@dataclass(frozen=True)
class McapChunk:
    """Where the bytes of a chunk are, how they are compressed, and how many they are before that."""

    start: int
    stored: int
    compression: str
    size: int


@dataclass(frozen=True, eq=False)
class McapTopic:
    """The messages of a topic, in the order of the file.

    Attributes
    ----------
    kind : the message type, such as `sensor_msgs/msg/Image`.
    encoding : how messages are serialised: `cdr` (ROS 2), `ros1`, or another.
    channels : numbers the file knows its writers by.
    times : (n,) int64 nanoseconds at which the messages were recorded.
    chunks : (n,) int64, which chunk of the file each is in, -1 for none.
    offsets : (n,) int64, where in the chunk, or else in the file, in bytes.
    """

    kind: str
    encoding: str
    channels: frozenset[int]
    times: NDArray[np.int64]
    chunks: NDArray[np.int64]
    offsets: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Mcap:
    """The index of an MCAP file.

    Attributes
    ----------
    topics : by name; each has messages.
    fault : why the records after some place could not be read, or None where the file is whole.
    """

    path: Path
    topics: Mapping[str, McapTopic]
    chunks: tuple[McapChunk, ...]
    fault: str | None


@dataclass
class _Found:
    """What the walk has met.

    Attributes
    ----------
    schemas : the names of message types, by number.
    channels : schema, topic and encoding, by number.
    messages : time, chunk and offset of messages, by channel.
    indexed : chunks that an index followed.
    """

    schemas: dict[int, str] = field(default_factory=dict)
    channels: dict[int, tuple[int, str, str]] = field(default_factory=dict)
    messages: dict[int, list[NDArray[np.int64]]] = field(default_factory=dict)
    chunks: list[McapChunk] = field(default_factory=list)
    indexed: set[int] = field(default_factory=set)


def read_mcap(path: Path) -> Mcap:
    """Read the index of an MCAP file; what follows a damaged record is left out.

    Raises
    ------
    InputError
        If the file cannot be read or is none.
    """
    try:
        with path.open("rb") as file:
            return _read(file, path.stat().st_size, path)
    except OSError as error:
        raise InputError(f"the file cannot be read ({error.strerror}).", path) from error


def read_mcap_message(mcap: Mcap, topic: McapTopic, number: int, *, first: int | None = None) -> bytes:
    """Return the serialised bytes of a topic's n-th message, or only the `first` so many of them.

    Raises
    ------
    InputError
        If the file has changed, or the message is damaged or compressed in a way that is not known.
    """
    offset, chunk = int(topic.offsets[number]), int(topic.chunks[number])
    try:
        with mcap.path.open("rb") as file:
            if chunk == _ALONE:
                operation, length = _PREFIX.unpack(_exactly(file, offset, _PREFIX.size))
                length = min(length, _LARGEST_MESSAGE if first is None else _HEAD.size + first)
                content = _PREFIX.pack(operation, length) + _exactly(file, offset + _PREFIX.size, length)
                offset = 0
            else:
                end = None if first is None else offset + _PREFIX.size + _HEAD.size + first
                content = _content(file, mcap.chunks[chunk], mcap.path, end)
        data = _message(content, offset, topic.channels, first)
        if not data.startswith(zstd_blocks.MAGIC):
            return data
        # ROS 2 can pack message by message, too: the beginning of one is only had from all of it.
        if first is not None:
            return read_mcap_message(mcap, topic, number)[:first]
        return zstd_blocks.unpacked(data, _LARGEST_MESSAGE)
    except OSError as error:
        raise InputError(f"the file cannot be read ({error.strerror}).", mcap.path) from error
    except _BROKEN as error:
        raise InputError(f"message {number} of its topic is damaged.", mcap.path) from error


def _read(file: BinaryIO, file_size: int, path: Path) -> Mcap:
    if file.read(len(_MAGIC)) != _MAGIC:
        raise InputError("this is no MCAP file: it must begin with `MCAP0`.", path)
    found = _Found()
    fault, at, operation = None, len(_MAGIC), 0
    while at < file_size and operation != _FOOTER:
        try:
            operation, length = _PREFIX.unpack(_exactly(file, at, _PREFIX.size))
            start = at + _PREFIX.size
            if not operation or start + length > file_size:
                raise EOFError
            _note(found, operation, file, start, length)
        except _BROKEN:
            fault = f"its record at byte {at} of {file_size} is damaged or cut short"
            break
        at = start + length
    for number, chunk in enumerate(found.chunks):
        unknown = found.messages.keys() - found.channels.keys()
        if number not in found.indexed or _holds(found, number, unknown):
            try:
                _look_into(found, number, _content(file, chunk, path, None))
            except (*_BROKEN, InputError):
                fault = fault or f"its chunk at byte {chunk.start} of {file_size} is damaged"
    return Mcap(path, _topics(found), tuple(found.chunks), fault)


def _note(found: _Found, operation: int, file: BinaryIO, start: int, length: int) -> None:
    """Note what a record of the file says."""
    if operation in (_SCHEMA, _CHANNEL) and length <= _LONGEST_DESCRIPTION:
        _describe(found, operation, _exactly(file, start, length))
    elif operation == _MESSAGE:
        channel, _, time, _ = _HEAD.unpack(_exactly(file, start, _HEAD.size))
        _add(found, channel, [(min(time, _LATEST), _ALONE, start - _PREFIX.size)])
    elif operation == _CHUNK:
        head = _exactly(file, start, min(length, _LONGEST_CHUNK_HEAD))
        _, _, size, _ = struct.unpack_from("<QQQI", head)
        compression, at = _text(head, 28)
        (stored,) = struct.unpack_from("<Q", head, at)
        if at + 8 + stored > length:
            raise EOFError
        found.chunks.append(McapChunk(start + at + 8, stored, compression, size))
    elif operation == _INDEX and found.chunks:
        channel, size = struct.unpack("<HI", _exactly(file, start, 6))
        if 6 + size > length:
            raise EOFError
        entries = np.frombuffer(_exactly(file, start + 6, size), _INDEX_ENTRY)
        at = len(found.chunks) - 1
        found.indexed.add(at)
        times, offsets = (np.minimum(entries[name], _LATEST).astype(np.int64) for name in ("time", "offset"))
        if len(entries):
            _add(found, channel, np.stack([times, np.full(len(entries), at), offsets], axis=1))


def _describe(found: _Found, operation: int, body: bytes) -> None:
    """Note a message type or a channel."""
    (number,) = struct.unpack_from("<H", body)
    if operation == _SCHEMA:
        found.schemas[number] = _text(body, 2)[0]
    else:
        (schema,) = struct.unpack_from("<H", body, 2)
        topic, at = _text(body, 4)
        found.channels[number] = schema, topic, _text(body, at)[0]


def _add(found: _Found, channel: int, messages: object) -> None:
    found.messages.setdefault(channel, []).append(np.array(messages, np.int64))


def _holds(found: _Found, chunk: int, channels: set[int]) -> bool:
    """Say whether a chunk is the first with messages of one of these channels, which it has to describe."""
    return any(found.messages[one][0][0, 1] == chunk for one in channels)


def _look_into(found: _Found, number: int, content: bytes) -> None:
    """Note what the records of a chunk say: channels, and its messages if no index follows."""
    for operation, start, length in _records(content):
        if operation in (_SCHEMA, _CHANNEL):
            _describe(found, operation, content[start : start + length])
        elif operation == _MESSAGE and number not in found.indexed:
            channel, _, time, _ = _HEAD.unpack_from(content, start)
            _add(found, channel, [(min(time, _LATEST), number, start - _PREFIX.size)])


def _records(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield operation, start and length of the records of a chunk."""
    at = 0
    while at < len(content):
        operation, length = _PREFIX.unpack_from(content, at)
        if not operation or at + _PREFIX.size + length > len(content):
            raise EOFError
        yield operation, at + _PREFIX.size, length
        at += _PREFIX.size + length


def _topics(found: _Found) -> dict[str, McapTopic]:
    writers: dict[tuple[str, str, str], list[int]] = {}
    for number, (schema, topic, encoding) in sorted(found.channels.items()):
        if number in found.messages:
            writers.setdefault((topic, found.schemas.get(schema, ""), encoding), []).append(number)
    topics = {}
    for (topic, kind, encoding), numbers in writers.items():
        entries = np.concatenate([part for number in numbers for part in found.messages[number]])
        topics[topic] = McapTopic(kind, encoding, frozenset(numbers), *np.ascontiguousarray(entries.T))
    return topics


def _message(content: bytes, offset: int, channels: frozenset[int], first: int | None) -> bytes:
    """Return the data of the message record at an offset."""
    operation, length = _PREFIX.unpack_from(content, offset)
    start = offset + _PREFIX.size
    channel = _HEAD.unpack_from(content, start)[0]
    if operation != _MESSAGE or channel not in channels or length < _HEAD.size:
        raise ValueError("another record is there")
    size = length - _HEAD.size if first is None else min(length - _HEAD.size, first)
    data = content[start + _HEAD.size : start + _HEAD.size + size]
    if len(data) < size:
        raise EOFError
    return data


def _content(file: BinaryIO, chunk: McapChunk, path: Path, end: int | None) -> bytes:
    """Return the uncompressed bytes of a chunk, up to `end` if given; never more than the chunk states."""
    if chunk.size > _LARGEST_CHUNK:
        raise InputError(f"a chunk claims to hold {chunk.size} bytes; its header is damaged.", path)
    wanted = chunk.size if end is None else min(end, chunk.size)
    if not chunk.compression:
        return _exactly(file, chunk.start, min(wanted, chunk.stored))
    stored = _exactly(file, chunk.start, chunk.stored)
    if chunk.compression == "zstd":
        content = zstd_blocks.unpacked(stored, wanted)
    elif chunk.compression == "lz4":
        import lz4.frame

        content = lz4.frame.LZ4FrameDecompressor().decompress(stored, max_length=wanted)
    else:
        raise InputError(
            f"chunks are compressed as {chunk.compression[:20]!r}; zstd and lz4 are known.", path
        )
    if len(content) < wanted:
        raise EOFError
    return content


def _text(data: bytes, at: int) -> tuple[str, int]:
    """Return the text at a place, and the place behind it."""
    (length,) = struct.unpack_from("<I", data, at)
    end = at + 4 + length
    if end > len(data):
        raise EOFError
    return data[at + 4 : end].decode("utf-8", "replace"), end


def _exactly(file: BinaryIO, start: int, size: int) -> bytes:
    file.seek(start)
    data = file.read(size)
    if len(data) < size:
        raise EOFError
    return data
