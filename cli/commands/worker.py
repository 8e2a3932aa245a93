"""The command `worker`: work on a batch that was begun, with others, from any machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom.cli.batch_options import (
    AUTO,
    JobsOption,
    TakeOverOption,
    ThreadsOption,
    TimeoutOption,
    ending_as_interrupted,
    jobs_wanted,
    worker_of,
)
from scanloom.cli.batch_result import tell_batch
from scanloom.cli.batch_watch import watching_batch
from scanloom.cli.output import Output
from scanloom.cli.paths import require_writable
from scanloom.cli.run_options import DiskOption, MemoryOption, bytes_or_none
from scanloom.pipeline.batch.codes import BATCH_ALREADY_EXISTS
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError


def worker(
    target: Annotated[
        Path,
        typer.Argument(metavar="OUT", help="Output folder of scanloom batch.", show_default=False),
    ],
    out: Output,
    jobs: JobsOption = AUTO,
    threads: ThreadsOption = None,
    memory: MemoryOption = None,
    disk: DiskOption = None,
    timeout: TimeoutOption = None,
    take_over_after: TakeOverOption = None,
    wait: Annotated[
        bool,
        typer.Option(
            "--wait/--no-wait",
            help="When no scan is left to take, stay until the others are finished with theirs, to take over "
            "those of a worker that dies; without, end at once and leave the machine to others.",
        ),
    ] = True,
) -> None:
    """Work on the queue of a batch until every scan has come to an end.

    Any number of workers may, on any number of machines that see OUT and the scans: nothing else is needed
    between them. A worker that dies is noticed by its silence, and its scans are begun again from what is in
    the cache. Clocks of machines need not agree. Whoever is there at the end writes the tables and the page.

    Example: scanloom worker shared/out --jobs 4
    """
    from scanloom.pipeline.batch.queue import standing_queue

    jobs_wanted(jobs)
    sizes = bytes_or_none(memory, "--memory"), bytes_or_none(disk, "--disk")
    # Jobs run in processes that are elsewhere.
    queue = standing_queue(target.resolve()) if target.is_dir() else None
    if queue is None:
        raise InputError(
            BATCH_ALREADY_EXISTS,
            "no batch was begun here; begin one with scanloom batch SCANS -o OUT.",
            target,
        )
    require_writable(queue.folder)
    require_version(queue.version)
    with ending_as_interrupted(), watching_batch(out) as tell:
        working = worker_of(queue, jobs, threads, *sizes, take_over_after, timeout, tell, out, stay=wait)
        out.remark(f"worker {working.name}, {len(queue.numbers):,} scans")
        working.work()
    tell_batch(queue, out, {})


def require_version(version: str) -> None:
    """Warn of a queue that another version has written: its results may be other bytes."""
    from scanloom.stages import __version__

    if version != __version__:
        emit(
            BATCH_ALREADY_EXISTS.warning(
                "the batch was begun by scanloom {batch_version}, and this worker is {version}.",
                batch_version=version,
                version=__version__,
            )
        )
