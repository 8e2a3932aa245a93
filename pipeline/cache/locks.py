"""Shared and exclusive locks on files and folders, released when the process ends."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

from scanloom.pipeline.cache.system import lock, open_folder_lock, open_lock

# Error codes of file systems without locks, such as some network shares.
_NO_LOCKS_ERRORS = frozenset({errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOSYS})
# Error codes of read-only locations.
READ_ONLY_ERRORS = frozenset({errno.EROFS, errno.EACCES, errno.EPERM})


class FileLock:
    """Lock held until released, or until the process ends.

    Parameters
    ----------
    path : locked file.
    descriptor : open file descriptor of the locked file.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self._path = path
        self._descriptor: int | None = descriptor

    def release(self) -> None:
        """Release the lock; a second call has no effect."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def matches_path(self, path: Path) -> bool:
        """Return True if the locked file is still the file at a path."""
        if self._descriptor is None:
            return False
        try:
            return os.path.samestat(os.fstat(self._descriptor), path.lstat())
        except FileNotFoundError:
            return False

    def touch(self) -> None:
        """Set the modification time of the locked file to now."""
        descriptor = self._descriptor
        # os.utime does not accept a descriptor on Windows.
        os.utime(self._path if descriptor is None or os.utime not in os.supports_fd else descriptor)


def take_lock(path: Path, *, shared: bool = False) -> FileLock:
    """Open a lock file, creating it if needed, and wait for the lock.

    A link, a pipe or an empty folder at the path is replaced by a file; links are never followed. A read-only
    file can be locked, too.
    """
    return _lock_file(path, shared=shared, wait=True)


def try_lock(path: Path) -> FileLock | None:
    """Take an exclusive lock on a file; None if another process holds the lock."""
    try:
        return _lock_file(path, shared=False, wait=False)
    except BlockingIOError:
        return None


def take_folder_lock(folder: Path) -> FileLock:
    """Wait for the exclusive lock of a folder.

    No file is created in the folder.
    """
    return _hold_lock(folder, open_folder_lock(folder), shared=False, wait=True)


def try_folder_lock(folder: Path) -> FileLock | None:
    """Take the exclusive lock of a folder; None if another process holds the lock."""
    try:
        return _hold_lock(folder, open_folder_lock(folder), shared=False, wait=False)
    except BlockingIOError:
        return None


def is_folder(path: Path) -> bool:
    """Return True for a folder, False for a link to a folder."""
    try:
        return stat.S_ISDIR(path.lstat().st_mode)
    except OSError:
        return False


def _lock_file(path: Path, *, shared: bool, wait: bool) -> FileLock:
    return _hold_lock(path, _open_lock_file(path), shared=shared, wait=wait)


def _hold_lock(path: Path, descriptor: int, *, shared: bool, wait: bool) -> FileLock:
    try:
        try:
            lock(descriptor, shared=shared, wait=wait)
        except OSError as error:
            if error.errno not in _NO_LOCKS_ERRORS:
                raise
            # Without lock support, `wait` continues unlocked: entries are written atomically anyway, and the
            # worst case is duplicate work. Without `wait`, the lock is assumed to be held, so that nothing in
            # use is removed.
            if not wait:
                raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN)) from error
    except BaseException:
        os.close(descriptor)
        raise
    return FileLock(path, descriptor)


def _open_lock_file(path: Path) -> int:
    while True:
        if _is_obstacle(path):
            _remove_obstacle(path)
        try:
            descriptor = _open_for_writing_or_reading(path)
        except OSError as error:
            # The path became a link, folder or pipe in the meantime.
            if error.errno in (errno.ELOOP, errno.EISDIR, errno.ENXIO) and _is_obstacle(path):
                continue
            raise
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            return descriptor
        os.close(descriptor)


def _open_for_writing_or_reading(path: Path) -> int:
    try:
        return open_lock(path, writing=True)
    except OSError as error:
        if error.errno not in READ_ONLY_ERRORS or not path.is_file():
            raise
        return open_lock(path, writing=False)


def _is_obstacle(path: Path) -> bool:
    try:
        return not stat.S_ISREG(path.lstat().st_mode)
    except FileNotFoundError:
        return False


def _remove_obstacle(path: Path) -> None:
    """Remove anything that is not a regular file from a path.

    A folder is only removed if it is empty.
    """
    # Two processes may see the same link: the second must not remove the file that the first one created.
    parent_lock = take_folder_lock(path.parent)
    try:
        if _is_obstacle(path):
            if stat.S_ISDIR(path.lstat().st_mode):
                path.rmdir()
            else:
                path.unlink()
    finally:
        parent_lock.release()
