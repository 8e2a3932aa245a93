"""Common reader of chunked recordings: ROS 1 bags and MCAP files.

Both formats are sequences of records; messages are stored in separately compressed chunks. An
interrupted recorder leaves chunks and their indexes, but not the summary at the end, which other
readers require. This reader therefore walks the records from the front and skips over chunk contents.
Finished and unfinished files are read in the same way. No value in a file can make the walk longer than
the file.

Reasons against `rosbags` (0.11.9) and `mcap` (1.6.0), which assume finished files:

- Truncated files: of 12,000 bags and MCAP files cut at a random position, `rosbags` reads no message
  and `mcap` none by its index; this reader recovers 43 % of all messages. (`mcap` in streaming mode
  recovers slightly more, but reads the whole file.)
- Corrupted files: of 24,000 files with changed bytes or lengths, `rosbags` fails on 4,758 with foreign
  errors such as KeyError and MemoryError; `mcap` fails so on 3,043 of 12,000.
- Decompression bombs: both decompress a chunk without a limit. A chunk of 33 KB that states 100 bytes
  becomes 2.1 GB and 1.1 GB. Both trust stated lengths: a record of 3 GiB in a file of 4 GiB is read
  whole.
- Access: messages are found by time and not by index, through one open file that threads cannot share.
  `rosbags` refuses MCAP files with ROS 1 messages, or with unordered messages outside of chunks.
"""

from __future__ import annotations

import bz2
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import opening, zstd_blocks
from scanloom.stages.files.codes import FILE_UNREADABLE, RECORDING_DAMAGED
from scanloom.stages.scans.codes import RECORDING_ENCODING_UNKNOWN
from scanloom.stages.scans.recordings.recording import LARGEST_MESSAGE, Messages, Recording

# Exceptions that parsing a damaged record raises.
_BROKEN = (struct.error, ValueError, KeyError, EOFError, RuntimeError)
# Maximum bytes of a chunk. Recorders close a chunk after some megabytes or one message; no camera image is
# larger.
_LARGEST_CHUNK = 1 << 28
# Maximum bytes of a message record before its data.
_LONGEST_HEAD = 256
# Chunk index of the file itself.
FILE = 0


class Writer(NamedTuple):
    """Properties common to all messages of one connection or channel.

    Topic, message type, and serialisation.
    """

    topic: str
    kind: str
    is_cdr: bool


class Chunk(NamedTuple):
    """Location, compression ("" for uncompressed) and uncompressed size of a chunk, in bytes."""

    start: int
    stored: int
    compression: str
    size: int


@dataclass(frozen=True, eq=False)
class Span:
    """Byte range of a file or a decompressed chunk.

    Offsets are relative to its start.

    `size` is the full size; the end of a chunk may not have been decompressed.
    """

    file: BinaryIO
    start: int
    size: int

    def read(self, at: int, size: int) -> bytes:
        """Read exactly `size` bytes at an offset.

        Raises EOFError if there are fewer.
        """
        if size > self.size - at:
            raise EOFError
        self.file.seek(self.start + at)
        data = self.file.read(size)
        if len(data) < size:
            raise EOFError
        return data


@dataclass(frozen=True, eq=False)
class Found:
    """Index built by walking the records of a file.

    Attributes
    ----------
    chunks : chunks of the file; the first is the file itself.
    writers : connections or channels, by their number in the file.
    messages : by writer number, (n, 3) int64 arrays of recording time (ns), chunk index and offset in the
        chunk.
    indexed : indices of the chunks that are followed by an index.
    """

    path: Path
    chunks: list[Chunk]
    writers: dict[int, Writer] = field(default_factory=dict)
    messages: dict[int, list[NDArray[np.int64]]] = field(default_factory=dict)
    indexed: set[int] = field(default_factory=set)

    def add(self, writer: int, times: ArrayLike, chunk: int, offsets: ArrayLike) -> None:
        """Add messages of a chunk, by recording time (ns) and offset."""
        entries = np.stack(np.broadcast_arrays(times, chunk, offsets), axis=-1).reshape(-1, 3)
        if len(entries):
            self.messages.setdefault(writer, []).append(entries.astype(np.int64))


# Adds the record at an offset of a chunk to the index, and returns the offset of the next record.
Note = Callable[[Found, int, Span, int], int]
# Returns start and length of the data of the message at an offset; raises ValueError if the record is not a
# message of one of these writers.
Find = Callable[[Span, int, frozenset[int]], tuple[int, int]]


@contextmanager
def opened(path: Path) -> Iterator[Span]:
    """Open a file for reading as a span.

    Raises
    ------
    InputError
        If opening fails, or a read inside the context fails with OSError.
    """
    try:
        with opening.opened(path) as file:
            yield Span(file, 0, path.stat().st_size)
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "the file cannot be read ({strerror}).", path, strerror=error.strerror
        ) from error


def read_chunked(path: Path, file: Span, start: int, note: Note, find: Find) -> Recording:
    """Index a chunked recording. Records after a damaged one are ignored.

    Parameters
    ----------
    start : offset of the first record, bytes.
    note, find : format-specific record parsers.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    found = Found(path, [Chunk(0, file.size, "", file.size)])
    broken = _walk(note, found, FILE, file, start)
    fault = None if broken is None else f"the record at byte {broken} of {file.size} is damaged or truncated"
    for number, chunk in enumerate(found.chunks[1:], 1):
        # Unfinished files describe their connections only inside chunks, in the first chunk of each
        # connection.
        if number not in found.indexed or _is_first_of_unknown(found, number):
            try:
                broken = _walk(note, found, number, _unpacked(file, chunk, path, None), 0)
            except (*_BROKEN, InputError):
                broken = 0
            if broken is not None:
                fault = fault or f"the chunk at byte {chunk.start} of {file.size} is damaged"
    return Recording(path, _topics(found, find), fault)


def _walk(note: Note, found: Found, chunk: int, span: Span, at: int) -> int | None:
    """Index all records of a span.

    Returns the offset of a damaged record, or None.
    """
    try:
        while at < span.size:
            at = note(found, chunk, span, at)
    except _BROKEN:
        return at
    return None


def _is_first_of_unknown(found: Found, chunk: int) -> bool:
    unknown = found.messages.keys() - found.writers.keys()
    return any(found.messages[writer][0][0, 1] == chunk for writer in unknown)


def _topics(found: Found, find: Find) -> Mapping[str, Messages]:
    numbers: dict[Writer, list[int]] = {}
    for number, writer in sorted(found.writers.items()):
        if number in found.messages:
            numbers.setdefault(writer, []).append(number)
    topics = {}
    for writer, own in numbers.items():
        entries = np.concatenate([part for number in own for part in found.messages[number]])
        read = partial(_message, found.path, found.chunks, entries[:, 1:], find, frozenset(own))
        topics[writer.topic] = Messages(
            writer.kind, entries[:, 0].copy(), writer.is_cdr, read, lambda _: found.path
        )
    return topics


def _message(
    path: Path,
    chunks: Sequence[Chunk],
    places: NDArray[np.int64],
    find: Find,
    writers: frozenset[int],
    number: int,
    first: int | None,
) -> bytes:
    chunk, offset = places[number].tolist()
    end = None if first is None else offset + _LONGEST_HEAD + first
    try:
        with opened(path) as file:
            span = _unpacked(file, chunks[chunk], path, end)
            start, size = find(span, offset, writers)
            if first is None and size > LARGEST_MESSAGE:
                raise ValueError("too large")
            return span.read(start, size if first is None else min(size, first))
    except _BROKEN as error:
        raise InputError(
            RECORDING_DAMAGED,
            "message {number} of its topic, or its chunk, is damaged.",
            path,
            number=number,
        ) from error


def _unpacked(file: Span, chunk: Chunk, path: Path, end: int | None) -> Span:
    """Decompress a chunk, up to the offset `end` if given.

    Never produces more bytes than the chunk header states, so a decompression bomb cannot fill the memory.
    """
    if not chunk.compression:
        return Span(file.file, chunk.start, min(chunk.size, chunk.stored))
    claimed = max(chunk.size, chunk.stored)
    if claimed > _LARGEST_CHUNK:
        raise InputError(
            RECORDING_DAMAGED,
            "a chunk states a size of {claimed} bytes, which exceeds any valid chunk; its header is damaged.",
            path,
            claimed=claimed,
        )
    if chunk.compression not in _UNPACK:
        known = ", ".join(_UNPACK)
        raise InputError(
            RECORDING_ENCODING_UNKNOWN,
            "unknown chunk compression {compression!r}; {known} are supported.",
            path,
            compression=chunk.compression[:20],
            known=known,
        )
    wanted = chunk.size if end is None else min(end, chunk.size)
    content = _UNPACK[chunk.compression](file.read(chunk.start, chunk.stored), wanted)
    if len(content) < wanted:
        raise EOFError
    return Span(BytesIO(content), 0, chunk.size)


def _lz4(data: bytes, most: int) -> bytes:
    import lz4.frame

    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most))


def _bz2(data: bytes, most: int) -> bytes:
    try:
        return bz2.BZ2Decompressor().decompress(data, max_length=most)
    except OSError as error:
        raise ValueError("damaged") from error


# Compression names, common to both formats.
_UNPACK: Mapping[str, Callable[[bytes, int], bytes]] = {
    "lz4": _lz4,
    "bz2": _bz2,
    "zstd": zstd_blocks.unpacked,
}
