"""Paths relative to the scan folder, for texts stored with cached results."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")


def make_paths_relative(value: T, folder: Path | None) -> T:
    """Make the paths in all strings of a value relative to the scan folder.

    Cached results are reused after the scan was moved, so stored texts must not contain its absolute path.

    Parameters
    ----------
    value : JSON values; keys of mappings are not changed.
    folder : scan folder or file; None returns the value unchanged.
    """
    return value if folder is None else _strip_prefix(value, f"{get_base_folder(folder)}{os.sep}")


def get_relative_path(path: Path, folder: Path) -> str:
    """Return a path relative to a folder, or absolute if on another Windows drive."""
    try:
        return os.path.relpath(path, folder)
    except ValueError:
        return str(path.absolute())


def get_base_folder(folder: Path) -> Path:
    """Return the base folder of paths in messages.

    This is the scan folder, or the parent folder of a scan file.
    """
    return folder.parent if folder.is_file() else folder


def _strip_prefix(value: Any, start: str) -> Any:
    if isinstance(value, str):
        return value.replace(start, "")
    if isinstance(value, Mapping):
        return {key: _strip_prefix(item, start) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_strip_prefix(item, start) for item in value]
    return value
