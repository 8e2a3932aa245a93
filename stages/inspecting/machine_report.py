"""Machine report: versions, processor, memory, disk and extras."""

from __future__ import annotations

import os
import platform
import shutil
import tempfile
from pathlib import Path
from typing import Any

from scanloom.stages.files.version import get_installed_version
from scanloom.stages.inspecting.kernels_build import identify_kernels_build
from scanloom.stages.inspecting.libraries import find_version
from scanloom.stages.inspecting.system import list_platform_notes, query_memory_bytes, query_processor

# Processor features that the kernels and libraries use.
_FEATURES = ("sse4_2", "avx", "avx2", "fma", "avx512f", "asimd")
_LIBRARIES = ("numpy", "open3d", "opencv", "scikit-image", "scipy", "trimesh", "typer")
# Library provided by each extra.
_EXTRAS = {
    "batch": "pyarrow",
    "dask": "distributed",
    "network": "onnxruntime",
    "plot": "matplotlib",
    "solid": "manifold3d",
    "usd": "usd-core",
}


def describe_machine() -> dict[str, Any]:
    """Collect versions and resources of this machine.

    Key names contain units. Unknown values become None. No large library is imported.
    """
    total, available = query_memory_bytes()
    return {
        "scanloom": get_installed_version(),
        "kernels": identify_kernels_build(),
        "python": platform.python_version(),
        "system": platform.platform(),
        "processor": _find_processor_name(),
        "processor_features": _list_processor_features(),
        "threads": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "memory_total_bytes": total,
        "memory_available_bytes": available,
        "disk_free_bytes": shutil.disk_usage(Path.cwd()).free,
        "temporary_disk_free_bytes": shutil.disk_usage(tempfile.gettempdir()).free,
        "libraries": {name: find_version(name) for name in _LIBRARIES},
        "extras": {name: find_version(library) for name, library in _EXTRAS.items()},
        "platform_notes": list_platform_notes(Path.cwd()),
    }


def _find_processor_name() -> str | None:
    return query_processor("model name") or platform.processor() or None


def _list_processor_features() -> list[str] | None:
    flags = query_processor("flags") or query_processor("Features")
    return None if flags is None else [name for name in _FEATURES if name in flags.split()]
