"""Checks of paths before the work starts."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files.atomic_rename import rename_atomically
from scanloom.stages.files.codes import FILE_PATH_INVALID
from scanloom.stages.surface.codes import USAGE_EXTENSION_UNKNOWN

# Extensions that `write_mesh` can write.
MESH_SUFFIXES = (".ply", ".obj", ".off", ".stl", ".glb", ".gltf")


def require_scan(folder: Path) -> Path:
    """Return the path of a scan, which is a folder or a file, if it exists."""
    if not folder.exists():
        raise InputError(
            FILE_PATH_INVALID,
            "there is no such folder or file",
            folder,
            remedy="give a scan folder or recording.",
        )
    return folder


def require_file(path: Path) -> Path:
    """Return the path of a file, if it exists."""
    if not path.exists():
        raise InputError(FILE_PATH_INVALID, "there is no such file.", path)
    if path.is_dir():
        raise InputError(FILE_PATH_INVALID, "this is a folder", path, remedy="give a mesh file.")
    return path


def require_new_file(path: Path, suffixes: tuple[str, ...]) -> Path:
    """Check that a result can be written to a path.

    Raises
    ------
    UsageError
        If the extension is unknown.
    InputError
        If the path is a folder, or its folder cannot be created or written to.
    """
    if path.suffix.lower() not in suffixes:
        known = ", ".join(suffixes)
        raise UsageError(
            USAGE_EXTENSION_UNKNOWN,
            "unknown file extension {detail}",
            remedy="use {known}.",
            where=path,
            detail=path.suffix or "(none)",
            known=known,
        )
    if path.is_dir():
        raise InputError(FILE_PATH_INVALID, "this is a folder", path, remedy="give the name of a file.")
    require_writable(path.parent)
    return path


def require_writable(folder: Path) -> Path:
    """Check that a folder can be written to or, if it does not exist, created."""
    there = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not there.is_dir():
        raise InputError(FILE_PATH_INVALID, "this is a file; results need a folder.", there)
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(
            FILE_PATH_INVALID, "this folder cannot be written to", there, remedy="choose another."
        )
    return folder


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder that is renamed to `path` if the block succeeds, and removed otherwise.

    Raises
    ------
    InputError
        If `path` exists and is not an empty folder.
    """
    if path.is_dir() and any(path.iterdir()):
        raise InputError(FILE_PATH_INVALID, "this folder is not empty", path, remedy="name a new one.")
    parent = require_writable(path).absolute().parent
    parent.mkdir(parents=True, exist_ok=True)
    draft = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=parent))
    try:
        yield draft
        draft.chmod(0o777 & ~_umask())  # mkdtemp gives access to the owner only
        rename_atomically(draft, path)
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
