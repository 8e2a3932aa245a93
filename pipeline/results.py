"""The files a person finds in the output folder, under plain names, and the record of what put them there.

The folder never shows files of different runs side by side: before a stage works anew, its files and those
of all later stages leave the folder. Only what a run placed there, and nobody changed since, is removed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from pipeline.cache import Cache
from pipeline.digest import file_digest
from pipeline.entry import Entry
from pipeline.failures import explained
from pipeline.files import copy_whole, has_content, remove_abandoned, write_whole

REPORT = "report.json"
_FORMAT_VERSION = 1


class Results:
    """An output folder.

    Parameters
    ----------
    cache : keeps the record: what decided each stage's result, and which files were placed.
    """

    def __init__(self, cache: Cache, out: Path) -> None:
        self._cache = cache
        self._out = out
        record = cache.latest_run(out)
        self._stages: dict[str, Any] = record["stages"] if record.get("schema") == _FORMAT_VERSION else {}
        self._keys: list[str] = []

    def decided(self, stage: str) -> Mapping[str, Any] | None:
        """Return what was recorded as deciding a stage's latest result; None if it never got here."""
        decided: Mapping[str, Any] | None = self._stages.get(stage, {}).get("decided")
        return decided

    def keep(self, entry: Entry) -> None:
        """Record that this run uses an entry."""
        self._keys.append(entry.key)

    def place(
        self, stage: str, entry: Entry, wanted: Iterable[str], decided: Mapping[str, Any]
    ) -> tuple[Path, ...]:
        """Copy a stage's files into the folder, unless they are there with the same content.

        Parameters
        ----------
        wanted : names of the entry's files; one that ends in / is a folder of them.
        decided : what decided the result, for the record.
        """
        wanted = tuple(wanted)
        files = {name: content for name, content in entry.files.items() if _is_wanted(name, wanted)}
        with explained(f"results cannot be written to {self._out}"):
            self._remove(stage, besides=files)
            # Recorded first: whatever a killed run leaves in the folder is known to be ours.
            self._stages[stage] = {"decided": decided, "placed": files}
            self._remember()
            for name, content in files.items():
                source, path = entry.folder / name, self._out / name
                path.parent.mkdir(parents=True, exist_ok=True)
                remove_abandoned(path)
                if not has_content(path, source.stat().st_size, content):
                    copy_whole(source, path)
        return tuple(self._out / name for name in files)

    def withdraw(self, stages: Iterable[str]) -> None:
        """Remove the files of these stages, and the report that tells of them, from the folder."""
        with explained(f"outdated results cannot be removed from {self._out}"):
            for stage in (*stages, REPORT):
                self._remove(stage)

    def withdraw_others(self, stages: Collection[str]) -> None:
        """Remove the files of stages that a run has no more, if there are any."""
        others = [name for name in self._stages if name not in stages and name != REPORT]
        if any(self._stages[name]["placed"] for name in others):
            self.withdraw(others)
            for name in others:
                self._stages[name]["placed"] = {}

    def write_report(self, text: str) -> Path:
        """Write report.json."""
        with explained(f"results cannot be written to {self._out}"):
            write_whole(self._out / REPORT, text.encode())
            self._stages[REPORT] = {"placed": {REPORT: file_digest(self._out / REPORT)}}
            self._remember()
        return self._out / REPORT

    def _remember(self) -> None:
        record = {"schema": _FORMAT_VERSION, "keys": self._keys, "stages": self._stages}
        self._cache.remember_run(self._out, record)

    def _remove(self, stage: str, besides: Iterable[str] = ()) -> None:
        placed = self._stages.get(stage, {}).get("placed", {})
        for name, content in placed.items():
            path = self._out / name
            if name not in besides and path.is_file() and file_digest(path) == content:
                path.unlink()
                if path.parent != self._out and not any(path.parent.iterdir()):
                    path.parent.rmdir()


def _is_wanted(name: str, wanted: tuple[str, ...]) -> bool:
    return any(name == want or (want.endswith("/") and name.startswith(want)) for want in wanted)
