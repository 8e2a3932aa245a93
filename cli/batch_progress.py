"""Progress of a batch: a bar over all scans, and one line for each finished scan."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from scanloom.cli.output import Output, format_table
from scanloom.cli.rendering import as_typed
from scanloom.cli.transient_progress import TransientProgress
from scanloom.pipeline.batch.job_records import DONE, RUNNING, WAITING, JobRecord
from scanloom.pipeline.batch.summary import BatchSummary
from scanloom.pipeline.batch.worker_events import (
    JobEnded,
    JobProgress,
    JobStarted,
    Notice,
    QueueProgress,
    WorkerEvent,
    WorkerEventHandler,
)
from scanloom.stages.diagnostics.diagnostic import Severity


@contextmanager
def show_batch_progress(out: Output) -> Iterator[WorkerEventHandler]:
    """Show progress, and yield the callback for the events of a worker."""
    watcher = _Watcher(out)
    try:
        yield watcher
    finally:
        watcher.bar.close()


class _Watcher:
    def __init__(self, out: Output) -> None:
        self._out = out
        self.bar = TransientProgress(out)
        self._counted = (0, 0)

    def __call__(self, event: WorkerEvent) -> None:
        match event:
            case QueueProgress():
                self._counted = (event.ended, event.total)
                self._show()
            case JobEnded():
                self._out.remark(format_record(event.record))
                report_warnings(self._out, event.record)
            case Notice():
                self._out.remark(event.text)
            case JobStarted():
                if event.attempt:
                    self._out.remark(f"{event.name}: restarted from the cache")
            case JobProgress():
                self._show()

    def _show(self) -> None:
        self.bar.show("scans", "scans")(*self._counted)


def report_warnings(out: Output, record: JobRecord) -> None:
    """Report the warnings of a scan, each with the name of the scan."""
    for diagnostic in record.diagnostics:
        if diagnostic.severity is Severity.WARNING:
            out.report(diagnostic.replace_location_fields(scan=record.name))


def format_record(record: JobRecord) -> str:
    """Return the line of a finished scan."""
    triangles = record.metrics.get("triangles")
    came_out = record.reason or ("" if triangles is None else f"{triangles:,} triangles")
    return as_typed(f"{record.name}  {record.state}, {record.seconds:.1f} s  {came_out}".rstrip())


def format_summary(summary: BatchSummary, places: list[str]) -> str:
    """Return the table of a batch, the reasons of failures, and the location of the results."""
    rows = [["scan", "state", "seconds", "frames", "triangles", "warnings"]]
    for one in summary.records:
        is_open = one.state in (WAITING, RUNNING)
        frames, triangles = (one.metrics.get(name) for name in ("frames", "triangles"))
        rows.append(
            [
                one.name,
                one.state,
                "" if is_open else f"{one.seconds:.1f}",
                "" if frames is None else f"{frames:,}",
                "" if triangles is None else f"{triangles:,}",
                str(len(one.warnings) or ""),
            ]
        )
    reasons = [
        as_typed(f"{one.name}: {one.reason}") for one in summary.records if one.state != DONE and one.reason
    ]
    counts = ", ".join(f"{count:,} {state}" for state, count in summary.counts.items())
    lines = [format_table(rows), "", *reasons, *([""] if reasons else []), counts]
    lines.append(f"results in {summary.out}" + (f": {', '.join(places)}" if places else ""))
    return "\n".join(lines)
