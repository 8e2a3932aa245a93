"""Which of the recordings of a folder is read: formats that pack a scan in one file."""

from __future__ import annotations

from pathlib import Path

from stages.diagnostics.errors import InputError


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
        raise InputError(f"there is no {suffix} file.", place)
    names = ", ".join(path.name for path in files[:5]) + (" …" if len(files) > 5 else "")
    raise InputError(
        f"there are {len(files)} {suffix} files ({names}), each a scan of its own; give the one to read.",
        place,
    )
