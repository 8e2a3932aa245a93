"""Summary files of a batch in OUT: tables and page."""

from __future__ import annotations

import os
from pathlib import Path

from scanloom.pipeline.batch.atomic_write import write_atomically_unlocked
from scanloom.pipeline.batch.codes import BATCH_ALREADY_EXISTS
from scanloom.pipeline.batch.summary import (
    COLUMNS,
    CSV_FILE,
    PARQUET_FILE,
    BatchSummary,
    format_csv,
    format_parquet,
)
from scanloom.pipeline.error_conversion import convert_os_errors
from scanloom.pipeline.report.page.single_file_page import is_page, make_scans_page
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.input_files import read_input_bytes

PAGE_FILE = "index.html"
_PARQUET_MARK = b"PAR1"


def write_outputs(summary: BatchSummary, title: str) -> list[Path]:
    """Write index.html, batch.csv and, if pyarrow is installed, batch.parquet; return their paths.

    Raises
    ------
    StageError
        If a file cannot be written.
    """
    rows = summary.make_rows()
    with_warnings = [
        {**row, "warnings": [str(one) for one in record.warnings]}
        for row, record in zip(rows, summary.records, strict=True)
    ]
    files = {
        PAGE_FILE: make_scans_page(title, with_warnings),
        CSV_FILE: format_csv(rows),
        PARQUET_FILE: format_parquet(rows),
    }
    with convert_os_errors(f"the tables of the batch cannot be written to {summary.out}"):
        for name, content in files.items():
            if content is not None:
                write_atomically_unlocked(summary.out / name, content)
            else:
                # Remove an outdated Parquet file: it would not match the other files.
                (summary.out / name).unlink(missing_ok=True)
    return [summary.out / name for name, content in files.items() if content is not None]


def remove_outputs(out: Path) -> None:
    """Remove the summary files of an earlier batch, which no longer match the results.

    Raises
    ------
    StageError
        If a file cannot be removed.
    """
    with convert_os_errors(f"outdated tables cannot be removed from {out}"):
        for name in (PAGE_FILE, CSV_FILE, PARQUET_FILE):
            if os.path.lexists(out / name) and _is_batch_output(out / name):
                (out / name).unlink()


def check_outputs_replaceable(out: Path) -> None:
    """Raise InputError if a summary file exists that was not written by a batch.

    Raises
    ------
    InputError
        For the first such file.
    """
    for name in (PAGE_FILE, CSV_FILE, PARQUET_FILE):
        path = out / name
        if os.path.lexists(path) and not _is_batch_output(path):
            raise InputError(
                BATCH_ALREADY_EXISTS,
                "this file was not written by a batch",
                path,
                remedy="move it, choose another output folder, or give run.overwrite=true.",
            )


def _is_batch_output(path: Path) -> bool:
    if path.is_symlink() or not path.is_file():
        return False
    if path.name == PAGE_FILE:
        return is_page(path)
    if path.name == PARQUET_FILE:
        return read_input_bytes(path).startswith(_PARQUET_MARK)
    return read_input_bytes(path).startswith(",".join(list(COLUMNS)[:3]).encode())
