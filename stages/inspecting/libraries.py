"""Versions of installed libraries, read without importing them."""

from __future__ import annotations

from importlib import metadata

# Distributions that provide a library, if there are several.
_DISTRIBUTIONS = {
    "open3d": ("open3d", "open3d-cpu"),
    "opencv": (
        "opencv-contrib-python-headless",
        "opencv-contrib-python",
        "opencv-python-headless",
        "opencv-python",
    ),
}


def find_version(library: str) -> str | None:
    """Return the installed version of a library, or None."""
    names = _DISTRIBUTIONS.get(library, (library,))
    return next((one.version for name in names for one in metadata.distributions(name=name)), None)


def list_installed_versions(*libraries: str) -> dict[str, str]:
    """Return the versions of libraries by name; "unknown" if not installed."""
    return {library: find_version(library) or "unknown" for library in libraries}
