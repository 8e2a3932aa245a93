"""Scan discovery: find the scans in a folder tree."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from scanloom.pipeline.batch.codes import BATCH_SCANS_NOT_DONE
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import SCAN_LAYOUT_UNKNOWN
from scanloom.stages.scans.layout_table import LAYOUTS
from scanloom.stages.scans.reader import find_layout

# Suffixes of single-file scans (recordings).
_RECORDING_SUFFIXES = frozenset(suffix for one in LAYOUTS for suffix in one.suffixes)
# A folder with this file is a single ROS 2 recording, possibly split into several files.
_ROS2_METADATA = "metadata.yaml"
# Maximum folder depth of the search.
_MAX_DEPTH = 8


@dataclass(frozen=True)
class FoundScan:
    """Scan found by the search.

    Attributes
    ----------
    path : scan folder or file.
    name : path relative to the searched folder, with / separators; also the name of its results.
    layout : name of the layout.
    """

    path: Path
    name: str
    layout: str


@dataclass(frozen=True)
class FolderWithoutScan:
    """Folder that contains no scan, with the reason."""

    path: Path
    reason: str


def find_scans(
    folder: Path,
    *,
    layout: str | None = None,
    include: Sequence[str] = (),
    exclude: Sequence[str] = (),
    excluded_folders: Collection[Path] = (),
) -> tuple[list[FoundScan], list[FolderWithoutScan]]:
    """Search a folder for scans.

    Folders inside a recognised scan are not searched. Links are followed, each target once.

    Parameters
    ----------
    layout : take every subfolder for a scan of this layout, recognised or not.
    include, exclude : patterns of scan names (`*`, `?`). Scans must match one of `include`, if given, and
        none of `exclude`.
    excluded_folders : folders that are not searched.

    Returns
    -------
    Scans sorted by name, and folders without a scan sorted by path.

    Raises
    ------
    InputError
        If the folder cannot be listed.
    """
    _check_listable(folder)
    seen = {os.path.realpath(one) for one in excluded_folders}
    found: list[FoundScan] = []
    others: list[FolderWithoutScan] = []
    for one in (
        _list_stated_scans(folder, layout, seen) if layout else _search_folder(folder, folder, seen, 0)
    ):
        if isinstance(one, FolderWithoutScan):
            others.append(one)
        elif _matches_patterns(one.name, include, exclude):
            found.append(one)
    return sorted(found, key=lambda one: one.name), sorted(others, key=lambda one: one.path)


def _list_stated_scans(folder: Path, layout: str, seen: set[str]) -> Iterator[FoundScan]:
    for place in _list_folders(folder):
        if os.path.realpath(place) not in seen:
            yield FoundScan(place, place.name, layout)


def _search_folder(
    path: Path, top: Path, seen: set[str], depth: int
) -> Iterator[FoundScan | FolderWithoutScan]:
    real = os.path.realpath(path)
    if real in seen:
        return
    seen.add(real)
    why = "its layout is unknown" if _list_entries(path) else "it is empty"
    try:
        matched = find_layout(path)
    except InputError as error:
        matched, why = None, str(error).removeprefix(f"{path}: ")
    files = _list_recordings(path)
    if matched is not None and not (files and _is_collection(path, matched[1], files)):
        yield FoundScan(path, _make_scan_name(path, top), matched[0].name)
        return
    inside: list[FoundScan | FolderWithoutScan] = [
        FoundScan(file, _make_scan_name(file, top), _get_layout(file)) for file in files
    ]
    if depth < _MAX_DEPTH:
        for child in _list_folders(path):
            inside += _search_folder(child, top, seen, depth + 1)
    if any(isinstance(one, FoundScan) for one in inside) or path == top:
        yield from inside
    else:
        # One report for the whole subtree.
        yield FolderWithoutScan(path, why)


def _is_collection(path: Path, reason: str, files: Sequence[Path]) -> bool:
    """Return True if a folder is a collection of recordings instead of a scan.

    The layout detection accepts such a folder because of one of its recordings.
    """
    if reason not in {file.name for file in files}:
        return False
    if (path / _ROS2_METADATA).is_file():
        return False
    return len(files) > 1 or any(_holds_scan(child) for child in _list_folders(path))


def _holds_scan(folder: Path) -> bool:
    try:
        return find_layout(folder) is not None
    except InputError:
        return False


def _get_layout(file: Path) -> str:
    return next(one.name for one in LAYOUTS if file.suffix.lower() in one.suffixes)


def _list_recordings(folder: Path) -> list[Path]:
    return [
        path
        for path in _list_entries(folder)
        if path.suffix.lower() in _RECORDING_SUFFIXES and path.is_file()
    ]


def _list_folders(folder: Path) -> list[Path]:
    return [path for path in _list_entries(folder) if path.is_dir()]


def _list_entries(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except OSError:
        return []


def _check_listable(folder: Path) -> None:
    if not folder.is_dir():
        what = "this is a file" if folder.exists() else "there is no such folder"
        raise InputError(
            BATCH_SCANS_NOT_DONE,
            "{what}",
            folder,
            remedy="give the folder of the scans.",
            what=what,
        )
    try:
        next(folder.iterdir(), None)
    except OSError as error:
        raise InputError(
            SCAN_LAYOUT_UNKNOWN, "the folder cannot be listed ({strerror}).", folder, strerror=error.strerror
        ) from error


def _make_scan_name(path: Path, top: Path) -> str:
    return path.name if path == top else path.relative_to(top).as_posix()


def _matches_patterns(name: str, include: Sequence[str], exclude: Sequence[str]) -> bool:
    if include and not any(fnmatchcase(name, pattern) for pattern in include):
        return False
    return not any(fnmatchcase(name, pattern) for pattern in exclude)
