"""Peers without a Python package, compiled on demand and called with ctypes."""

from __future__ import annotations

import ctypes
import functools
import os
import shutil
import subprocess
from pathlib import Path

HERE = Path(__file__).parent


class PeerUnavailable(Exception):  # noqa: N818 - not an error: the peer is skipped
    """A peer is not available; the message names what is missing."""


@functools.cache
def load_meshoptimizer() -> ctypes.CDLL:
    """Build and load the crate in `meshoptimizer/`.

    Raises
    ------
    PeerUnavailable
        Without cargo, or if the crate does not build.
    """
    crate = HERE / "meshoptimizer"
    _run_command(
        ["cargo", "build", "--release", "--locked", "--quiet", "--manifest-path", str(crate / "Cargo.toml")]
    )
    library = ctypes.CDLL(str(crate / "target/release/libpeer_meshoptimizer.so"))
    library.simplify.restype = ctypes.c_size_t
    return library


@functools.cache
def load_cgal() -> ctypes.CDLL:
    """Compile and load `load_cgal.cpp`.

    Raises
    ------
    PeerUnavailable
        Without a C++ compiler, or the headers of CGAL and Eigen.
    """
    options = ["-DCGAL_EIGEN3_ENABLED", "-isystem", "/usr/include/eigen3"]
    library = _load_compiled("cgal", [], [*options, "-lgmp", "-lmpfr"])
    library.version.restype = ctypes.c_char_p
    library.load.restype = ctypes.c_void_p
    library.vertex_count.restype = library.triangle_count.restype = ctypes.c_size_t
    return library


@functools.cache
def load_clusterlod() -> ctypes.CDLL:
    """Compile and load `load_clusterlod.cpp`.

    The environment variable MESHOPTIMIZER names a folder with meshoptimizer's `src/` and `demo/clusterlod.h`.

    Raises
    ------
    PeerUnavailable
        Without that folder, or a C++ compiler.
    """
    folder = os.environ.get("MESHOPTIMIZER")
    if folder is None:
        raise PeerUnavailable("set MESHOPTIMIZER to a folder with meshoptimizer's sources")
    sources = sorted(str(path) for path in Path(folder, "src").glob("*.cpp"))
    library = _load_compiled("clusterlod", sources, [f"-I{folder}/src", f"-I{folder}/demo"])
    library.build.restype = ctypes.c_void_p
    library.cut.restype = ctypes.c_size_t
    return library


def _load_compiled(name: str, sources: list[str], options: list[str]) -> ctypes.CDLL:
    """Load a C++ file of this folder, compiled if it changed."""
    source, target = HERE / f"{name}.cpp", HERE / f"target/{name}.so"
    if not target.exists() or target.stat().st_mtime < source.stat().st_mtime:
        target.parent.mkdir(exist_ok=True)
        command = ["g++", "-std=c++17", "-O3", "-DNDEBUG", "-shared", "-fPIC", str(source), *sources]
        _run_command([*command, *options, "-o", str(target)])
    return ctypes.CDLL(str(target))


def _run_command(command: list[str]) -> None:
    if shutil.which(command[0]) is None:
        raise PeerUnavailable(f"{command[0]} is not installed")
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        reasons = [line for line in done.stderr.splitlines() if "error" in line]
        raise PeerUnavailable(reasons[0] if reasons else f"{command[0]} failed")
