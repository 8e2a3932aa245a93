"""Version of the installed program, recorded in output files."""

from __future__ import annotations


def get_installed_version() -> str:
    """Return the version of the installed distribution.

    `0+unknown` if the sources are used without installation.
    """
    from importlib.metadata import PackageNotFoundError, version  # takes 20 ms, rarely needed

    try:
        return version("scanloom")
    except PackageNotFoundError:
        return "0+unknown"
