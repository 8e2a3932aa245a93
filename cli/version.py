"""Version of the program and its kernels."""

from __future__ import annotations


def describe_version() -> str:
    """Return the version of the program, and the build of its kernels."""
    from scanloom.stages.files.version import get_installed_version
    from scanloom.stages.inspecting.kernels_build import identify_kernels_build

    return f"scanloom {get_installed_version()}\nkernels {identify_kernels_build()}"
