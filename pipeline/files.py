"""Files that are whole or absent, and locks that end with the process that holds them."""

from __future__ import annotations

import fcntl
import os
import secrets
import shutil
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from pipeline.digest import file_digest


def take_lock(path: Path, kind: int) -> int:
    """Open a lock file, made if need be, and wait for the lock; closing the descriptor releases it."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    try:
        fcntl.flock(descriptor, kind)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def try_lock(path: Path) -> int | None:
    """Take a lock file for oneself alone, or return None if anybody else has it."""
    try:
        return take_lock(path, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return None


def is_same_file(descriptor: int, path: Path) -> bool:
    """Return whether an open file is still the one of that name."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def flush(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def flush_all(paths: Iterable[Path]) -> None:
    """Flush many files; several at a time, since each wait is for the disk and not for the processor."""
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(flush, paths))


def write_whole(path: Path, data: bytes) -> None:
    """Write a file so that its name shows the old content or the new one, never a part."""
    _replace(path, lambda draft: draft.write_bytes(data))


def copy_whole(source: Path, path: Path) -> None:
    """Copy a file so that the new name shows the old content or the new one, never a part."""
    _replace(path, lambda draft: shutil.copyfile(source, draft))


def has_content(path: Path, size: int, content: str) -> bool:
    """Return whether a file is there with that size in bytes and that digest."""
    return path.is_file() and path.stat().st_size == size and file_digest(path) == content


def _replace(path: Path, write: Callable[[Path], object]) -> None:
    remove_abandoned(path)
    draft, lock = _new_draft(path)
    try:
        write(draft)
        os.fsync(lock)
        draft.replace(path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise
    finally:
        os.close(lock)


def _new_draft(path: Path) -> tuple[Path, int]:
    while True:
        draft = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
        lock = take_lock(draft, fcntl.LOCK_EX)
        if is_same_file(lock, draft):
            return draft, lock
        # Another process took it for debris before it was locked.
        os.close(lock)


def remove_abandoned(path: Path) -> None:
    """Remove drafts of a file whose writers were killed."""
    for draft in path.parent.glob(f".{path.name}.*.part"):
        lock = try_lock(draft)
        if lock is not None:
            draft.unlink(missing_ok=True)
            os.close(lock)
