"""Operating system queries: memory, processor, and limitations of the platform."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from scanloom.stages.files.input_files import read_input_text

if sys.platform == "win32":
    from scanloom.stages.inspecting import windows_system


def query_memory_bytes() -> tuple[int | None, int | None]:
    """Return total and available memory in bytes; None if unknown."""
    if sys.platform == "win32":
        return windows_system.query_memory_bytes()
    else:  # noqa: RET505 - type checkers take the rest for unreachable on Windows
        total, free = (_read_first_value(Path("/proc/meminfo"), key) for key in ("MemTotal", "MemAvailable"))
        if total is not None:
            return _parse_kilobytes(total), None if free is None else _parse_kilobytes(free)
        try:
            return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"), None
        except (OSError, ValueError):
            return None, None


def query_processor(key: str) -> str | None:
    """Look up a property of the first processor in /proc/cpuinfo.

    Returns None if the file or the key does not exist.
    """
    return _read_first_value(Path("/proc/cpuinfo"), key)


def list_platform_notes(folder: Path) -> list[str]:
    """Return notes about untested or limiting properties of this platform.

    Parameters
    ----------
    folder : existing folder whose file system is checked; nothing is written.
    """
    system = {"win32": "Windows", "darwin": "macOS"}.get(sys.platform, sys.platform)
    sentences = {
        f"scanloom is tested on Linux; on {system} it is expected to work, see docs/platforms.md.": (
            sys.platform != "linux"
        ),
        "this is a 32-bit Python: scans may not fit into its address space.": sys.maxsize < 1 << 32,
        "this processor is big-endian, but scan files are little-endian.": sys.byteorder != "little",
        f"{folder}: the file system does not distinguish upper and lower case.": is_case_insensitive(folder),
        "paths are limited to 260 characters: keep output folders near the drive root, or enable long paths "
        "in Windows.": (sys.platform == "win32" and not windows_system.supports_long_paths()),
    }
    return [sentence for sentence, holds in sentences.items() if holds]


def is_case_insensitive(folder: Path) -> bool:
    """Return True if a folder's file system ignores case."""
    absolute = folder.absolute()
    cased = next((p for p in (absolute, *absolute.parents) if p.name.swapcase() != p.name), None)
    try:
        return cased is not None and cased.with_name(cased.name.swapcase()).samefile(cased)
    except OSError:
        return False


def _parse_kilobytes(text: str) -> int:
    return 1024 * int(text.split()[0])


def _read_first_value(path: Path, key: str) -> str | None:
    """Return the first value of a key in a system file.

    Returns None if the file or the key does not exist.
    """
    try:
        lines = read_input_text(path, "utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return None
    pairs = (line.partition(":") for line in lines)
    return next((value.strip() for name, _, value in pairs if name.strip() == key), None)
