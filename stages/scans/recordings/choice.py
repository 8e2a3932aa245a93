"""Which of the recordings of a folder is read: formats that pack a scan in one file."""

from __future__ import annotations

from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import RECORDING_SEVERAL, SCAN_LAYOUT_UNKNOWN


def one_recording(place: Path, suffix: str) -> Path:
    """Return the file that was given, or the only one of a suffix in the folder that was.

    Raises
    ------
    InputError
        If the folder holds none, or several.
    """
    if place.is_file():
        return place
    files = sorted(path for path in place.iterdir() if path.suffix.lower() == suffix)
    if len(files) == 1:
        return files[0]
    if not files:
        raise InputError(SCAN_LAYOUT_UNKNOWN, "there is no {suffix} file.", place, suffix=suffix)
    names = ", ".join(path.name for path in files[:5]) + (" …" if len(files) > 5 else "")
    raise InputError(
        RECORDING_SEVERAL,
        "there are {files_count} {suffix} files ({names}), each a scan of its own",
        place,
        remedy="give the one to read.",
        files_count=len(files),
        suffix=suffix,
        names=names,
    )
