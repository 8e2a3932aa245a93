"""Result files in the output folder, and the record of which run placed them.

The folder never mixes files of different runs: before a stage is recomputed, its files and those after it are
removed. Only files that a run placed and nobody edited are removed or replaced; recorded digests distinguish
them from edited files. The record is in the cache, and also in report.json for folders that outlive their
cache.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from scanloom.pipeline.cache.atomic_files import copy_atomically, remove_abandoned_drafts, write_atomically
from scanloom.pipeline.cache.digest import compute_digest, compute_file_digest
from scanloom.pipeline.cache.entry import Entry
from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.error_conversion import convert_os_errors
from scanloom.pipeline.report.file_names import PAGE, REPORT
from scanloom.pipeline.report.page.single_file_page import is_page
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_OUTPUT_REFUSED
from scanloom.stages.files.input_files import read_input_text
from scanloom.stages.files.path_safety import is_safe_relative_path

_FORMAT_VERSION = 2


class OutputFolder:
    """Output folder of a run.

    Parameters
    ----------
    cache : stores the record: recipe and placed files of each stage.
    overwrite : also replace files that no run placed.
    """

    def __init__(self, cache: Cache, out: Path, *, overwrite: bool = False) -> None:
        self._cache = cache
        self._out = out
        self._overwrite = overwrite
        record = cache.read_latest_run(out)
        self._stages = (
            _select_valid_stages(record.get("stages")) if record.get("schema") == _FORMAT_VERSION else {}
        )
        self._keys: list[str] = []
        self._request: Mapping[str, Any] | None = None
        self._digests: dict[tuple[Path, int, int, int, int], str] = {}
        # Files placed by a run with another cache, or with a cache that was deleted.
        self._reported = _read_reported_digests(out / REPORT)

    def get_recorded_inputs(self, stage: str) -> Mapping[str, Any] | None:
        """Return the recorded inputs of the latest result of a stage.

        These are the recipe and the digests of input parts; None if not recorded.
        """
        decided: Mapping[str, Any] | None = self._stages.get(stage, {}).get("decided")
        return decided

    def record_entry(self, entry: Entry) -> None:
        """Record that this run uses a cache entry."""
        self._keys.append(entry.key)

    def record_request(self, request: Mapping[str, Any]) -> None:
        """Record the arguments of the run; see `scanloom.pipeline.run.run_request`."""
        self._request = request

    def check_replaceable(self, names: Iterable[str]) -> None:
        """Raise InputError if the run would replace a foreign file.

        A file is foreign if no run placed it.

        Parameters
        ----------
        names : file names in the folder; names of folders end in /, and their content is only
            checked when placed.

        Raises
        ------
        InputError
            For a file that is not in the record, or was edited since.
        """
        for name in names:
            path = self._out / name
            if name.endswith("/"):
                if os.path.lexists(path) and not path.is_dir():
                    self._refuse_replacing(path)
            elif os.path.lexists(path) and not self._is_own(name):
                self._refuse_replacing(path)

    def place_files(
        self, stage: str, entry: Entry, names: Iterable[str], inputs: Mapping[str, Any]
    ) -> tuple[Path, ...]:
        """Copy the files of a stage to the folder.

        Files with equal content are left untouched.

        Parameters
        ----------
        names : names of the entry's files to copy; names of folders end in /.
        inputs : recipe and input parts, for the record.

        Returns
        -------
        Paths of the files in the output folder.

        Raises
        ------
        InputError
            As `check_replaceable`.
        """
        names = tuple(names)
        files = {name: content for name, content in entry.files.items() if _matches_names(name, names)}
        with convert_os_errors(f"results cannot be written to {self._out}"):
            self._remove_files(stage, kept_names=files)
            wrong = [name for name, content in files.items() if not self._holds(name, content)]
            for name in wrong:
                path = self._out / name
                if os.path.lexists(path) and not self._is_own(name):
                    self._refuse_replacing(path)
                # Delete before the record is updated: if the run is killed here, every remaining file is
                # still recorded.
                if not path.is_dir():
                    path.unlink(missing_ok=True)
            # Record before copying: if the run is killed, its files are known to be replaceable.
            self._stages[stage] = {"decided": inputs, "placed": files}
            self._write_record()
            for name in files:
                path = self._out / name
                path.parent.mkdir(parents=True, exist_ok=True)
                remove_abandoned_drafts(path)
                if name in wrong:
                    copy_atomically(entry.folder / name, path)
        return tuple(self._out / name for name in files)

    def remove_stages(self, stages: Iterable[str]) -> None:
        """Remove the files of stages, the report and the page."""
        with convert_os_errors(f"outdated results cannot be removed from {self._out}"):
            for stage in (*stages, REPORT):
                self._remove_files(stage)
            self._remove_page()

    def remove_other_stages(self, stages: Collection[str]) -> None:
        """Remove the files of stages that are no longer part of the run."""
        known = {**(self._reported or {}), **self._stages}
        others = [name for name in known if name not in (*stages, REPORT, PAGE)]
        if any(self._list_placed(name) for name in others):
            self.remove_stages(others)
            for name in others:
                self._stages.setdefault(name, {})["placed"] = {}
            self._reported = {name: at for name, at in (self._reported or {}).items() if name in stages}

    def write_report(self, report: Mapping[str, Any]) -> dict[str, Any]:
        """Write report.json and return its content.

        Digests of all placed files and of the report itself are added.
        """
        recorded = {
            stage: about.get("placed", {})
            for stage, about in self._stages.items()
            if stage not in (REPORT, PAGE)
        }
        existing = {
            stage: {name: content for name, content in files.items() if (self._out / name).exists()}
            for stage, files in {**(self._reported or {}), **recorded}.items()
        }
        # Stages without files are left out: earlier runs of other stages must not show.
        placed = {stage: files for stage, files in existing.items() if files}
        # Round-trip through JSON, so that the digest matches the numbers a reader parses.
        document: dict[str, Any] = json.loads(_to_json({**report, "placed": placed}))
        document["digest"] = compute_digest(document)
        with convert_os_errors(f"results cannot be written to {self._out}"):
            write_atomically(self._out / REPORT, _to_json(document).encode())
            self._stages[REPORT] = {"placed": {REPORT: compute_file_digest(self._out / REPORT)}}
            self._write_record()
        return document

    def has_current_page(self, params_digest: str) -> bool:
        """Return True if the page is up to date; remove an outdated page.

        Parameters
        ----------
        params_digest : digest of the page parameters; results used by this run are added to it.
        """
        known = self._stages.get(PAGE, {})
        content = known.get("placed", {}).get(PAGE)
        if (
            known.get("of") == self._compute_page_digest(params_digest)
            and content
            and self._holds(PAGE, content)
        ):
            return True
        with convert_os_errors(f"an outdated page cannot be removed from {self._out}"):
            self._remove_page()
            self._stages.pop(PAGE, None)
            self._write_record()
        return False

    def write_page(self, page: bytes, params_digest: str) -> Path:
        """Write report.html; `params_digest` as for `has_current_page`."""
        path = self._out / PAGE
        with convert_os_errors(f"results cannot be written to {self._out}"):
            write_atomically(path, page)
            self._stages[PAGE] = {
                "placed": {PAGE: compute_file_digest(path)},
                "of": self._compute_page_digest(params_digest),
            }
            self._write_record()
        return path

    def _compute_page_digest(self, params_digest: str) -> str:
        return compute_digest([params_digest, *self._keys])

    def _remove_page(self) -> None:
        path = self._out / PAGE
        if path.is_file() and not path.is_symlink() and is_page(path):
            path.unlink()

    def _is_own(self, name: str) -> bool:
        path = self._out / name
        if path.is_symlink() or not path.is_file():
            return False
        if name == REPORT and self._reported is not None:
            return True
        if name == PAGE and is_page(path):
            return True
        return self._get_digest(path) in self._list_known_digests(name)

    def _list_placed(self, stage: str) -> set[str]:
        """Return the names of the files that runs placed for a stage."""
        return {*self._stages.get(stage, {}).get("placed", {}), *(self._reported or {}).get(stage, {})}

    def _list_known_digests(self, name: str) -> set[str]:
        """Return the digests of all recorded versions of a file."""
        recorded = [stage.get("placed", {}) for stage in self._stages.values()]
        return {at[name] for at in (*recorded, *(self._reported or {}).values()) if name in at}

    def _holds(self, name: str, content: str) -> bool:
        path = self._out / name
        return path.is_file() and self._get_digest(path) == content

    def _get_digest(self, path: Path) -> str:
        """Return the digest of a file, cached until its inode, size or times change."""
        found = path.stat()
        seen = (path, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns)
        if seen not in self._digests:
            self._digests[seen] = compute_file_digest(path)
        return self._digests[seen]

    def _refuse_replacing(self, path: Path) -> None:
        if not self._overwrite:
            raise InputError(
                FILE_OUTPUT_REFUSED,
                "this file was not written by a run, or was edited since",
                path,
                remedy="move it, choose another output folder, or give run.overwrite=true.",
            )

    def _write_record(self) -> None:
        record = {
            "schema": _FORMAT_VERSION,
            "keys": self._keys,
            "stages": self._stages,
            "asked": self._request,
        }
        self._cache.record_run(self._out, record)

    def _remove_files(self, stage: str, kept_names: Iterable[str] = ()) -> None:
        for name in sorted(self._list_placed(stage)):
            path = self._out / name
            if (
                name not in kept_names
                and path.is_file()
                and compute_file_digest(path) in self._list_known_digests(name)
            ):
                path.unlink()
                folder = path.parent
                while folder != self._out and not any(folder.iterdir()):
                    folder.rmdir()
                    folder = folder.parent


def _read_reported_digests(path: Path) -> dict[str, dict[str, str]] | None:
    """Read the digests in report.json, by stage and file name.

    Returns None if the report was edited.
    """
    try:
        document = json.loads(read_input_text(path, "utf-8"))
        sealed = document.pop("digest")
        placed = {stage: dict(files) for stage, files in document["placed"].items()}
        is_whole = compute_digest(document) == sealed
    except (InputError, OSError, RecursionError, ValueError, LookupError, TypeError, AttributeError):
        return None
    # The report is untrusted: only accept names inside the output folder.
    return placed if is_whole and all(map(_is_digest_mapping, placed.values())) else None


def _is_digest_mapping(files: Mapping[Any, Any]) -> bool:
    return all(
        isinstance(name, str) and isinstance(content, str) and is_safe_relative_path(name)
        for name, content in files.items()
    )


def _select_valid_stages(stages: object) -> dict[str, Any]:
    """Return the stages of a record, without invalid ones."""
    found = stages if isinstance(stages, dict) else {}
    return {
        name: stage for name, stage in found.items() if _has_placed_files(stage) and _has_valid_inputs(stage)
    }


def _has_placed_files(stage: object) -> bool:
    placed = stage.get("placed") if isinstance(stage, dict) else None
    return isinstance(placed, dict) and all(map(is_safe_relative_path, placed))


def _has_valid_inputs(stage: Mapping[str, Any]) -> bool:
    """Return True if a recorded recipe has a valid structure.

    The record of a report has no recipe, which is valid.
    """
    if "decided" not in stage:
        return True
    decided = stage["decided"]
    recipe, parts = (
        (decided.get(key) for key in ("recipe", "parts")) if isinstance(decided, dict) else (None, None)
    )
    if (
        not isinstance(recipe, dict)
        or not _is_mapping_of_mappings(parts)
        or not _is_mapping_of_mappings(recipe.get("params"))
    ):
        return False
    return (
        all(isinstance(recipe.get(key, {}), dict) for key in ("versions", "libraries"))
        and "libraries" in recipe
    )


def _is_mapping_of_mappings(value: object) -> bool:
    return isinstance(value, dict) and all(isinstance(table, dict) for table in value.values())


def _matches_names(name: str, wanted: tuple[str, ...]) -> bool:
    return any(name == want or (want.endswith("/") and name.startswith(want)) for want in wanted)


def _to_json(report: Mapping[str, Any]) -> str:
    """Format a report as indented JSON."""
    return json.dumps(report, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
