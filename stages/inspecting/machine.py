"""What is there to work with: versions, processor, memory, disk, extras."""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import tempfile
from pathlib import Path
from typing import Any

from stages import _kernels
from stages.files.opening import content_of, text_in
from stages.files.written_by import installed_version
from stages.inspecting.libraries import version_of

# What the kernels and the libraries are fast with.
_FEATURES = ("sse4_2", "avx", "avx2", "fma", "avx512f", "asimd")
_LIBRARIES = ("numpy", "open3d", "opencv", "scikit-image", "scipy", "trimesh", "typer")
# By the extra that brings them.
_EXTRAS = {"plot": "matplotlib", "usd": "usd-core"}


def machine() -> dict[str, Any]:
    """Return what is there, units in the names; None for what cannot be told. Nothing large is imported."""
    return {
        "scanloom": installed_version(),
        "kernels": kernels_build(),
        "python": platform.python_version(),
        "system": platform.platform(),
        "processor": _processor(),
        "processor_features": _features(),
        "threads": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "memory_total_bytes": _memory("MemTotal"),
        "memory_available_bytes": _memory("MemAvailable"),
        "disk_free_bytes": shutil.disk_usage(Path.cwd()).free,
        "temporary_disk_free_bytes": shutil.disk_usage(tempfile.gettempdir()).free,
        "libraries": {name: version_of(name) for name in _LIBRARIES},
        "extras": {name: version_of(library) for name, library in _EXTRAS.items()},
    }


def kernels_build() -> str:
    """Return the kernels' file name and the first digits of its digest: two builds of a version differ."""
    path = Path(str(_kernels.__file__))
    return f"{path.name} {hashlib.sha256(content_of(path)).hexdigest()[:12]}"


def _processor() -> str | None:
    return _of_cpuinfo("model name") or platform.processor() or None


def _features() -> list[str] | None:
    flags = _of_cpuinfo("flags") or _of_cpuinfo("Features")
    return None if flags is None else [name for name in _FEATURES if name in flags.split()]


def _of_cpuinfo(key: str) -> str | None:
    return _first(Path("/proc/cpuinfo"), key)


def _memory(key: str) -> int | None:
    found = _first(Path("/proc/meminfo"), key)
    return None if found is None else 1024 * int(found.split()[0])


def _first(path: Path, key: str) -> str | None:
    """Return what stands behind a key of a file of the system; None where there is none."""
    try:
        lines = text_in(path, "utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return None
    pairs = (line.partition(":") for line in lines)
    return next((value.strip() for name, _, value in pairs if name.strip() == key), None)
