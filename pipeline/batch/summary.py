"""Summary of a batch: one table row per scan."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from scanloom.pipeline.batch.claims import Claims
from scanloom.pipeline.batch.job_queue import BatchQueue
from scanloom.pipeline.batch.job_records import DONE, RUNNING, UNUSABLE, WAITING, JobRecord, JobRecords
from scanloom.stages.files.csv_cells import neutralize_csv_cell
from scanloom.stages.files.path_safety import is_safe_relative_path

CSV_FILE, PARQUET_FILE = "batch.csv", "batch.parquet"
# Columns of a row with their types; metrics are named as in `scanloom.pipeline.batch.to_dict`.
_RECORD_COLUMNS: Mapping[str, type] = {
    "scan": str,
    "state": str,
    "reason": str,
    "seconds": float,
    "warnings": int,
    "out": str,
    "folder": str,
}
_FIGURES: Mapping[str, type] = {
    "layout": str,
    "frames": int,
    "frames_skipped": int,
    "metric": bool,
    "voxel_size_m": float,
    "triangles": int,
    "manifold": bool,
    "fused_distance_rms_m": float,
    "held_out_psnr_db": float,
    "stages_cached": int,
    "stages": int,
    "compute_seconds": float,
    "peak_memory_mb": int,
    "result": str,
    "page": str,
    "picture": str,
}
_PATH_FIGURES = ("result", "page", "picture")
COLUMNS: Mapping[str, type] = {**_RECORD_COLUMNS, **_FIGURES}


@dataclass(frozen=True)
class BatchSummary:
    """Outcomes of all scans of a batch.

    Attributes
    ----------
    out : output folder of the batch.
    records : records in job order; unfinished jobs have the state WAITING or RUNNING.
    folders : scan folders in job order; "" if unknown.
    """

    out: Path
    records: tuple[JobRecord, ...]
    folders: tuple[str, ...]

    @property
    def counts(self) -> dict[str, int]:
        """Number of scans per state, without empty states."""
        states = [one.state for one in self.records]
        return {state: states.count(state) for state in dict.fromkeys(sorted(states))}

    @property
    def is_finished(self) -> bool:
        """True if every job has ended."""
        return not {WAITING, RUNNING} & {one.state for one in self.records}

    @property
    def not_done(self) -> list[JobRecord]:
        """Records of ended jobs whose state is not DONE."""
        return [one for one in self.records if one.state not in (DONE, WAITING, RUNNING)]

    @property
    def is_unusable(self) -> bool:
        """True if no scan of the batch is usable."""
        return bool(self.records) and all(one.state == UNUSABLE for one in self.records)

    def make_rows(self) -> list[dict[str, Any]]:
        """Return one row per scan, with the keys of `COLUMNS`; None for unknown values."""
        return [
            {
                "scan": one.name,
                "state": one.state,
                "reason": one.reason,
                "seconds": one.seconds,
                "warnings": len(one.warnings),
                # Relative to the table, which may be moved together with the results.
                "out": one.name,
                "folder": folder,
                **{name: _check_metric(name, one.metrics.get(name)) for name in _FIGURES},
            }
            for one, folder in zip(self.records, self.folders, strict=True)
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON-ready summary."""
        told = [
            {**row, "diagnostics": [told.to_dict() for told in one.diagnostics]}
            for row, one in zip(self.make_rows(), self.records, strict=True)
        ]
        return {"out": str(self.out), "scans": told, "counts": self.counts}


def summarize_batch(queue: BatchQueue) -> BatchSummary:
    """Read the current summary of a batch."""
    records = JobRecords(queue.folder / "done")
    ended = {one.number: one for one in records.read_records(records.list_ended().values())}
    begun = Claims(queue.folder / "claims", "").list_latest()
    jobs = {job.number: job for job in queue.jobs}
    found, folders = [], []
    for number in queue.numbers:
        job = jobs.get(number)
        name = f"job {number}" if job is None else job.name
        state = RUNNING if number in begun else WAITING
        record = ended.get(number, JobRecord(number, name, state))
        # Records are read from a shared folder, and their names become links.
        found.append(replace(record, name=name))
        folders.append("" if job is None else str(queue.get_scan_path(job)))
    return BatchSummary(queue.out, tuple(found), tuple(folders))


def _check_metric(name: str, value: Any) -> Any:
    """Return a metric of a record, or None if it has the wrong type or is a path that leads elsewhere."""
    kind = _FIGURES[name]
    if type(value) is not kind and not (kind is float and type(value) is int):
        return None
    if isinstance(value, str) and name in _PATH_FIGURES and not is_safe_relative_path(value):
        return None
    return None if isinstance(value, float) and not math.isfinite(value) else value


def format_csv(rows: Sequence[Mapping[str, Any]]) -> bytes:
    """Format rows as UTF-8 CSV with a header; unknown values are empty."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, [*COLUMNS], lineterminator="\n")
    writer.writeheader()
    # Names and messages come from files. A cell that begins with a formula sign would be executed.
    writer.writerows({name: _to_csv_value(row[name]) for name in COLUMNS} for row in rows)
    return text.getvalue().encode()


def format_parquet(rows: Sequence[Mapping[str, Any]]) -> bytes | None:
    """Format rows as a Parquet file; None if pyarrow (extra `batch`) is not installed."""
    try:
        import pyarrow
        import pyarrow.parquet as parquet
    except ImportError:
        return None
    kinds = {str: pyarrow.string(), int: pyarrow.int64(), float: pyarrow.float64(), bool: pyarrow.bool_()}
    schema = pyarrow.schema([(name, kinds[kind]) for name, kind in COLUMNS.items()])
    columns = {
        name: [None if row[name] is None else kind(row[name]) for row in rows]
        for name, kind in COLUMNS.items()
    }
    sink = pyarrow.BufferOutputStream()
    parquet.write_table(pyarrow.table(columns, schema=schema), sink)
    return bytes(sink.getvalue().to_pybytes())


def _to_csv_value(value: Any) -> Any:
    if isinstance(value, str):
        return neutralize_csv_cell(value)
    return str(value).lower() if isinstance(value, bool) else value
