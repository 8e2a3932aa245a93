"""Peers without a Python door: C functions compiled on demand and opened with ctypes."""

from __future__ import annotations

import ctypes
import functools
import shutil
import subprocess
from pathlib import Path

HERE = Path(__file__).parent


class Missing(Exception):  # noqa: N818 - not an error: the peer is left out
    """A peer cannot be called here; the message says what it lacks."""


@functools.cache
def meshoptimizer() -> ctypes.CDLL:
    """Build and open the crate beside this file; see its `simplify`.

    Raises
    ------
    Missing
        Without cargo, or if the crate does not build.
    """
    crate = HERE / "meshoptimizer"
    _run(["cargo", "build", "--release", "--locked", "--quiet", "--manifest-path", str(crate / "Cargo.toml")])
    library = ctypes.CDLL(str(crate / "target/release/libpeer_meshoptimizer.so"))
    library.simplify.restype = ctypes.c_size_t
    return library


@functools.cache
def cgal() -> ctypes.CDLL:
    """Compile and open `cgal.cpp` beside this file; see its functions.

    Raises
    ------
    Missing
        Without a C++ compiler, or the headers of CGAL and Eigen.
    """
    source, target = HERE / "cgal.cpp", HERE / "target/cgal.so"
    if not target.exists() or target.stat().st_mtime < source.stat().st_mtime:
        target.parent.mkdir(exist_ok=True)
        command = ["g++", "-std=c++17", "-O3", "-DNDEBUG", "-DCGAL_EIGEN3_ENABLED", "-shared", "-fPIC"]
        _run([*command, "-isystem", "/usr/include/eigen3", str(source), "-o", str(target), "-lgmp", "-lmpfr"])
    library = ctypes.CDLL(str(target))
    library.version.restype = ctypes.c_char_p
    library.load.restype = ctypes.c_void_p
    library.vertex_count.restype = library.triangle_count.restype = ctypes.c_size_t
    return library


def _run(command: list[str]) -> None:
    if shutil.which(command[0]) is None:
        raise Missing(f"{command[0]} is not installed")
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        reasons = [line for line in done.stderr.splitlines() if "error" in line]
        raise Missing(reasons[0] if reasons else f"{command[0]} failed")
