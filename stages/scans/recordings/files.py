"""Which files of a folder make up a ROS recording: one file, or those a metadata.yaml of ROS 2 lists."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.codes import RECORDING_SEVERAL
from scanloom.stages.scans.image_folders.image_files import first_existing

SUFFIXES = (".bag", ".db3", ".mcap")
_LIST = "metadata.yaml"
_INFORMATION, _FILES = "rosbag2_bagfile_information", "relative_file_paths"


def recordings(folder: Path) -> list[Path]:
    """Return the files of recordings in a folder, by name."""
    return sorted(file for suffix in SUFFIXES for file in folder.glob(f"*{suffix}"))


def recording_files(place: Path) -> Sequence[Path]:
    """Return the files of the recording at a place, in the order in which they were written.

    Raises
    ------
    InputError
        If there is none, there are several, or one of a list is missing.
    """
    if place.is_file():
        return [place]
    listed = first_existing(place, _LIST)
    if listed is not None and (files := _listed(listed)):
        return files
    files = recordings(place)
    if len(files) != 1:
        kinds = ", ".join(SUFFIXES)
        found = f"there is no recording ({kinds})" if not files else f"there are {len(files)} recordings"
        raise InputError(
            RECORDING_SEVERAL, "{found} in it", place, remedy="give the one to read.", found=found
        )
    return files


def _listed(listed: Path) -> list[Path]:
    """Return the files that ROS 2's list names; none where it is another program's."""
    said = documents.read_document(listed).get(_INFORMATION)
    names = said.get(_FILES) if isinstance(said, dict) else None
    if not isinstance(names, list) or not all(isinstance(name, str) and name for name in names):
        return []
    # Early versions put the folder's own name before each.
    files = [
        listed.parent / PurePosixPath(documents.require_inside(name, listed, _FILES)).name for name in names
    ]
    for file in files:
        # A recording that was unpacked afterwards is still listed as it was.
        unpacked = file.with_suffix("") if file.suffix == ".zstd" else file
        if not unpacked.is_file():
            advice = "" if unpacked == file else f"; unpack {file.name} with `zstd --decompress`"
            raise InputError(
                RECORDING_SEVERAL,
                "{unpacked_name}, which it lists, is missing{advice}.",
                listed,
                unpacked_name=unpacked.name,
                advice=advice,
            )
    return [file.with_suffix("") if file.suffix == ".zstd" else file for file in files]
