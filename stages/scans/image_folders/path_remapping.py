"""Resolution of listed file paths from another computer or a renamed folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.files.inside import leads_inside
from scanloom.stages.scans.codes import SCAN_ASSUMED
from scanloom.stages.scans.image_folders.image_files import COLOR_FOLDERS, IMAGES, inside, is_name

_LONGEST = max(IMAGES, key=len)


def found_images(folder: Path, names: Sequence[str], labels: Sequence[str], path: Path) -> list[Path]:
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
    found = [_by_end(folder, name) or _by_stem(folder, name) for name in names]
    if not any(found):
        return [inside(folder, name, label, path) for name, label in zip(names, labels, strict=True)]
    moved = [
        (name, file)
        for name, file in zip(names, found, strict=True)
        if file is not None and not _is_path_of(folder, name, file)
    ]
    files = [file or folder / _last_part(name) for file, name in zip(found, names, strict=True)]
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


def found_file(folder: Path, name: object, what: str, path: Path) -> Path:
    """Find the file that a list names, even under another path.

    If the path points elsewhere, the file is found by the end of the path.

    Parameters
    ----------
    name : path from the list `path`.
    what : name of the entry in messages.

    Raises
    ------
    InputError
        If no file is found and the name is not a relative path inside the folder.
    """
    found = _by_end(folder, name) if isinstance(name, str) else None
    return found or inside(folder, name, what, path)


def _by_end(folder: Path, name: str) -> Path | None:
    """Return the file that matches the longest suffix of a path, or None."""
    parts = [part for part in _parts(name) if part != ".."]
    for start in range(len(parts)):
        end = "/".join(parts[start:])
        if not leads_inside(end) or not all(is_name(part + _LONGEST) for part in parts[start:]):
            continue
        file = folder / end
        if file.is_file():
            return file
        for suffix in IMAGES:
            if (image := file.with_name(file.name + suffix)).is_file():
                return image
    return None


def _by_stem(folder: Path, name: str) -> Path | None:
    """Return the only image with this stem, or None.

    The folder and its colour folders are searched.
    """
    stem = PurePosixPath(_last_part(name)).stem
    found = {
        file
        for place in (folder, *(folder / one for one in COLOR_FOLDERS))
        for suffix in IMAGES
        if (file := place / (stem + suffix)).is_file()
    }
    return found.pop() if len(found) == 1 else None


def _is_path_of(folder: Path, name: str, file: Path) -> bool:
    """Return True if a listed path is the path of the file.

    The extension may be missing.
    """
    stated = PurePosixPath(name.replace("\\", "/")).as_posix()
    return file.relative_to(folder).as_posix() in (stated, stated + file.suffix)


def _last_part(name: str) -> str:
    part = name.replace("\\", "/").rsplit("/", 1)[-1]
    return part if leads_inside(part) and is_name(part + _LONGEST) else "?"


def _parts(name: str) -> tuple[str, ...]:
    path = PurePosixPath(name.replace("\\", "/"))
    return path.parts[1:] if path.is_absolute() else path.parts
