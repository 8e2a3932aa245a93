"""Files that are whole or absent, and locks that end with the process that holds them."""

from __future__ import annotations

import errno
import fcntl
import glob
import os
import shutil
import stat
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from stages.files.replacing import draft_of, stem_of_drafts

# What the system says where nothing may be written.
READ_ONLY = frozenset({errno.EROFS, errno.EACCES, errno.EPERM})


def take_lock(path: Path, kind: int) -> int:
    """Open a lock file, made if need be, and wait for the lock; closing the descriptor releases it.

    A link, a pipe or an empty folder in its place is removed, and never followed. A file that may only be
    read is locked all the same.
    """
    descriptor = _opened_lock(path)
    try:
        fcntl.flock(descriptor, kind)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _opened_lock(path: Path) -> int:
    while True:
        if _is_in_the_way(path):
            _make_way(path)
        try:
            # Without waiting: a pipe could have taken the place by now.
            flags = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
            descriptor = _opened_to_write_or_read(path, flags)
        except OSError as error:
            if error.errno in (errno.ELOOP, errno.EISDIR, errno.ENXIO) and _is_in_the_way(path):
                continue
            raise
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            return descriptor
        os.close(descriptor)


def _opened_to_write_or_read(path: Path, flags: int) -> int:
    try:
        return os.open(path, flags | os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        if error.errno not in READ_ONLY or not path.is_file():
            raise
        return os.open(path, flags | os.O_RDONLY)


def _is_in_the_way(path: Path) -> bool:
    try:
        return not stat.S_ISREG(path.lstat().st_mode)
    except FileNotFoundError:
        return False


def _make_way(path: Path) -> None:
    """Remove what is no file from the place of one; a folder only if it is empty."""
    # Two processes may see the link: the second must not remove the file that the first has put there.
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)
        if _is_in_the_way(path):
            if stat.S_ISDIR(path.lstat().st_mode):
                path.rmdir()
            else:
                path.unlink()
    finally:
        os.close(folder)


def is_folder(path: Path) -> bool:
    """Return whether a folder is there itself, and no link to one."""
    try:
        return stat.S_ISDIR(path.lstat().st_mode)
    except OSError:
        return False


def try_lock(path: Path) -> int | None:
    """Take a lock file for oneself alone, or return None if anybody else has it."""
    try:
        return take_lock(path, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return None


def is_same_file(descriptor: int, path: Path) -> bool:
    """Return whether an open file is still the one of that name."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
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
        draft = draft_of(path)
        lock = take_lock(draft, fcntl.LOCK_EX)
        if is_same_file(lock, draft):
            return draft, lock
        # Another process took it for debris before it was locked.
        os.close(lock)


def remove_abandoned(path: Path) -> None:
    """Remove drafts of a file whose writers were killed."""
    for draft in path.parent.glob(f".{glob.escape(stem_of_drafts(path.name))}.*.part"):
        lock = try_lock(draft) if draft.is_file() and not draft.is_symlink() else None
        if lock is not None:
            draft.unlink(missing_ok=True)
            os.close(lock)
