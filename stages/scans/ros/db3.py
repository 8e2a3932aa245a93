"""Read the messages of a `.db3`: an SQLite database, as ROS 2 and RealSense's newer recorders write it.

The file may come from anywhere: it is opened for reading only, tables have to be tables (a view could compute
for ever), and what a row claims to hold is checked before it is read.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError
from stages.files import zstd_blocks

_SQLITE = b"SQLite format 3\0"
_HEADER_BYTES = 100
_COLUMNS = {"topics": {"id", "name", "type"}, "messages": {"id", "topic_id", "timestamp", "data"}}
# No camera makes a larger image.
_LARGEST_MESSAGE = 1 << 28


@dataclass(frozen=True, eq=False)
class Db3Topic:
    """The messages of a topic, in the order in which they were recorded.

    Attributes
    ----------
    kind : the message type, such as `sensor_msgs/msg/Image`.
    rows : (n,) int64, what the file knows the messages by.
    times : (n,) int64 nanoseconds at which they were recorded.
    """

    kind: str
    rows: NDArray[np.int64]
    times: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Db3:
    """The index of a `.db3`: topics by name, each has messages."""

    path: Path
    topics: Mapping[str, Db3Topic]


def read_db3(path: Path) -> Db3:
    """Read which messages the file holds.

    Raises
    ------
    InputError
        If it cannot be read, is no SQLite database, or one without the tables of a recording.
    """
    try:
        with path.open("rb") as file:
            header = file.read(_HEADER_BYTES)
    except OSError as error:
        raise InputError(f"the file cannot be read ({error.strerror}).", path) from error
    if not header.startswith(_SQLITE) or len(header) < _HEADER_BYTES:
        raise InputError("this is no .db3 recording: it is not an SQLite database.", path)
    # Of pages that a cut took away SQLite would make zeros: black images.
    page, pages = int.from_bytes(header[16:18], "big"), int.from_bytes(header[28:32], "big")
    promised = (1 << 16 if page == 1 else page) * pages
    if path.stat().st_size < promised:
        raise InputError(f"the file is cut short: it should hold {promised} bytes. Copy it again.", path)
    for table, columns in _COLUMNS.items():
        kinds = _query(path, "SELECT type FROM sqlite_master WHERE name = ?", table)
        found = {row[1] for row in _query(path, f"PRAGMA table_info({table})")}
        if kinds != [("table",)] or not columns <= found:
            raise InputError(f"this database is no recording: it has no table `{table}` as they have.", path)
    entries: dict[object, list[tuple[int, int]]] = {}
    for number, row, time in _query(
        path, "SELECT topic_id, id, timestamp FROM messages ORDER BY timestamp, id"
    ):
        if isinstance(row, int) and isinstance(time, int):
            entries.setdefault(number, []).append((row, time))
    topics = {}
    for number, name, kind in _query(path, "SELECT id, name, type FROM topics"):
        if number in entries and isinstance(name, str) and isinstance(kind, str):
            rows, times = np.array(entries[number], np.int64).T
            topics[name] = Db3Topic(kind, rows, times)
    return Db3(path, topics)


def read_row(recording: Db3, row: int) -> bytes:
    """Return the serialised bytes of a message.

    Raises
    ------
    InputError
        If it cannot be read or unpacked, or is too large to be right.
    """
    path = recording.path
    sizes = _query(path, "SELECT length(data) FROM messages WHERE id = ?", row)
    if not sizes or not isinstance(sizes[0][0], int) or sizes[0][0] > _LARGEST_MESSAGE:
        raise InputError(f"message {row} is missing or too large.", path)
    ((data,),) = _query(path, "SELECT data FROM messages WHERE id = ?", row)
    if not isinstance(data, bytes):
        raise InputError(f"message {row} is damaged.", path)
    if not data.startswith(zstd_blocks.MAGIC):
        return data
    # ROS 2 and some of RealSense's recorders pack message by message.
    try:
        return zstd_blocks.unpacked(data, _LARGEST_MESSAGE)
    except ValueError as error:
        raise InputError(f"message {row} does not decompress; it is damaged.", path) from error


def _query(path: Path, words: str, *values: object) -> list[tuple[Any, ...]]:
    try:
        connection = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)
        try:
            return connection.execute(words, values).fetchall()
        finally:
            connection.close()
    except (sqlite3.Error, ValueError, OverflowError) as error:
        raise InputError(f"the database is damaged or cut short ({error}).", path) from error
