"""What became of each job: a file for each try that came to an end."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from scanloom.pipeline.batch.claims import Claim
from scanloom.pipeline.batch.whole import write_whole
from scanloom.stages.diagnostics.diagnostic import Diagnostic, Severity
from scanloom.stages.files.opening import text_in

# The states of a job; what is UNMET is written, and is not what was asked for.
DONE, UNMET, FAILED, UNUSABLE = "done", "unmet", "failed", "unusable"
# While there is no record.
WAITING, RUNNING = "waiting", "running"


@dataclass(frozen=True)
class Record:
    """What became of a scan.

    Attributes
    ----------
    state : one of the above; UNUSABLE where the scan cannot be read.
    reason : why it is not DONE, in one sentence.
    seconds : from its begin to its end.
    figures : what the tables and the page show of it, by name; empty where there is no result.
    """

    number: int
    name: str
    state: str
    reason: str = ""
    seconds: float = 0.0
    worker: str = ""
    attempt: int = 0
    diagnostics: tuple[Diagnostic, ...] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)

    @property
    def warnings(self) -> tuple[Diagnostic, ...]:
        """Return the warnings alone."""
        return tuple(one for one in self.diagnostics if one.severity is Severity.WARNING)


class Records:
    """The folder of records of a queue."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def write(self, record: Record) -> None:
        """Keep a record; another try at the same job has one of its own."""
        values = {**vars(record), "diagnostics": [one.figures() for one in record.diagnostics]}
        text = json.dumps(values, ensure_ascii=False, allow_nan=False)
        write_whole(self._path(Claim(record.number, record.attempt)), text.encode())

    def withdraw(self, claim: Claim) -> None:
        """Forget what became of a job by a try."""
        self._path(claim).unlink(missing_ok=True)

    def ended(self) -> dict[int, Claim]:
        """Return the last try that came to an end, of each job that has any; the folder is listed once.

        Where there are several, the last has taken over from the others.
        """
        found: dict[int, Claim] = {}
        for claim in self.all():
            if claim.attempt >= found.get(claim.number, claim).attempt:
                found[claim.number] = claim
        return found

    def all(self) -> list[Claim]:
        """Return every try that came to an end."""
        with os.scandir(self._folder) as names:
            parts = [one.name.split(".") for one in names if one.name.endswith(".json")]
        return [
            Claim(int(part[0]), int(part[1]))
            for part in parts
            if len(part) == 3 and part[0].isdigit() and part[1].isdigit()
        ]

    def read(self, claims: Iterable[Claim]) -> list[Record]:
        """Return the records of tries, by number; one that is damaged says so."""
        return sorted((self._record(claim) for claim in claims), key=lambda one: one.number)

    def _record(self, claim: Claim) -> Record:
        try:
            values = json.loads(text_in(self._path(claim), "utf-8"))
            known = {one.name: values[one.name] for one in fields(Record)}
            diagnostics = tuple(Diagnostic.from_figures(one) for one in known["diagnostics"])
            return Record(**{**known, "diagnostics": diagnostics})
        except (OSError, ValueError, LookupError, TypeError, RecursionError):
            why = f"what became of it is not known: {self._path(claim)} is damaged; run the batch again."
            return Record(claim.number, "", FAILED, why, attempt=claim.attempt)

    def _path(self, claim: Claim) -> Path:
        return self._folder / f"{claim.number:06d}.{claim.attempt}.json"
