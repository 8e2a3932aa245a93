"""What a file says of the program that wrote it."""

from __future__ import annotations


def installed_version() -> str:
    """Return the version of the installed distribution; `0+unknown` for sources that are not installed."""
    from importlib.metadata import PackageNotFoundError, version  # 20 ms that few programs need

    try:
        return version("scanloom")
    except PackageNotFoundError:
        return "0+unknown"
