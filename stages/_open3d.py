"""The one door to Open3D.

Its Linux wheel wants libusb-1.0.so.0 from the system, which a bare machine lacks. A copy from the
libusb-package wheel, loaded first, satisfies it without root. Dash, half of what importing it takes, is left
for when it is used.
"""

from __future__ import annotations

import ctypes
import functools
import importlib
import os
import re
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import numpy as np

from scanloom.stages.diagnostics.codes import MACHINE_LIBRARY_MISSING
from scanloom.stages.diagnostics.errors import StageError, is_lack_of_memory
from scanloom.stages.files.room import require_room

# The system libraries Open3D links to, and the Debian package that brings each.
_DEBIAN_PACKAGES = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libX11.so.6": "libx11-6",
    "libgomp.so.1": "libgomp1",
    "libidn2.so.0": "libidn2-0",
    "libudev.so.1": "libudev1",
    "libusb-1.0.so.0": "libusb-1.0-0",
}


# Of a thread that TBB starts: its stack.
_THREAD_BYTES = 1 << 24


def open3d() -> Any:
    """Import Open3D (half a second, once a process), and have its threads started.

    TBB, which it computes with, ends the process where it cannot start them: they start while there is room.

    Raises
    ------
    StageError, MemoryError
        As `imported`; also where there is no room for the threads.
    """
    module = imported()
    # A process that is forked off has none of them.
    _start_threads(os.getpid())
    return module


@functools.cache
def _start_threads(process: int) -> None:  # noqa: ARG001
    require_room(_THREAD_BYTES * (os.cpu_count() or 1))
    ones = imported().core.Tensor(np.ones(1 << 16, np.float32))
    _ = ones + ones


@functools.cache
def imported() -> Any:
    """Import Open3D without its threads, which processes that are forked off then have to themselves.

    Raises
    ------
    StageError
        If a system library it needs is absent; the message names the library and its Debian package.
    MemoryError
        If there is no room for it.
    """
    if sys.platform == "linux":
        _provide_libusb()
    try:
        with warnings.catch_warnings(), _dash_later():
            # Some builds complain of a missing GPU where none was asked for.
            warnings.simplefilter("ignore", ImportWarning)
            import open3d  # noqa: TID251
    except ImportError as error:
        # Ctrl-C inside a compiled module's own imports comes out as a failed import.
        if isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
            raise KeyboardInterrupt from error
        if is_lack_of_memory(error):
            raise MemoryError from error
        raise StageError(MACHINE_LIBRARY_MISSING, _explain(str(error))) from error
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    return open3d


@contextmanager
def _dash_later() -> Iterator[None]:
    """Have what is imported meanwhile import Dash where it first uses it.

    Open3D takes it, and 600 modules with it, for the one function that draws plots in a browser.
    """
    if "dash" in sys.modules:
        yield
        return
    sys.modules["dash"] = _Dash("dash")
    try:
        yield
    finally:
        del sys.modules["dash"]


class _Dash(ModuleType):
    """What `from dash import` takes names from."""

    def __getattr__(self, name: str) -> Any:
        # What the machinery of imports asks of a module is not there.
        if name.startswith("__"):
            raise AttributeError(name)
        return _Later(name)


class _Later:
    """A name of Dash."""

    def __init__(self, name: str) -> None:
        self._name = name

    def _it(self) -> Any:
        return getattr(importlib.import_module("dash"), self._name)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._it(), name)

    def __call__(self, *args: Any, **options: Any) -> Any:
        return self._it()(*args, **options)


def _provide_libusb() -> None:
    try:
        ctypes.CDLL("libusb-1.0.so.0")
    except OSError:
        import libusb_package

        path = libusb_package.get_library_path()
        if path is not None:
            ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)


def _explain(message: str) -> str:
    missing = re.search(r"(lib[\w.+-]+\.so[.\d]*): cannot open", message)
    if missing is None:
        return f"Open3D cannot be imported: {message}"
    package = _DEBIAN_PACKAGES.get(missing[1])
    advice = f" On Debian or Ubuntu: apt-get install {package}" if package else ""
    return f"Open3D cannot be imported: the system library {missing[1]} is missing.{advice}"
