"""Name the files of a scan from its folder on, in what is kept of a result."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")


def from_folder(value: T, folder: Path | None) -> T:
    """Return figures whose sentences name files from the scan's folder on.

    A kept result is given again after the scan was moved: where it stood before is then wrong.

    Parameters
    ----------
    value : plain JSON values; keys of mappings stay.
    folder : of the scan, or the file that is one; None leaves all as it is.
    """
    return value if folder is None else _shortened(value, f"{home(folder)}{os.sep}")


def from_there(path: Path, folder: Path) -> str:
    """Return a path as it is written from a folder on; whole where no way leads there, to another drive."""
    try:
        return os.path.relpath(path, folder)
    except ValueError:
        return str(path.absolute())


def home(folder: Path) -> Path:
    """Return the folder files of a scan are named from: the scan's own, or that of the one file it is."""
    return folder.parent if folder.is_file() else folder


def _shortened(value: Any, start: str) -> Any:
    if isinstance(value, str):
        return value.replace(start, "")
    if isinstance(value, Mapping):
        return {key: _shortened(item, start) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_shortened(item, start) for item in value]
    return value
