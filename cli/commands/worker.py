"""Command `worker`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom.cli.batch_options import WorkerParams, create_worker, sigterm_as_interrupt
from scanloom.cli.batch_progress import show_batch_progress
from scanloom.cli.batch_result import report_batch
from scanloom.cli.output import Output
from scanloom.cli.paths import require_writable
from scanloom.cli.run_options import LimitsParams
from scanloom.pipeline.batch.codes import BATCH_ALREADY_EXISTS
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError


def worker(
    target: Annotated[
        Path,
        typer.Argument(metavar="OUT", help="Output folder of scanloom batch.", show_default=False),
    ],
    worker: WorkerParams,
    limits: LimitsParams,
    out: Output,
    wait: Annotated[
        bool,
        typer.Option(
            "--wait/--no-wait",
            help="When no scan is left, wait for the other workers, and take over the scans of a "
            "worker that dies. [default: on]",
            show_default=False,
        ),
    ] = True,
) -> None:
    """Process scans of a batch together with other machines.

    Any number of workers may share a batch; each machine only needs access to OUT and the scans. If a worker
    dies, others continue its scans from the cache. Clocks need not be synchronised. The last worker writes
    the tables and the page.

    Example: scanloom worker shared/out --jobs 4
    """
    from scanloom.pipeline.batch.job_queue import read_current_queue

    # Jobs run in other folders, so the path is made absolute.
    queue = read_current_queue(target.resolve()) if target.is_dir() else None
    if queue is None:
        raise InputError(
            BATCH_ALREADY_EXISTS,
            "this folder contains no batch; start one with scanloom batch SCANS -o OUT.",
            target,
        )
    require_writable(queue.folder)
    require_version(queue.version)
    with sigterm_as_interrupt(), show_batch_progress(out) as tell:
        working = create_worker(queue, worker, limits, tell, out, stay=wait)
        out.remark(f"worker {working.name}, {len(queue.numbers):,} scans")
        working.run()
    report_batch(queue, out, {})


def require_version(version: str) -> None:
    """Warn if another version has written the queue, because its results may differ."""
    from scanloom.stages import __version__

    if version != __version__:
        emit(
            BATCH_ALREADY_EXISTS.warning(
                "the batch was started with scanloom {batch_version}, but this worker has version {version}; "
                "results may differ.",
                batch_version=version,
                version=__version__,
            )
        )
