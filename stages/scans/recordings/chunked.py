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
from scanloom.stages.files import input_files, zstd_blocks
from scanloom.stages.files.codes import FILE_UNREADABLE, RECORDING_DAMAGED
from scanloom.stages.scans.codes import RECORDING_ENCODING_UNKNOWN
from scanloom.stages.scans.recordings.recording import MAX_MESSAGE_BYTES, Recording, TopicMessages

# Exceptions that parsing a damaged record raises.
_PARSE_ERRORS = (struct.error, ValueError, KeyError, EOFError, RuntimeError)
# Maximum bytes of a chunk. Recorders close a chunk after some megabytes or one message; no camera image is
# larger.
_MAX_CHUNK_BYTES = 1 << 28
# Maximum bytes of a message record before its data.
_MAX_MESSAGE_HEAD_BYTES = 256
# Chunk index of the file itself.
FILE_CHUNK = 0


class Connection(NamedTuple):
    """Properties common to all messages of one connection or channel.

    Topic, message type, and serialisation.
    """

    topic: str
    message_type: str
    is_cdr: bool


class Chunk(NamedTuple):
    """Location, compression ("" for uncompressed) and uncompressed size of a chunk, in bytes."""

    start: int
    stored_bytes: int
    compression: str
    size: int


@dataclass(frozen=True, eq=False)
class ByteSpan:
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
class RecordIndex:
    """Index built by walking the records of a file.

    Attributes
    ----------
    chunks : chunks of the file; the first is the file itself.
    connections : connections or channels, by their number in the file.
    messages : by writer number, (n, 3) int64 arrays of recording time (ns), chunk index and offset in the
        chunk.
    indexed_chunks : indices of the chunks that are followed by an index.
    """

    path: Path
    chunks: list[Chunk]
    connections: dict[int, Connection] = field(default_factory=dict)
    messages: dict[int, list[NDArray[np.int64]]] = field(default_factory=dict)
    indexed_chunks: set[int] = field(default_factory=set)

    def add_messages(self, writer: int, times: ArrayLike, chunk: int, offsets: ArrayLike) -> None:
        """Add messages of a chunk, by recording time (ns) and offset."""
        entries = np.stack(np.broadcast_arrays(times, chunk, offsets), axis=-1).reshape(-1, 3)
        if len(entries):
            self.messages.setdefault(writer, []).append(entries.astype(np.int64))


# Adds the record at an offset of a chunk to the index, and returns the offset of the next record.
RecordIndexer = Callable[[RecordIndex, int, ByteSpan, int], int]
# Returns start and length of the data of the message at an offset; raises ValueError if the record is not a
# message of one of these writers.
MessageLocator = Callable[[ByteSpan, int, frozenset[int]], tuple[int, int]]


@contextmanager
def open_span(path: Path) -> Iterator[ByteSpan]:
    """Open a file for reading as a span.

    Raises
    ------
    InputError
        If opening fails, or a read inside the context fails with OSError.
    """
    try:
        with input_files.open_input(path) as file:
            yield ByteSpan(file, 0, path.stat().st_size)
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "the file cannot be read ({strerror}).", path, strerror=error.strerror
        ) from error


def read_chunked_recording(
    path: Path, file: ByteSpan, start: int, index_record: RecordIndexer, locate_message: MessageLocator
) -> Recording:
    """Index a chunked recording. Records after a damaged one are ignored.

    Parameters
    ----------
    start : offset of the first record, bytes.
    index_record, locate_message : format-specific record parsers.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    found = RecordIndex(path, [Chunk(0, file.size, "", file.size)])
    broken = _walk_records(index_record, found, FILE_CHUNK, file, start)
    fault = None if broken is None else f"the record at byte {broken} of {file.size} is damaged or truncated"
    for number, chunk in enumerate(found.chunks[1:], 1):
        # Unfinished files describe their connections only inside chunks, in the first chunk of each
        # connection.
        if number not in found.indexed_chunks or _is_first_chunk_of_unknown(found, number):
            try:
                broken = _walk_records(
                    index_record, found, number, _decompress_chunk(file, chunk, path, None), 0
                )
            except (*_PARSE_ERRORS, InputError):
                broken = 0
            if broken is not None:
                fault = fault or f"the chunk at byte {chunk.start} of {file.size} is damaged"
    return Recording(path, _collect_topics(found, locate_message), fault)


def _walk_records(
    index_record: RecordIndexer, found: RecordIndex, chunk: int, span: ByteSpan, at: int
) -> int | None:
    """Index all records of a span.

    Returns the offset of a damaged record, or None.
    """
    try:
        while at < span.size:
            at = index_record(found, chunk, span, at)
    except _PARSE_ERRORS:
        return at
    return None


def _is_first_chunk_of_unknown(found: RecordIndex, chunk: int) -> bool:
    unknown = found.messages.keys() - found.connections.keys()
    return any(found.messages[writer][0][0, 1] == chunk for writer in unknown)


def _collect_topics(found: RecordIndex, locate_message: MessageLocator) -> Mapping[str, TopicMessages]:
    numbers: dict[Connection, list[int]] = {}
    for number, writer in sorted(found.connections.items()):
        if number in found.messages:
            numbers.setdefault(writer, []).append(number)
    topics = {}
    for writer, own in numbers.items():
        entries = np.concatenate([part for number in own for part in found.messages[number]])
        read = partial(
            _read_message, found.path, found.chunks, entries[:, 1:], locate_message, frozenset(own)
        )
        topics[writer.topic] = TopicMessages(
            writer.message_type, entries[:, 0].copy(), writer.is_cdr, read, lambda _: found.path
        )
    return topics


def _read_message(
    path: Path,
    chunks: Sequence[Chunk],
    locations: NDArray[np.int64],
    locate_message: MessageLocator,
    writers: frozenset[int],
    number: int,
    byte_count: int | None,
) -> bytes:
    chunk, offset = locations[number].tolist()
    end = None if byte_count is None else offset + _MAX_MESSAGE_HEAD_BYTES + byte_count
    try:
        with open_span(path) as file:
            span = _decompress_chunk(file, chunks[chunk], path, end)
            start, size = locate_message(span, offset, writers)
            if byte_count is None and size > MAX_MESSAGE_BYTES:
                raise ValueError("too large")
            return span.read(start, size if byte_count is None else min(size, byte_count))
    except _PARSE_ERRORS as error:
        raise InputError(
            RECORDING_DAMAGED,
            "message {number} of its topic, or its chunk, is damaged.",
            path,
            number=number,
        ) from error


def _decompress_chunk(file: ByteSpan, chunk: Chunk, path: Path, end: int | None) -> ByteSpan:
    """Decompress a chunk, up to the offset `end` if given.

    Never produces more bytes than the chunk header states, so a decompression bomb cannot fill the memory.
    """
    if not chunk.compression:
        return ByteSpan(file.file, chunk.start, min(chunk.size, chunk.stored_bytes))
    claimed = max(chunk.size, chunk.stored_bytes)
    if claimed > _MAX_CHUNK_BYTES:
        raise InputError(
            RECORDING_DAMAGED,
            "a chunk states a size of {claimed} bytes, which exceeds any valid chunk; its header is damaged.",
            path,
            claimed=claimed,
        )
    if chunk.compression not in _DECOMPRESSORS:
        known = ", ".join(_DECOMPRESSORS)
        raise InputError(
            RECORDING_ENCODING_UNKNOWN,
            "unknown chunk compression {compression!r}; {known} are supported.",
            path,
            compression=chunk.compression[:20],
            known=known,
        )
    wanted = chunk.size if end is None else min(end, chunk.size)
    content = _DECOMPRESSORS[chunk.compression](file.read(chunk.start, chunk.stored_bytes), wanted)
    if len(content) < wanted:
        raise EOFError
    return ByteSpan(BytesIO(content), 0, chunk.size)


def _decompress_lz4(data: bytes, max_bytes: int) -> bytes:
    import lz4.frame

    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=max_bytes))


def _decompress_bz2(data: bytes, max_bytes: int) -> bytes:
    try:
        return bz2.BZ2Decompressor().decompress(data, max_length=max_bytes)
    except OSError as error:
        raise ValueError("damaged") from error


# Compression names, common to both formats.
_DECOMPRESSORS: Mapping[str, Callable[[bytes, int], bytes]] = {
    "lz4": _decompress_lz4,
    "bz2": _decompress_bz2,
    "zstd": zstd_blocks.decompress_zstd,
}
