"""Outcomes of jobs: one file per finished attempt."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from scanloom.pipeline.batch.atomic_write import write_atomically_unlocked
from scanloom.pipeline.batch.claims import Claim, parse_claim
from scanloom.stages.diagnostics.diagnostic import Diagnostic, Severity
from scanloom.stages.files.input_files import read_input_text

# States of a finished job. UNMET: there is a result, but requirements were not met.
DONE, UNMET, FAILED, UNUSABLE = "done", "unmet", "failed", "unusable"
# States of a job without a record.
WAITING, RUNNING = "waiting", "running"


@dataclass(frozen=True)
class JobRecord:
    """Outcome of a job.

    Attributes
    ----------
    state : DONE, UNMET, FAILED, or UNUSABLE if the scan cannot be read; WAITING or RUNNING before the end.
    reason : one sentence why the state is not DONE.
    seconds : duration of the job.
    worker : name of the worker.
    attempt : attempt number, from 0.
    metrics : metrics for the tables and the page, by name; empty without a result.
    """

    number: int
    name: str
    state: str
    reason: str = ""
    seconds: float = 0.0
    worker: str = ""
    attempt: int = 0
    diagnostics: tuple[Diagnostic, ...] = ()
    metrics: Mapping[str, Any] = field(default_factory=dict)

    @property
    def warnings(self) -> tuple[Diagnostic, ...]:
        """Diagnostics of severity WARNING."""
        return tuple(one for one in self.diagnostics if one.severity is Severity.WARNING)


def _require_valid(record: JobRecord, claim: Claim) -> None:
    """Raise ValueError if a record has values that no worker writes; it is read from a shared folder."""
    texts = (record.name, record.reason, record.worker)
    details = ((one.message, one.remedy or "", one.code) for one in record.diagnostics)
    if not (
        (record.number, record.attempt) == (claim.number, claim.attempt)
        and record.state in (DONE, UNMET, FAILED, UNUSABLE)
        and all(isinstance(text, str) for text in (*texts, *(text for one in details for text in one)))
        and type(record.seconds) in (int, float)
        and math.isfinite(record.seconds)
        and isinstance(record.metrics, dict)
    ):
        raise ValueError("a value of the record is invalid")


class JobRecords:
    """Folder of job records of a queue."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def write(self, record: JobRecord) -> None:
        """Write the record of an attempt."""
        values = {**vars(record), "diagnostics": [one.to_dict() for one in record.diagnostics]}
        text = json.dumps(values, ensure_ascii=False, allow_nan=False)
        write_atomically_unlocked(self._get_path(Claim(record.number, record.attempt)), text.encode())

    def delete_record(self, claim: Claim) -> None:
        """Delete the record of an attempt."""
        self._get_path(claim).unlink(missing_ok=True)

    def list_ended(self) -> dict[int, Claim]:
        """List the folder once and return the last finished attempt of each job.

        If several attempts finished, the last one had taken over the job from the others.
        """
        found: dict[int, Claim] = {}
        for claim in self.list_finished():
            if claim.attempt >= found.get(claim.number, claim).attempt:
                found[claim.number] = claim
        return found

    def list_finished(self) -> list[Claim]:
        """List all finished attempts."""
        with os.scandir(self._folder) as names:
            parts = [one.name.split(".") for one in names if one.name.endswith(".json")]
        claims = [parse_claim(".".join(part[:2])) for part in parts if len(part) == 3]
        return [claim for claim in claims if claim is not None]

    def read_records(self, claims: Iterable[Claim]) -> list[JobRecord]:
        """Read the records of attempts, sorted by job number.

        A damaged record becomes a failure record.
        """
        return sorted((self._read_record(claim) for claim in claims), key=lambda one: one.number)

    def _read_record(self, claim: Claim) -> JobRecord:
        try:
            values = json.loads(read_input_text(self._get_path(claim), "utf-8"))
            known = {one.name: values[one.name] for one in fields(JobRecord)}
            diagnostics = tuple(Diagnostic.from_dict(one) for one in known["diagnostics"])
            record = JobRecord(**{**known, "diagnostics": diagnostics})
            _require_valid(record, claim)
            return record
        except (OSError, ValueError, LookupError, TypeError, RecursionError):
            why = f"the outcome is unknown, because {self._get_path(claim)} is damaged; run the batch again."
            return JobRecord(claim.number, "", FAILED, why, attempt=claim.attempt)

    def _get_path(self, claim: Claim) -> Path:
        return self._folder / f"{claim.number:06d}.{claim.attempt}.json"
