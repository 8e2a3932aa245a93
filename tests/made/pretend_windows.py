"""Emulation of Windows on Linux, for files and locks.

Modules, flags and calls that Windows lacks are removed from this process, and Linux answers calls of
kernel32. `os.open`, `os.replace`, `os.rename`, `os.unlink`, `os.rmdir` and `os.fsync` refuse what Windows
refuses: opening a folder, moving a folder in which this process has a file open, removing a file that it
opened without sharing deletion.

Names, drives and letter case stay as on Linux. Run `pytest -p pretend_windows`, or call `pretend` before
scanloom is imported.
"""

from __future__ import annotations

import ctypes
import ctypes.wintypes
import errno
import fcntl
import importlib
import os
import shutil
import stat
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

MISSING_MODULES = ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty")
MISSING_IN_OS = (
    *("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_DIRECTORY", "mkfifo", "sysconf", "sched_getaffinity"),
    *("fork", "geteuid", "getuid", "getpgid", "killpg", "chown", "pread", "openpty"),
)
# Marks a file descriptor whose file others may remove while it is open.
_MARK = os.O_NOATIME
_NOT_FOUND, _DENIED, _LOCKED = 2, 5, 33
_ERRNO = {_NOT_FOUND: errno.ENOENT, _DENIED: errno.EACCES}


def pretend() -> None:
    """Change this process permanently."""
    _import_platform_dependent()
    kernel = _Kernel()
    sys.platform = "win32"
    sys.modules.update(dict.fromkeys(MISSING_MODULES))
    sys.modules["msvcrt"] = _msvcrt()
    ctypes.WinDLL = lambda name, use_last_error=False: kernel  # noqa: ARG005
    ctypes.get_last_error = lambda: kernel.last_error
    ctypes.WinError = lambda code: OSError(_ERRNO[code], f"error {code}")
    _change_os()


def _import_platform_dependent() -> None:
    """Import all libraries while the platform is Linux, then unload scanloom's modules."""
    importlib.import_module("scanloom.cli.app").app()
    for name in ("cv2", "scipy.spatial", "trimesh"):
        importlib.import_module(name)
    for name in [name for name in sys.modules if name.split(".")[0] == "scanloom"]:
        # A process can load the kernels only once.
        if name != "scanloom.stages._kernels":
            del sys.modules[name]


class _Call:
    """A function of a library; declared argument types are ignored."""

    def __init__(self, function: Callable[..., int]) -> None:
        self._function = function

    def __call__(self, *arguments: Any) -> int:
        return self._function(*arguments)


class _Kernel:
    """Functions of kernel32 and ntdll that scanloom calls, with file descriptors as handles."""

    def __init__(self) -> None:
        self.last_error = 0
        self.CreateFileW = _Call(self._create_file)
        self.LockFileEx = _Call(self._lock_file)
        self.GetCurrentProcess = _Call(lambda: -1)
        self.K32GetProcessMemoryInfo = _Call(self._memory_info)
        self.GlobalMemoryStatusEx = _Call(self._memory_status)
        self.RtlAreLongPathsEnabled = _Call(lambda: 0)
        self._open = os.open
        self._O_NOFOLLOW, self._O_PATH = os.O_NOFOLLOW, os.O_PATH
        self._close_on_exec = os.O_CLOEXEC

    def _create_file(
        self, path: str, access: int, share: int, _: None, disposition: int, flags: int, __: None
    ) -> int:
        assert share == 0x1 | 0x2 | 0x4
        assert flags & 0x00200000, "links are not followed"
        try:
            if stat.S_ISDIR(os.lstat(path).st_mode):
                raise PermissionError
            if stat.S_ISLNK(os.lstat(path).st_mode):
                return self._open(path, self._O_PATH | self._O_NOFOLLOW)
        except FileNotFoundError:
            pass
        except PermissionError:
            self.last_error = _DENIED
            return -1
        how = (os.O_RDWR if access & 0x40000000 else os.O_RDONLY) | (os.O_CREAT if disposition == 4 else 0)
        try:
            return self._open(path, how | _MARK | self._O_NOFOLLOW | self._close_on_exec, 0o666)
        except FileNotFoundError:
            self.last_error = _NOT_FOUND
        except OSError:
            self.last_error = _DENIED
        return -1

    def _lock_file(self, handle: int, flags: int, *_: Any) -> int:
        assert flags & 0x1, "waiting is not left to the system"
        try:
            fcntl.flock(handle, (fcntl.LOCK_EX if flags & 0x2 else fcntl.LOCK_SH) | fcntl.LOCK_NB)
        except BlockingIOError:
            self.last_error = _LOCKED
            return 0
        return 1

    def _memory_info(self, _: int, found: Any, __: int) -> int:
        found._obj.PeakWorkingSetSize = 123 << 20
        return 1

    def _memory_status(self, found: Any) -> int:
        found._obj.total, found._obj.available = 8 << 30, 5 << 30
        return 1


def _msvcrt() -> ModuleType:
    module: Any = SimpleNamespace(open_osfhandle=lambda handle, flags: handle, get_osfhandle=lambda it: it)  # noqa: ARG005
    return module


def _change_os() -> None:
    real = SimpleNamespace(
        open=os.open, replace=os.replace, rename=os.rename, unlink=os.unlink, fsync=os.fsync
    )
    flags_of = fcntl.F_GETFL

    def open_(path: Any, flags: int, mode: int = 0o777, *, dir_fd: None = None) -> int:
        if Path(path).is_dir():
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return real.open(path, flags, mode, dir_fd=dir_fd)

    def rename(source: Any, target: Any, **_: None) -> None:
        if os.path.lexists(target):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(source), None, str(target))
        replace(source, target)

    def replace(source: Any, target: Any, **_: None) -> None:
        _refuse_if_open(source)
        _refuse_if_open(target)
        if Path(target).is_dir():
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(source), None, str(target))
        real.replace(source, target)

    def unlink(path: Any, **_: None) -> None:
        _refuse_if_open(path)
        real.unlink(path)

    def fsync(descriptor: int) -> None:
        if fcntl.fcntl(descriptor, flags_of) & os.O_ACCMODE == os.O_RDONLY:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        real.fsync(descriptor)

    os.open, os.replace, os.rename, os.fsync = open_, replace, rename, fsync
    os.unlink = os.remove = unlink
    os.O_BINARY = 0
    os.supports_fd = set()
    shutil._use_fd_functions = False
    for name in MISSING_IN_OS:
        if hasattr(os, name):
            delattr(os, name)


def _refuse_if_open(path: Any) -> None:
    """Raise the error of Windows for an open file, or for a folder that contains an open file."""
    whole = os.path.realpath(os.path.dirname(path)) + os.sep + os.path.basename(path)  # noqa: PTH119, PTH120
    is_folder = stat.S_ISDIR(os.lstat(path).st_mode) if os.path.lexists(path) else False
    for number in os.listdir("/proc/self/fd"):  # noqa: PTH208
        try:
            place = os.readlink(f"/proc/self/fd/{number}")  # noqa: PTH115
            told = Path(f"/proc/self/fdinfo/{number}").read_text(encoding="ascii")
        except OSError:
            continue
        may_be_removed = int(told.split("flags:")[1].split()[0], 8) & _MARK
        if (is_folder and place.startswith(whole + os.sep)) or (place == whole and not may_be_removed):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))


def pytest_configure() -> None:
    """Emulate Windows for all tests of a run."""
    pretend()
