"""Resolution of listed file paths from another computer or a renamed folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.files.path_safety import is_safe_relative_path
from scanloom.stages.scans.codes import SCAN_ASSUMED
from scanloom.stages.scans.image_folders.image_files import (
    COLOR_FOLDERS,
    IMAGE_SUFFIXES,
    is_valid_file_name,
    resolve_inside,
)

_LONGEST_SUFFIX = max(IMAGE_SUFFIXES, key=len)


def find_listed_images(folder: Path, names: Sequence[str], labels: Sequence[str], path: Path) -> list[Path]:
    """Find the images that a list names, even under other paths.

    Only the scan folder is searched. If paths had to be remapped, a warning says so. A missing image is
    returned as the path where it was expected.

    Parameters
    ----------
    folder : the scan folder.
    names : paths from the list; the file extension may be missing.
    labels : name of each entry in messages.
    path : the list.

    Raises
    ------
    InputError
        If no image is found and a name is not a relative path inside the folder.
    """
    found = [_find_by_path_end(folder, name) or _find_by_stem(folder, name) for name in names]
    if not any(found):
        return [resolve_inside(folder, name, label, path) for name, label in zip(names, labels, strict=True)]
    moved = [
        (name, file)
        for name, file in zip(names, found, strict=True)
        if file is not None and not _is_path_of(folder, name, file)
    ]
    files = [file or folder / _sanitise_last_part(name) for file, name in zip(found, names, strict=True)]
    if moved:
        name, file = moved[0]
        emit(
            SCAN_ASSUMED.warning(
                "{count} image paths in {list} point outside the scan or do not exist (such as {name!r}): "
                "the images are found by name instead ({file})",
                count=len(moved),
                list=path.name,
                name=name[:100],
                file=file.relative_to(folder).as_posix(),
            )
        )
    return files


def find_listed_file(folder: Path, name: object, label: str, path: Path) -> Path:
    """Find the file that a list names, even under another path.

    If the path points elsewhere, the file is found by the end of the path.

    Parameters
    ----------
    name : path from the list `path`.
    label : name of the entry in messages.

    Raises
    ------
    InputError
        If no file is found and the name is not a relative path inside the folder.
    """
    found = _find_by_path_end(folder, name) if isinstance(name, str) else None
    return found or resolve_inside(folder, name, label, path)


def _find_by_path_end(folder: Path, name: str) -> Path | None:
    """Return the file that matches the longest suffix of a path, or None."""
    parts = [part for part in _split_path(name) if part != ".."]
    for start in range(len(parts)):
        end = "/".join(parts[start:])
        if not is_safe_relative_path(end) or not all(
            is_valid_file_name(part + _LONGEST_SUFFIX) for part in parts[start:]
        ):
            continue
        file = folder / end
        if file.is_file():
            return file
        for suffix in IMAGE_SUFFIXES:
            if (image := file.with_name(file.name + suffix)).is_file():
                return image
    return None


def _find_by_stem(folder: Path, name: str) -> Path | None:
    """Return the only image with this stem, or None.

    The folder and its colour folders are searched.
    """
    stem = PurePosixPath(_sanitise_last_part(name)).stem
    found = {
        file
        for place in (folder, *(folder / one for one in COLOR_FOLDERS))
        for suffix in IMAGE_SUFFIXES
        if (file := place / (stem + suffix)).is_file()
    }
    return found.pop() if len(found) == 1 else None


def _is_path_of(folder: Path, name: str, file: Path) -> bool:
    """Return True if a listed path is the path of the file.

    The extension may be missing.
    """
    stated = PurePosixPath(name.replace("\\", "/")).as_posix()
    return file.relative_to(folder).as_posix() in (stated, stated + file.suffix)


def _sanitise_last_part(name: str) -> str:
    part = name.replace("\\", "/").rsplit("/", 1)[-1]
    return part if is_safe_relative_path(part) and is_valid_file_name(part + _LONGEST_SUFFIX) else "?"


def _split_path(name: str) -> tuple[str, ...]:
    path = PurePosixPath(name.replace("\\", "/"))
    return path.parts[1:] if path.is_absolute() else path.parts
