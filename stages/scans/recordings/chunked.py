"""What ROS 1 bags and MCAP files share: rows of records, and messages in chunks packed each for itself.

A recorder that was stopped in the middle leaves chunks and their indexes, but not the summary at the end that
other readers start from. So records are walked from the front, over the chunks without reading them: whole
and unfinished files are read alike, and no number in a file makes the walk longer than the file.

Why neither `rosbags` (0.11.9) nor `mcap` (1.6.0) does this: they are made for whole files. Of 12,000 bags and
MCAP files cut at any place, `rosbags` reads no message, and `mcap` none by its index; this reader keeps 43 %
of all messages. (`mcap` from front to back keeps a few more, but reads all of a file for it.) Of 24,000 with
bytes or lengths changed, `rosbags` leaves 4,758 with errors that are not its own, such as KeyError and
MemoryError, and `mcap` 3,043 of 12,000. Both unpack whatever a chunk holds: of 33 KB that state 100 bytes
they make 2.1 GB and 1.1 GB. Both take a length as it stands: a record that states 3 GiB, in a file of 4, is
read whole. Messages are found by time, not by place, through one open file that threads cannot share, and
`rosbags` refuses MCAP files with messages of ROS 1, or with messages outside of chunks that are not in order.
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

# What a damaged record raises where it is taken apart.
_BROKEN = (struct.error, ValueError, KeyError, EOFError, RuntimeError)
# Recorders close a chunk at some megabytes or after one message; no camera makes a larger image.
_LARGEST_CHUNK = 1 << 28
# The most that a message's record takes before its data.
_LONGEST_HEAD = 256
# The chunk that is the file itself.
FILE = 0


class Writer(NamedTuple):
    """What one of a recording's writers wrote: all that the messages of a topic have in common."""

    topic: str
    kind: str
    is_cdr: bool


class Chunk(NamedTuple):
    """Where the bytes of a chunk are, how they are packed ("": not at all), and how many they are then."""

    start: int
    stored: int
    compression: str
    size: int


@dataclass(frozen=True, eq=False)
class Span:
    """The bytes of a file or of a chunk, counted from its start; the last of a chunk may not be unpacked."""

    file: BinaryIO
    start: int
    size: int

    def read(self, at: int, size: int) -> bytes:
        """Return exactly so many bytes; EOFError where there are fewer."""
        if size > self.size - at:
            raise EOFError
        self.file.seek(self.start + at)
        data = self.file.read(size)
        if len(data) < size:
            raise EOFError
        return data


@dataclass(frozen=True, eq=False)
class Found:
    """What a walk has met.

    Attributes
    ----------
    chunks : the first is the file itself.
    writers : by the number that the file knows each by.
    messages : (n, 3) int64 parts of time, chunk and offset in it, by writer.
    indexed : chunks that an index followed.
    """

    path: Path
    chunks: list[Chunk]
    writers: dict[int, Writer] = field(default_factory=dict)
    messages: dict[int, list[NDArray[np.int64]]] = field(default_factory=dict)
    indexed: set[int] = field(default_factory=set)

    def add(self, writer: int, times: ArrayLike, chunk: int, offsets: ArrayLike) -> None:
        """Note messages of a chunk: when each was recorded, nanoseconds, and where in the chunk it stands."""
        entries = np.stack(np.broadcast_arrays(times, chunk, offsets), axis=-1).reshape(-1, 3)
        if len(entries):
            self.messages.setdefault(writer, []).append(entries.astype(np.int64))


# Notes the record at a place of a chunk, and returns the place behind it.
Note = Callable[[Found, int, Span, int], int]
# Returns where the data of a message's record starts and how long it is, if one of these writers wrote it.
Find = Callable[[Span, int, frozenset[int]], tuple[int, int]]


@contextmanager
def opened(path: Path) -> Iterator[Span]:
    """Open a file for reading; InputError if that fails, also later on."""
    try:
        with opening.opened(path) as file:
            yield Span(file, 0, path.stat().st_size)
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "the file cannot be read ({strerror}).", path, strerror=error.strerror
        ) from error


def read_chunked(path: Path, file: Span, start: int, note: Note, find: Find) -> Recording:
    """Return the recording in a file whose records begin at a byte; what follows a damaged one is left out.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    found = Found(path, [Chunk(0, file.size, "", file.size)])
    broken = _walk(note, found, FILE, file, start)
    fault = None if broken is None else f"its record at byte {broken} of {file.size} is damaged or cut short"
    for number, chunk in enumerate(found.chunks[1:], 1):
        # An unfinished file tells of its writers only in the chunks, each in its first.
        if number not in found.indexed or _is_first_of_unknown(found, number):
            try:
                broken = _walk(note, found, number, _unpacked(file, chunk, path, None), 0)
            except (*_BROKEN, InputError):
                broken = 0
            if broken is not None:
                fault = fault or f"its chunk at byte {chunk.start} of {file.size} is damaged"
    return Recording(path, _topics(found, find), fault)


def _walk(note: Note, found: Found, chunk: int, span: Span, at: int) -> int | None:
    """Note record after record; return where one is damaged, or None."""
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
            "message {number} of its topic, or the chunk it is in, is damaged.",
            path,
            number=number,
        ) from error


def _unpacked(file: Span, chunk: Chunk, path: Path, end: int | None) -> Span:
    """Return what a chunk holds, unpacked up to `end` if given; never more than the chunk states."""
    if not chunk.compression:
        return Span(file.file, chunk.start, min(chunk.size, chunk.stored))
    claimed = max(chunk.size, chunk.stored)
    if claimed > _LARGEST_CHUNK:
        raise InputError(
            RECORDING_DAMAGED,
            "a chunk claims to hold {claimed} bytes; its header is damaged.",
            path,
            claimed=claimed,
        )
    if chunk.compression not in _UNPACK:
        known = ", ".join(_UNPACK)
        raise InputError(
            RECORDING_ENCODING_UNKNOWN,
            "chunks are compressed as {compression!r}; {known} are known.",
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


# By the names that both kinds of file give them.
_UNPACK: Mapping[str, Callable[[bytes, int], bytes]] = {
    "lz4": _lz4,
    "bz2": _bz2,
    "zstd": zstd_blocks.unpacked,
}
