"""Checks on the paths a person typed, made before the work starts rather than after it."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stages.diagnostics.errors import InputError, UsageError
from stages.files.moving import move

# What stages.surface.mesh_files.write_mesh can write.
MESH_SUFFIXES = (".ply", ".obj", ".off", ".stl", ".glb", ".gltf")


def require_scan(folder: Path) -> Path:
    """Return the folder of a scan, or the file that is one, or say that there is none."""
    if not folder.exists():
        raise InputError("there is no such folder or file; give that of a scan.", folder)
    return folder


def require_file(path: Path) -> Path:
    """Return the path of a file, or say that it is none."""
    if not path.exists():
        raise InputError("there is no such file.", path)
    if path.is_dir():
        raise InputError("this is a folder; give a mesh file.", path)
    return path


def require_new_file(path: Path, suffixes: tuple[str, ...]) -> Path:
    """Check that a result can be written to the path; nothing is made yet.

    Raises
    ------
    UsageError
        For an extension that stands for no format.
    InputError
        If the path is a folder, or its folder cannot be made or written to.
    """
    if path.suffix.lower() not in suffixes:
        known = ", ".join(suffixes)
        raise UsageError(
            f"{path}: the extension {path.suffix or '(none)'} stands for no format; use {known}."
        )
    if path.is_dir():
        raise InputError("this is a folder; give the name of a file.", path)
    require_writable(path.parent)
    return path


def require_writable(folder: Path) -> Path:
    """Check that a folder can be written to or, if it does not exist, that it can be made."""
    there = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not there.is_dir():
        raise InputError("this is a file; results need a folder.", there)
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError("this folder cannot be written to; choose another.", there)
    return folder


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Give a temporary folder beside `path` that takes its name when the block ends well, or else is removed.

    Raises
    ------
    InputError
        If there is something at `path` already, other than an empty folder.
    """
    if path.is_dir() and any(path.iterdir()):
        raise InputError("this folder is not empty; name a new one.", path)
    parent = require_writable(path).absolute().parent
    parent.mkdir(parents=True, exist_ok=True)
    draft = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=parent))
    try:
        yield draft
        draft.chmod(0o777 & ~_umask())  # mkdtemp keeps a folder to its owner
        move(draft, path)
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
