"""Which of the recordings of a folder is read: formats that pack a scan in one file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from stages.errors import InputError

if TYPE_CHECKING:
    from stages.layouts.params import ScanParams


def one_recording(folder: Path, suffix: str, options: ScanParams) -> Path:
    """Return the only file of a suffix, or the one that the person names.

    Raises
    ------
    InputError
        If there is none, or several and none of them is named.
    """
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() == suffix)
    named = [path for path in files if options.recording in (path.name, path.stem)]
    if len(named or files) == 1 and (named or options.recording is None):
        return (named or files)[0]
    names = ", ".join(path.name for path in files[:5]) + (" …" if len(files) > 5 else "")
    if not files:
        raise InputError(f"there is no {suffix} file.", folder)
    if options.recording is not None:
        raise InputError(
            f"there is no {suffix} file {options.recording!r}; the folder holds {names}.", folder
        )
    raise InputError(
        f"there are {len(files)} {suffix} files ({names}), each a scan of its own; choose one with "
        "scan.recording=NAME.",
        folder,
    )
