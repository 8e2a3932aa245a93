"""Index a ROS 1 bag (format 2.0) and read single messages from it, in any order.

A bag is a row of records. Messages stand in chunks, each compressed for itself, and the index of a chunk
follows it; a recorder that was stopped in the middle leaves chunks and indexes, but not the summary at the
end which other readers start from. So the records are walked from the front, over the chunks without reading
them: whole and unfinished bags are read alike, and no number in a file makes the walk longer than the file.
"""

from __future__ import annotations

import bz2
import contextlib
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError

_MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _INDEX, _CHUNK, _CONNECTION = b"\x02", b"\x04", b"\x05", b"\x07"
_INDEX_ENTRY = np.dtype([("seconds", "<u4"), ("nanoseconds", "<u4"), ("offset", "<u4")])
# A record's header holds a few names and numbers, a connection the text of its message type.
_LONGEST_HEADER, _LONGEST_CONNECTION = 1 << 16, 1 << 20
# Recorders close a chunk at a megabyte or after one message; no camera makes a larger image.
_LARGEST_CHUNK = 1 << 28
# The most that the header of a message record takes, before its data.
_MESSAGE_HEADER = 256
_BROKEN = (struct.error, ValueError, KeyError, EOFError, RuntimeError)


@dataclass(frozen=True)
class Chunk:
    """Where the bytes of a chunk are, how they are compressed, and how many they are before that."""

    start: int
    stored: int
    compression: str
    size: int


@dataclass(frozen=True, eq=False)
class Topic:
    """The messages of a topic, in the order of the file.

    Attributes
    ----------
    kind : the message type, such as `sensor_msgs/Image`.
    connections : numbers the bag knows its writers by.
    times : (n,) int64 nanoseconds at which the messages were recorded.
    chunks : (n,) int64, which chunk of the bag each is in.
    offsets : (n,) int64, where in the chunk, in bytes.
    """

    kind: str
    connections: frozenset[int]
    times: NDArray[np.int64]
    chunks: NDArray[np.int64]
    offsets: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.times)


@dataclass(frozen=True, eq=False)
class RosBag:
    """The index of a bag.

    Attributes
    ----------
    topics : by name; each has messages.
    fault : why the records after some place could not be read, or None where the bag is whole.
    """

    path: Path
    topics: Mapping[str, Topic]
    chunks: tuple[Chunk, ...]
    fault: str | None


@dataclass(frozen=True)
class _Record:
    fields: Mapping[bytes, bytes]
    start: int
    size: int

    def number(self, name: bytes) -> int:
        return int.from_bytes(self.fields[name], "little")


def read_bag(path: Path) -> RosBag:
    """Read the index of a bag; what follows a damaged record is left out.

    Raises
    ------
    InputError
        If the file cannot be read or is no bag of format 2.0, or is encrypted.
    """
    try:
        with path.open("rb") as file:
            return _read(file, path.stat().st_size, path)
    except OSError as error:
        raise InputError(f"the file cannot be read ({error.strerror}).", path) from error


def read_message(bag: RosBag, topic: Topic, number: int, *, first: int | None = None) -> bytes:
    """Return the serialised bytes of a topic's n-th message, or only the `first` so many of them.

    Raises
    ------
    InputError
        If the file has changed, or the chunk is damaged or compressed in a way that is not known.
    """
    offset = int(topic.offsets[number])
    end = None if first is None else offset + _MESSAGE_HEADER + first
    chunk = bag.chunks[int(topic.chunks[number])]
    try:
        with bag.path.open("rb") as file:
            content = _content(file, chunk, bag.path, end)
        return _message(content, offset, topic.connections, first)
    except OSError as error:
        raise InputError(f"the file cannot be read ({error.strerror}).", bag.path) from error
    except _BROKEN as error:
        raise InputError("the chunk its message is in is damaged.", bag.path) from error


def _read(file: BinaryIO, file_size: int, path: Path) -> RosBag:
    start = file.read(len(_MAGIC))
    if start != _MAGIC:
        what = "a ROS bag of another version" if start.startswith(b"#ROSBAG") else "no ROS bag"
        raise InputError(f"this is {what}; it must begin with `#ROSBAG V2.0`.", path)
    chunks: list[Chunk] = []
    indexes: dict[int, list[tuple[int, NDArray[np.void]]]] = {}
    connections: dict[int, tuple[str, str]] = {}
    fault, at = None, file.tell()
    while at < file_size:
        try:
            record = _record(file, at, file_size)
            kind = record.fields[b"op"]
            if record.fields.get(b"encryptor"):
                raise InputError("the bag is encrypted, which cannot be read.", path)
            if kind == _CHUNK:
                compression = record.fields[b"compression"].decode("ascii")
                chunks.append(Chunk(record.start, record.size, compression, record.number(b"size")))
            elif kind == _INDEX and chunks:
                entries = np.frombuffer(_exactly(file, record.start, record.size), _INDEX_ENTRY)
                indexes.setdefault(record.number(b"conn"), []).append((len(chunks) - 1, entries))
            elif kind == _CONNECTION and record.size <= _LONGEST_CONNECTION:
                connections[record.number(b"conn")] = _connection(
                    record, _exactly(file, record.start, record.size)
                )
        except _BROKEN:
            fault = f"its record at byte {at} of {file_size} is damaged or cut short"
            break
        at = record.start + record.size
    _complete(connections, indexes, chunks, file, path)
    return RosBag(path, _topics(indexes, connections), tuple(chunks), fault)


def _complete(
    connections: dict[int, tuple[str, str]],
    indexes: Mapping[int, list[tuple[int, NDArray[np.void]]]],
    chunks: list[Chunk],
    file: BinaryIO,
    path: Path,
) -> None:
    """Add the connections that only chunks describe: a bag without an end lists none, but a chunk its own."""
    first = {parts[0][0] for number, parts in indexes.items() if number not in connections}
    for chunk in sorted(first):
        # Messages of a damaged chunk cannot be named, and so not be used; those of others can.
        with contextlib.suppress(*_BROKEN, InputError):
            content = _content(file, chunks[chunk], path, None)
            for record in _records(content):
                if record.fields[b"op"] == _CONNECTION:
                    described = _connection(record, content[record.start : record.start + record.size])
                    connections.setdefault(record.number(b"conn"), described)


def _topics(
    indexes: Mapping[int, list[tuple[int, NDArray[np.void]]]], connections: Mapping[int, tuple[str, str]]
) -> dict[str, Topic]:
    numbers: dict[tuple[str, str], list[int]] = {}
    for number, described in sorted(connections.items()):
        if number in indexes:
            numbers.setdefault(described, []).append(number)
    topics = {}
    for (name, kind), writers in numbers.items():
        parts = [part for number in writers for part in indexes[number]]
        entries = np.concatenate([entries for _, entries in parts])
        if not len(entries):
            continue
        chunks = np.repeat([chunk for chunk, _ in parts], [len(entries) for _, entries in parts])
        times = entries["seconds"].astype(np.int64) * 1_000_000_000 + entries["nanoseconds"]
        topics[name] = Topic(kind, frozenset(writers), times, chunks, entries["offset"].astype(np.int64))
    return topics


def _record(file: BinaryIO, at: int, file_size: int) -> _Record:
    """Return the record that starts at a byte of the file."""
    length = int.from_bytes(_exactly(file, at, 4), "little")
    if length > _LONGEST_HEADER:
        raise ValueError("header too long")
    block = _exactly(file, at + 4, length + 4)
    size = int.from_bytes(block[length:], "little")
    start = at + 8 + length
    if start + size > file_size:
        raise EOFError
    return _Record(_fields(block[:length]), start, size)


def _records(content: bytes) -> Iterator[_Record]:
    """Yield the records of a chunk."""
    at = 0
    while at < len(content):
        record = _record_in(content, at)
        yield record
        at = record.start + record.size


def _record_in(content: bytes, at: int) -> _Record:
    """Return the record that starts at a byte of a chunk; its data may be longer than what is there."""
    (length,) = struct.unpack_from("<I", content, at)
    if length > _LONGEST_HEADER or at + 8 + length > len(content):
        raise EOFError
    (size,) = struct.unpack_from("<I", content, at + 4 + length)
    return _Record(_fields(content[at + 4 : at + 4 + length]), at + 8 + length, size)


def _message(content: bytes, offset: int, connections: frozenset[int], first: int | None) -> bytes:
    """Return the data of the message record at an offset, or behind the connections that stand there."""
    record = _record_in(content, offset)
    while record.fields[b"op"] == _CONNECTION:
        record = _record_in(content, record.start + record.size)
    if record.fields[b"op"] != _MESSAGE or record.number(b"conn") not in connections:
        raise ValueError("another record is there")
    size = record.size if first is None else min(record.size, first)
    data = content[record.start : record.start + size]
    if len(data) < size:
        raise EOFError
    return data


def _fields(block: bytes) -> dict[bytes, bytes]:
    fields, at = {}, 0
    while at < len(block):
        (length,) = struct.unpack_from("<I", block, at)
        name, is_there, value = block[at + 4 : at + 4 + length].partition(b"=")
        at += 4 + length
        if not is_there or at > len(block):
            raise ValueError("not name=value")
        fields[name] = value
    return fields


def _connection(record: _Record, data: bytes) -> tuple[str, str]:
    """Return topic and message type."""
    return record.fields[b"topic"].decode(), _fields(data)[b"type"].decode()


def _content(file: BinaryIO, chunk: Chunk, path: Path, end: int | None) -> bytes:
    """Return the uncompressed bytes of a chunk, up to `end` if given; never more than the chunk states."""
    if chunk.size > _LARGEST_CHUNK:
        raise InputError(f"a chunk claims to hold {chunk.size} bytes; its header is damaged.", path)
    wanted = chunk.size if end is None else min(end, chunk.size)
    if chunk.compression == "none":
        return _exactly(file, chunk.start, min(wanted, chunk.stored))
    stored = _exactly(file, chunk.start, chunk.stored)
    if chunk.compression == "lz4":
        import lz4.frame

        content: bytes = lz4.frame.LZ4FrameDecompressor().decompress(stored, max_length=wanted)
    elif chunk.compression == "bz2":
        try:
            content = bz2.BZ2Decompressor().decompress(stored, max_length=wanted)
        except OSError as error:
            raise ValueError("damaged") from error
    else:
        known = "none, lz4 and bz2 are known"
        raise InputError(f"chunks are compressed as {chunk.compression[:20]!r}; {known}.", path)
    if len(content) < wanted:
        raise EOFError
    return content


def _exactly(file: BinaryIO, start: int, size: int) -> bytes:
    file.seek(start)
    data = file.read(size)
    if len(data) < size:
        raise EOFError
    return data
