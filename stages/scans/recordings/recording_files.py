"""Files of a ROS recording: one file, or those in metadata.yaml."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.codes import RECORDING_SEVERAL
from scanloom.stages.scans.image_folders.image_files import find_first_existing

RECORDING_SUFFIXES = (".bag", ".db3", ".mcap")
_METADATA_FILE = "metadata.yaml"
_INFORMATION_KEY, _FILES_KEY = "rosbag2_bagfile_information", "relative_file_paths"


def list_recordings(folder: Path) -> list[Path]:
    """Return the recording files in a folder, sorted by suffix and name."""
    return sorted(file for suffix in RECORDING_SUFFIXES for file in folder.glob(f"*{suffix}"))


def find_recording_files(source: Path) -> Sequence[Path]:
    """Return the files of a recording in recording order.

    Parameters
    ----------
    source : a recording file, or a folder.

    Raises
    ------
    InputError
        If the folder holds no recording or several, or a listed file is missing.
    """
    if source.is_file():
        return [source]
    listed = find_first_existing(source, _METADATA_FILE)
    if listed is not None and (files := _read_file_list(listed)):
        return files
    files = list_recordings(source)
    if len(files) != 1:
        kinds = ", ".join(RECORDING_SUFFIXES)
        found = f"no recording ({kinds})" if not files else f"{len(files)} recordings"
        raise InputError(
            RECORDING_SEVERAL,
            "the folder has {found}",
            source,
            remedy="give the recording to read.",
            found=found,
        )
    return files


def _read_file_list(metadata_file: Path) -> list[Path]:
    """Return the files that a ROS 2 metadata.yaml lists.

    Empty for any other YAML file.
    """
    information = documents.read_document(metadata_file).get(_INFORMATION_KEY)
    names = information.get(_FILES_KEY) if isinstance(information, dict) else None
    if not isinstance(names, list) or not all(isinstance(name, str) and name for name in names):
        return []
    # Early versions prefix each path with the name of the folder.
    files = [
        metadata_file.parent / PurePosixPath(documents.require_inside(name, metadata_file, _FILES_KEY)).name
        for name in names
    ]
    for file in files:
        # After manual decompression, the list still names the compressed files.
        unpacked = file.with_suffix("") if file.suffix == ".zstd" else file
        if not unpacked.is_file():
            advice = "" if unpacked == file else f"; decompress {file.name} with `zstd --decompress`"
            raise InputError(
                RECORDING_SEVERAL,
                "the listed file {unpacked_name} is missing{advice}.",
                metadata_file,
                unpacked_name=unpacked.name,
                advice=advice,
            )
    return [file.with_suffix("") if file.suffix == ".zstd" else file for file in files]
