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
from scanloom.stages.scans.read import matching
from scanloom.stages.scans.table import LAYOUTS

# Suffixes of single-file scans (recordings).
_SUFFIXES = frozenset(suffix for one in LAYOUTS for suffix in one.suffixes)
# A folder with this file is a single ROS 2 recording, possibly split into several files.
_LIST = "metadata.yaml"
# Maximum folder depth of the search.
_DEEPEST = 8


@dataclass(frozen=True)
class Found:
    """Scan found by the search.

    Attributes
    ----------
    place : scan folder or file.
    name : path relative to the searched folder, with / separators; also the name of its results.
    layout : name of the layout.
    """

    place: Path
    name: str
    layout: str


@dataclass(frozen=True)
class NoScan:
    """Folder that contains no scan, with the reason."""

    place: Path
    reason: str


def find_scans(
    folder: Path,
    *,
    layout: str | None = None,
    include: Sequence[str] = (),
    exclude: Sequence[str] = (),
    besides: Collection[Path] = (),
) -> tuple[list[Found], list[NoScan]]:
    """Search a folder for scans.

    Folders inside a recognised scan are not searched. Links are followed, each target once.

    Parameters
    ----------
    layout : take every subfolder for a scan of this layout, recognised or not.
    include, exclude : patterns of scan names (`*`, `?`). Scans must match one of `include`, if given, and
        none of `exclude`.
    besides : folders that are not searched.

    Returns
    -------
    Scans sorted by name, and folders without a scan sorted by path.

    Raises
    ------
    InputError
        If the folder cannot be listed.
    """
    _require_listed(folder)
    seen = {os.path.realpath(one) for one in besides}
    found: list[Found] = []
    others: list[NoScan] = []
    for one in _stated(folder, layout, seen) if layout else _searched(folder, folder, seen, 0):
        if isinstance(one, NoScan):
            others.append(one)
        elif _is_wanted(one.name, include, exclude):
            found.append(one)
    return sorted(found, key=lambda one: one.name), sorted(others, key=lambda one: one.place)


def _stated(folder: Path, layout: str, seen: set[str]) -> Iterator[Found]:
    for place in _folders(folder):
        if os.path.realpath(place) not in seen:
            yield Found(place, place.name, layout)


def _searched(place: Path, top: Path, seen: set[str], depth: int) -> Iterator[Found | NoScan]:
    real = os.path.realpath(place)
    if real in seen:
        return
    seen.add(real)
    why = "its layout is unknown" if _listed(place) else "it is empty"
    try:
        matched = matching(place)
    except InputError as error:
        matched, why = None, str(error).removeprefix(f"{place}: ")
    files = _files(place)
    if matched is not None and not (files and _is_collection(place, matched[1], files)):
        yield Found(place, _name(place, top), matched[0].name)
        return
    inside: list[Found | NoScan] = [Found(file, _name(file, top), _layout_of(file)) for file in files]
    if depth < _DEEPEST:
        for child in _folders(place):
            inside += _searched(child, top, seen, depth + 1)
    if any(isinstance(one, Found) for one in inside) or place == top:
        yield from inside
    else:
        # One report for the whole subtree.
        yield NoScan(place, why)


def _is_collection(place: Path, reason: str, files: Sequence[Path]) -> bool:
    """Return True if a folder only collects recordings.

    Such a folder is recognised as a scan because of a recording in it.
    """
    if reason not in {file.name for file in files}:
        return False
    if (place / _LIST).is_file():
        return False
    return len(files) > 1 or any(_holds_scan(child) for child in _folders(place))


def _holds_scan(folder: Path) -> bool:
    try:
        return matching(folder) is not None
    except InputError:
        return False


def _layout_of(file: Path) -> str:
    return next(one.name for one in LAYOUTS if file.suffix.lower() in one.suffixes)


def _files(folder: Path) -> list[Path]:
    return [path for path in _listed(folder) if path.suffix.lower() in _SUFFIXES and path.is_file()]


def _folders(folder: Path) -> list[Path]:
    return [path for path in _listed(folder) if path.is_dir()]


def _listed(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except OSError:
        return []


def _require_listed(folder: Path) -> None:
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


def _name(place: Path, top: Path) -> str:
    return place.name if place == top else place.relative_to(top).as_posix()


def _is_wanted(name: str, include: Sequence[str], exclude: Sequence[str]) -> bool:
    if include and not any(fnmatchcase(name, pattern) for pattern in include):
        return False
    return not any(fnmatchcase(name, pattern) for pattern in exclude)
