"""Options of whoever works on a queue, `batch` and `worker`, and the worker they come to."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import typer

from scanloom.cli.codes import BATCH_OPTIONS_CONFLICT
from scanloom.cli.output import Output, size_of
from scanloom.cli.run_options import LIMITS_PANEL
from scanloom.stages.diagnostics.errors import UsageError

if TYPE_CHECKING:
    from scanloom.pipeline.batch.queue import Queue
    from scanloom.pipeline.batch.told import Tell
    from scanloom.pipeline.batch.worker import Worker

AUTO = "auto"
# Seconds; an option that should be for ever says so in another way.
_LONGEST = 1e9

JobsOption = Annotated[
    str,
    typer.Option(
        metavar=f"N|{AUTO}",
        help="Scans at a time. auto: as many as there are cores, or fewer where memory would not hold what "
        "they are expected to take. However many, one more only begins while there is memory for it.",
        rich_help_panel=LIMITS_PANEL,
    ),
]
ThreadsOption = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        min=1,
        help="Threads of each scan; if not given, the cores are shared out. No result depends on it.",
        rich_help_panel=LIMITS_PANEL,
        show_default=False,
    ),
]
TakeOverOption = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        min=0.5,
        max=_LONGEST,
        help="A worker that gives no sign of life for so long is taken for dead, and its scans are taken "
        "over. Default: 60, or what the batch was begun with.",
        show_default=False,
    ),
]
TimeoutOption = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        min=0.0,
        max=_LONGEST,
        help="A scan that gets no further for so long is ended, with all processes of it, and has failed; "
        "the others go on. What counts is a new stage, or another share of it done, so that a large scan "
        "may take as long as it needs. 0: wait for ever. Default: 3600, or what the batch was begun with.",
        rich_help_panel=LIMITS_PANEL,
        show_default=False,
    ),
]


def worker_of(
    queue: Queue,
    jobs: str,
    threads: int | None,
    memory: int | None,
    disk: int | None,
    take_over_after: float | None,
    timeout: float | None,
    tell: Tell,
    out: Output,
    *,
    stay: bool = True,
) -> Worker:
    """Return the worker that options come to."""
    from scanloom.pipeline.batch.sizing import expected_needs, jobs_at_once, memory_to_use
    from scanloom.pipeline.batch.worker import Worker
    from scanloom.stages.scans.model.threads import threads_to_use

    cores = threads_to_use()
    there = memory if memory is not None else memory_to_use()
    if jobs == AUTO:
        slots = min(jobs_at_once(expected_needs(queue), there, cores), max(len(queue.numbers), 1))
        held = "" if there is None else f", in {size_of(there)} of memory"
        out.remark(f"{slots} at a time{held}")
    else:
        slots = jobs_wanted(jobs) or 1
    return Worker(
        queue,
        slots=slots,
        threads=threads or max(cores // slots, 1),
        memory=there,
        is_limit=memory is not None,
        disk=disk,
        take_over_after=take_over_after,
        timeout=timeout,
        stay=stay,
        tell=tell,
    )


def jobs_wanted(jobs: str) -> int | None:
    """Return how many scans at a time --jobs names; None for auto.

    Raises
    ------
    UsageError
        If it names no number.
    """
    if jobs == AUTO:
        return None
    if not (jobs.isascii() and jobs.isdigit() and 0 < int(jobs) <= 1024):
        raise UsageError(
            BATCH_OPTIONS_CONFLICT,
            "--jobs is {jobs!r}; it must be a number from 1 to 1024, or {auto}.",
            jobs=jobs,
            auto=AUTO,
        )
    return int(jobs)


@contextmanager
def ending_as_interrupted() -> Iterator[None]:
    """Take a request to end (SIGTERM), as schedulers send before they kill, for Ctrl-C."""

    def interrupt(number: int, frame: FrameType | None) -> None:  # noqa: ARG001
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
