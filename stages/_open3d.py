"""Import of Open3D; every module imports Open3D through this one.

The Linux wheel needs the system library libusb-1.0.so.0, which minimal machines lack. A copy from the
libusb-package wheel is loaded first, so that no root access is needed. The import of Dash takes half of
Open3D's import time and is deferred until Dash is used.
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
from scanloom.stages.diagnostics.errors import StageError, is_out_of_memory
from scanloom.stages.files.memory_check import check_memory_available

# System libraries that Open3D links to, and the Debian package of each.
_DEBIAN_PACKAGES = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libX11.so.6": "libx11-6",
    "libgomp.so.1": "libgomp1",
    "libidn2.so.0": "libidn2-0",
    "libudev.so.1": "libudev1",
    "libusb-1.0.so.0": "libusb-1.0-0",
}


# Stack of a TBB thread, bytes.
_THREAD_STACK_BYTES = 1 << 24


def import_open3d() -> Any:
    """Import Open3D and start its threads.

    The import takes about 0.5 s, once per process. TBB, Open3D's thread library, aborts the process if it
    cannot start its threads. So the threads are started here, after a check of available memory.

    Raises
    ------
    StageError, MemoryError
        As `import_without_threads`; MemoryError also if there is too little memory for the threads.
    """
    module = import_without_threads()
    # The cache is per process id: a forked process inherits no threads.
    _start_threads(os.getpid())
    return module


@functools.cache
def _start_threads(process: int) -> None:  # noqa: ARG001
    check_memory_available(_THREAD_STACK_BYTES * (os.cpu_count() or 1))
    ones = import_without_threads().core.Tensor(np.ones(1 << 16, np.float32))
    _ = ones + ones


@functools.cache
def import_without_threads() -> Any:
    """Import Open3D without starting its threads.

    For processes that fork: each forked process starts its own threads.

    Raises
    ------
    StageError
        If a required system library is absent. The message names the library and its Debian package.
    MemoryError
        If there is too little memory for the import.
    """
    if sys.platform == "linux":
        _provide_libusb()
    try:
        with warnings.catch_warnings(), _defer_dash():
            # Some builds warn about a missing GPU although none was requested.
            warnings.simplefilter("ignore", ImportWarning)
            import open3d  # noqa: TID251
    except ImportError as error:
        # Ctrl-C during the imports of a compiled module surfaces as an ImportError.
        if isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
            raise KeyboardInterrupt from error
        if is_out_of_memory(error):
            raise MemoryError from error
        raise StageError(MACHINE_LIBRARY_MISSING, _explain(str(error))) from error
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    return open3d


@contextmanager
def _defer_dash() -> Iterator[None]:
    """Defer imports of Dash inside the block until first use.

    Open3D imports Dash, with 600 modules, for a single function that draws plots in a browser.
    """
    if "dash" in sys.modules:
        yield
        return
    sys.modules["dash"] = _DashStandIn("dash")
    try:
        yield
    finally:
        del sys.modules["dash"]


class _DashStandIn(ModuleType):
    """Stand-in for the module `dash`; its attributes are deferred imports."""

    def __getattr__(self, name: str) -> Any:
        # The import system probes for dunder attributes, which the stand-in does not have.
        if name.startswith("__"):
            raise AttributeError(name)
        return _DeferredAttribute(name)


class _DeferredAttribute:
    """Deferred attribute of Dash: imports Dash on first access or call."""

    def __init__(self, name: str) -> None:
        self._name = name

    def _resolve(self) -> Any:
        return getattr(importlib.import_module("dash"), self._name)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._resolve(), name)

    def __call__(self, *args: Any, **options: Any) -> Any:
        return self._resolve()(*args, **options)


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
