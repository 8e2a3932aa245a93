"""Cache entry of a stage result: recipe, files, and a manifest with their digests.

    fuse/<key>/
      fused.ply …         files written by the stage
      manifest.json       recipe, size and digest of each file, metrics, diagnostics, and a digest of the
      manifest
      in-use.lock         see scanloom.pipeline.cache.store

The manifest is written last: a folder without a manifest is not an entry.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from scanloom.pipeline.cache.atomic_files import flush_all
from scanloom.pipeline.cache.digest import compute_digest, compute_file_digests
from scanloom.pipeline.cache.locks import FileLock
from scanloom.pipeline.cache.system import flush
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.files.input_files import read_input_text

# Increase when the meaning of keys or the format of entries changes; older entries then miss.
FORMAT_VERSION = 4

MANIFEST = "manifest.json"
IN_USE_LOCK = "in-use.lock"


@dataclass(frozen=True)
class Recipe:
    """Everything that determines the result of a stage; its digest is the cache key.

    Attributes
    ----------
    stage : name of the stage.
    versions : RESULT_VERSION of each module the stage runs, by module name.
    params : canonical parameters by section.
    inputs : content digests of the inputs by name.
    libraries : versions of the libraries that affect the result.
    """

    stage: str
    versions: Mapping[str, int]
    params: Mapping[str, Any] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    libraries: Mapping[str, str] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """Cache key: digest that names the entry."""
        return compute_digest({"schema": FORMAT_VERSION, **self.to_json()})

    def to_json(self) -> dict[str, Any]:
        """Return the recipe as JSON values."""
        return {
            name: dict(value) if isinstance(value, Mapping) else value for name, value in vars(self).items()
        }


class Entry:
    """Complete, verified entry, protected from removal until closed.

    Attributes
    ----------
    folder : folder of the files; read-only.
    manifest : content of manifest.json.
    """

    def __init__(self, folder: Path, manifest: dict[str, Any], lock: FileLock) -> None:
        self.folder = folder
        self.manifest = manifest
        self._lock = lock

    @property
    def key(self) -> str:
        """Digest of the recipe."""
        return self.folder.name

    @property
    def files(self) -> dict[str, str]:
        """SHA-256 of each file, by path relative to the folder."""
        return {name: about["sha256"] for name, about in self.manifest["files"].items()}

    @property
    def digest(self) -> str:
        """Content digest of the whole entry, used in the cache keys of later stages."""
        return compute_digest(self.files)

    @property
    def metrics(self) -> dict[str, Any]:
        """Metrics and statistics returned by the stage."""
        metrics: dict[str, Any] = self.manifest["metrics"]
        return metrics

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Diagnostics emitted when the result was computed."""
        return tuple(Diagnostic.from_dict(one) for one in self.manifest.get("diagnostics", ()))

    def close(self) -> None:
        """Release the entry, which other processes may then remove."""
        self._lock.release()


class DamagedEntryError(Exception):
    """Entry that does not match its manifest."""


def complete_entry(draft: Path, recipe: Recipe, record: Mapping[str, Any]) -> None:
    """Complete a draft: flush its files and write the manifest."""
    paths = sorted(path for path in draft.rglob("*") if path.is_file() and path != draft / IN_USE_LOCK)
    names = [path.relative_to(draft).as_posix() for path in paths]
    flush_all(paths)
    files = {
        name: {"size": path.stat().st_size, "sha256": content}
        for name, path, content in zip(names, paths, compute_file_digests(paths), strict=True)
    }
    manifest = {
        "schema": FORMAT_VERSION,
        "recipe": recipe.to_json(),
        "files": files,
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        **record,
    }
    text = json.dumps({**manifest, "digest": compute_digest(manifest)}, indent=1)
    (draft / MANIFEST).write_text(text, encoding="utf-8", newline="\n")
    flush(draft / MANIFEST)
    flush_all([*(path for path in draft.rglob("*") if path.is_dir()), draft])


def verify_entry(folder: Path) -> dict[str, Any]:
    """Read the manifest of an entry and verify all files; raise DamagedEntryError."""
    manifest = read_manifest(folder)
    names = list(manifest["files"])
    inside = Path(os.path.realpath(folder))
    for name in names:
        # Links are rejected: they could expose or overwrite files outside the cache.
        if Path(os.path.realpath(folder / name)) != inside / name:
            raise DamagedEntryError(f"{name} is a link")
        if not (folder / name).is_file():
            raise DamagedEntryError(f"{name} is missing")
        if (folder / name).stat().st_size != manifest["files"][name]["size"]:
            raise DamagedEntryError(f"{name} has another size")
    try:
        contents = compute_file_digests([folder / name for name in names])
    except OSError as error:
        raise DamagedEntryError(f"{error.filename} cannot be read: {error.strerror}") from error
    for name, content in zip(names, contents, strict=True):
        if content != manifest["files"][name]["sha256"]:
            raise DamagedEntryError(f"{name} was modified")
    return manifest


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read the manifest of an entry without checking its files; raise DamagedEntryError."""
    try:
        manifest: dict[str, Any] = json.loads(_read_text(folder / MANIFEST))
        sealed = manifest.pop("digest")
        if compute_digest(manifest) != sealed:
            raise DamagedEntryError(f"{MANIFEST} was modified")
        if compute_digest({"schema": manifest["schema"], **manifest["recipe"]}) != folder.name:
            raise DamagedEntryError(f"{MANIFEST} belongs to another entry")
    except OSError as error:
        raise DamagedEntryError(f"{MANIFEST} cannot be read: {error.strerror}") from error
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise DamagedEntryError(f"{MANIFEST} is not a manifest") from error
    return manifest


def _read_text(path: Path) -> str:
    if path.is_symlink():
        raise DamagedEntryError(f"{path.name} is a link")
    return read_input_text(path, "utf-8")
