"""Locks on files and folders, shared or for oneself alone, that end with the process that holds them."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

from scanloom.pipeline.cache.system import lock, open_folder_lock, open_lock

# What the system says where there are no locks, as in some shared folders.
_NO_LOCKS = frozenset({errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOSYS})
# What it says where nothing may be written.
READ_ONLY = frozenset({errno.EROFS, errno.EACCES, errno.EPERM})


class Lock:
    """A lock that is held until it is released, or the process ends.

    Parameters
    ----------
    path : of the locked file.
    descriptor : of that file, open.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self._path = path
        self._descriptor: int | None = descriptor

    def release(self) -> None:
        """Let the next one have it; more than once does no harm."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def is_of(self, path: Path) -> bool:
        """Return whether the locked file is still the one of that name."""
        if self._descriptor is None:
            return False
        try:
            return os.path.samestat(os.fstat(self._descriptor), path.lstat())
        except FileNotFoundError:
            return False

    def touch(self) -> None:
        """Set the time of the locked file to now."""
        descriptor = self._descriptor
        # Windows takes no descriptor.
        os.utime(self._path if descriptor is None or os.utime not in os.supports_fd else descriptor)


def take_lock(path: Path, *, shared: bool = False) -> Lock:
    """Open a lock file, made if need be, and wait for the lock.

    A link, a pipe or an empty folder in its place is removed, and never followed. A file that may only be
    read is locked all the same.
    """
    return _locked(path, shared=shared, wait=True)


def try_lock(path: Path) -> Lock | None:
    """Take a lock file for oneself alone, or return None if anybody else has it."""
    try:
        return _locked(path, shared=False, wait=False)
    except BlockingIOError:
        return None


def take_folder(folder: Path) -> Lock:
    """Wait for the lock of a folder, which needs no file in it."""
    return _held(folder, open_folder_lock(folder), shared=False, wait=True)


def try_folder(folder: Path) -> Lock | None:
    """Take the lock of a folder, or return None if anybody else has it."""
    try:
        return _held(folder, open_folder_lock(folder), shared=False, wait=False)
    except BlockingIOError:
        return None


def is_folder(path: Path) -> bool:
    """Return whether a folder is there itself, and no link to one."""
    try:
        return stat.S_ISDIR(path.lstat().st_mode)
    except OSError:
        return False


def _locked(path: Path, *, shared: bool, wait: bool) -> Lock:
    return _held(path, _opened(path), shared=shared, wait=wait)


def _held(path: Path, descriptor: int, *, shared: bool, wait: bool) -> Lock:
    try:
        try:
            lock(descriptor, shared=shared, wait=wait)
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
            # What is waited for is then held with others: entries are whole or absent all the same, and the
            # same work may be done twice. What is only tried could be in use, and is let be.
            if not wait:
                raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN)) from error
    except BaseException:
        os.close(descriptor)
        raise
    return Lock(path, descriptor)


def _opened(path: Path) -> int:
    while True:
        if _is_in_the_way(path):
            _make_way(path)
        try:
            descriptor = _opened_to_write_or_read(path)
        except OSError as error:
            # What became a link, a folder or a pipe by now.
            if error.errno in (errno.ELOOP, errno.EISDIR, errno.ENXIO) and _is_in_the_way(path):
                continue
            raise
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            return descriptor
        os.close(descriptor)


def _opened_to_write_or_read(path: Path) -> int:
    try:
        return open_lock(path, writing=True)
    except OSError as error:
        if error.errno not in READ_ONLY or not path.is_file():
            raise
        return open_lock(path, writing=False)


def _is_in_the_way(path: Path) -> bool:
    try:
        return not stat.S_ISREG(path.lstat().st_mode)
    except FileNotFoundError:
        return False


def _make_way(path: Path) -> None:
    """Remove what is no file from the place of one; a folder only if it is empty."""
    # Two processes may see the link: the second must not remove the file that the first has put there.
    others = take_folder(path.parent)
    try:
        if _is_in_the_way(path):
            if stat.S_ISDIR(path.lstat().st_mode):
                path.rmdir()
            else:
                path.unlink()
    finally:
        others.release()
