"""Tables, page and exit code of `batch` and `worker`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import typer

from scanloom.cli.batch_progress import format_summary, report_warnings
from scanloom.cli.exit_codes import BAD_INPUT
from scanloom.cli.output import Output
from scanloom.pipeline.batch.codes import BATCH_SCANS_NOT_DONE
from scanloom.stages.diagnostics.collector import emit

if TYPE_CHECKING:
    from scanloom.pipeline.batch.job_queue import BatchQueue


def report_batch(queue: BatchQueue, out: Output, more: Mapping[str, Any]) -> None:
    """Write the tables and the page of a batch, and print its summary.

    Parameters
    ----------
    more : further entries for JSON.

    Raises
    ------
    typer.Exit
        With the code for bad input, if no scan can be read.
    """
    from scanloom.pipeline.batch.summary import summarize_batch
    from scanloom.pipeline.batch.summary_files import write_outputs

    summary = summarize_batch(queue)
    written = [path.name for path in write_outputs(summary, queue.out.resolve().name)]
    for record in summary.records:
        report_warnings(out, record)
    failed = summary.not_done
    if failed:
        states = {one.state for one in failed}
        kinds = ", ".join(f"{summary.counts[state]} {state}" for state in sorted(states))
        emit(
            BATCH_SCANS_NOT_DONE.unmet(
                "{failed} of {scans} scans are not done: {kinds}; the table has the reasons.",
                failed=len(failed),
                scans=len(summary.records),
                kinds=kinds,
            )
        )
    metrics = {**summary.to_dict(), "cache": str(queue.cache), "files": written, **more}
    out.result(metrics, format_summary(summary, written))
    if summary.is_unusable:
        raise typer.Exit(BAD_INPUT)
