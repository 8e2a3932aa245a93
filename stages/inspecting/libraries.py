"""Which versions of libraries are installed; nothing is imported for it."""

from __future__ import annotations

from importlib import metadata

# The distributions that bring a library, where it has several.
_DISTRIBUTIONS = {
    "open3d": ("open3d", "open3d-cpu"),
    "opencv": (
        "opencv-contrib-python-headless",
        "opencv-contrib-python",
        "opencv-python-headless",
        "opencv-python",
    ),
}


def version_of(library: str) -> str | None:
    """Return the installed version of a library; None where it is not there."""
    names = _DISTRIBUTIONS.get(library, (library,))
    return next((one.version for name in names for one in metadata.distributions(name=name)), None)


def installed(*libraries: str) -> dict[str, str]:
    """Return the versions of libraries by name; "unknown" for what is not there."""
    return {library: version_of(library) or "unknown" for library in libraries}
