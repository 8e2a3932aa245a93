"""Summary files of a batch in OUT: tables and page."""

from __future__ import annotations

import os
from pathlib import Path

from scanloom.pipeline.batch.codes import BATCH_ALREADY_EXISTS
from scanloom.pipeline.batch.summary import COLUMNS, CSV, PARQUET, Summary, csv_of, parquet_of
from scanloom.pipeline.batch.whole import write_whole
from scanloom.pipeline.failures import explained
from scanloom.pipeline.report.page.one_file import is_page, scans_page
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.opening import content_of

PAGE = "index.html"
_PARQUET_MARK = b"PAR1"


def write_outputs(summary: Summary, title: str) -> list[Path]:
    """Write index.html, batch.csv and, if pyarrow is installed, batch.parquet; return their paths.

    Raises
    ------
    StageError
        If a file cannot be written.
    """
    rows = summary.rows()
    with_warnings = [
        {**row, "warnings": [str(one) for one in record.warnings]}
        for row, record in zip(rows, summary.records, strict=True)
    ]
    files = {
        PAGE: scans_page(title, with_warnings),
        CSV: csv_of(rows),
        PARQUET: parquet_of(rows),
    }
    with explained(f"the tables of the batch cannot be written to {summary.out}"):
        for name, content in files.items():
            if content is not None:
                write_whole(summary.out / name, content)
            else:
                # Remove an outdated Parquet file: it would not match the other files.
                (summary.out / name).unlink(missing_ok=True)
    return [summary.out / name for name, content in files.items() if content is not None]


def withdraw_outputs(out: Path) -> None:
    """Remove the summary files of an earlier batch, which no longer match the results.

    Raises
    ------
    StageError
        If a file cannot be removed.
    """
    with explained(f"outdated tables cannot be removed from {out}"):
        for name in (PAGE, CSV, PARQUET):
            if os.path.lexists(out / name) and _is_own(out / name):
                (out / name).unlink()


def require_replaceable(out: Path) -> None:
    """Raise InputError if a summary file exists that was not written by a batch.

    Raises
    ------
    InputError
        For the first such file.
    """
    for name in (PAGE, CSV, PARQUET):
        path = out / name
        if os.path.lexists(path) and not _is_own(path):
            raise InputError(
                BATCH_ALREADY_EXISTS,
                "this file was not written by a batch",
                path,
                remedy="move it, choose another output folder, or use --overwrite.",
            )


def _is_own(path: Path) -> bool:
    if path.is_symlink() or not path.is_file():
        return False
    if path.name == PAGE:
        return is_page(path)
    if path.name == PARQUET:
        return content_of(path).startswith(_PARQUET_MARK)
    return content_of(path).startswith(",".join(list(COLUMNS)[:3]).encode())
