"""Choice of the recording in a folder, for single-file formats."""

from __future__ import annotations

from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import RECORDING_SEVERAL, SCAN_LAYOUT_UNKNOWN


def find_single_recording(source: Path, suffix: str) -> Path:
    """Return the given file, or the only matching file of a folder.

    Raises
    ------
    InputError
        If the folder holds no such file, or several.
    """
    if source.is_file():
        return source
    files = sorted(path for path in source.iterdir() if path.suffix.lower() == suffix)
    if len(files) == 1:
        return files[0]
    if not files:
        raise InputError(SCAN_LAYOUT_UNKNOWN, "the folder has no {suffix} file.", source, suffix=suffix)
    names = ", ".join(path.name for path in files[:5]) + (" …" if len(files) > 5 else "")
    raise InputError(
        RECORDING_SEVERAL,
        "the folder has {files_count} {suffix} files ({names}), and each is a separate scan",
        source,
        remedy="give the file to read.",
        files_count=len(files),
        suffix=suffix,
        names=names,
    )
