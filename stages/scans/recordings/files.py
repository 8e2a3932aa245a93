"""Files of a ROS recording: one file, or those in metadata.yaml."""

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
    """Return the recording files in a folder, sorted by suffix and name."""
    return sorted(file for suffix in SUFFIXES for file in folder.glob(f"*{suffix}"))


def recording_files(place: Path) -> Sequence[Path]:
    """Return the files of a recording in recording order.

    Parameters
    ----------
    place : a recording file, or a folder.

    Raises
    ------
    InputError
        If the folder holds no recording or several, or a listed file is missing.
    """
    if place.is_file():
        return [place]
    listed = first_existing(place, _LIST)
    if listed is not None and (files := _listed(listed)):
        return files
    files = recordings(place)
    if len(files) != 1:
        kinds = ", ".join(SUFFIXES)
        found = f"no recording ({kinds})" if not files else f"{len(files)} recordings"
        raise InputError(
            RECORDING_SEVERAL,
            "the folder has {found}",
            place,
            remedy="give the recording to read.",
            found=found,
        )
    return files


def _listed(listed: Path) -> list[Path]:
    """Return the files that a ROS 2 metadata.yaml lists.

    Empty for any other YAML file.
    """
    said = documents.read_document(listed).get(_INFORMATION)
    names = said.get(_FILES) if isinstance(said, dict) else None
    if not isinstance(names, list) or not all(isinstance(name, str) and name for name in names):
        return []
    # Early versions prefix each path with the name of the folder.
    files = [
        listed.parent / PurePosixPath(documents.require_inside(name, listed, _FILES)).name for name in names
    ]
    for file in files:
        # After manual decompression, the list still names the compressed files.
        unpacked = file.with_suffix("") if file.suffix == ".zstd" else file
        if not unpacked.is_file():
            advice = "" if unpacked == file else f"; decompress {file.name} with `zstd --decompress`"
            raise InputError(
                RECORDING_SEVERAL,
                "the listed file {unpacked_name} is missing{advice}.",
                listed,
                unpacked_name=unpacked.name,
                advice=advice,
            )
    return [file.with_suffix("") if file.suffix == ".zstd" else file for file in files]
