"""Parameters and worker of `batch` and `worker`."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import TYPE_CHECKING

from scanloom.cli.codes import BATCH_OPTIONS_CONFLICT
from scanloom.cli.output import Output, format_size
from scanloom.cli.run_options import LimitsParams
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check_parameters, param

if TYPE_CHECKING:
    from scanloom.pipeline.batch.job_queue import BatchQueue
    from scanloom.pipeline.batch.worker import Worker
    from scanloom.pipeline.batch.worker_events import WorkerEventHandler

AUTO = "auto"
# Seconds. Larger limits are rejected; 0 disables `timeout`.
_MAX_SECONDS = 1e9


@dataclass(frozen=True, kw_only=True)
class WorkerParams:
    """Parameters of a worker."""

    jobs: str = param(
        AUTO,
        "Scans processed at the same time. `auto`: one for each core, or fewer if their expected memory "
        "exceeds the available memory.",
        common=True,
    )
    threads: int | None = param(
        None,
        "Threads of each scan; no result depends on them. Default: the cores, divided by the jobs.",
        low=1,
    )
    timeout: float | None = param(
        None,
        "A scan without progress for this long is stopped and has failed. 0: never. Default: 3600, or the "
        "value that the batch was started with.",
        unit="s",
        low=0,
        high=_MAX_SECONDS,
    )
    worker_timeout: float | None = param(
        None,
        "A worker without a heartbeat for this long is presumed dead, and other workers take over its scans. "
        "Default: 60, or the value that the batch was started with.",
        unit="s",
        low=0.5,
        high=_MAX_SECONDS,
    )

    def __post_init__(self) -> None:
        check_parameters(self)
        _ = self.job_count

    @property
    def job_count(self) -> int | None:
        """Return the number of scans at the same time; None for auto.

        Raises
        ------
        UsageError
            If `jobs` is not a number.
        """
        jobs = self.jobs
        if jobs == AUTO:
            return None
        if not (jobs.isascii() and jobs.isdigit() and 0 < int(jobs) <= 1024):
            raise UsageError(
                BATCH_OPTIONS_CONFLICT,
                "is {jobs}; it must be a number from 1 to 1024, or {auto}.",
                DiagnosticLocation(parameter="jobs"),
                jobs=jobs,
                auto=AUTO,
            )
        return int(jobs)


def create_worker(
    queue: BatchQueue,
    params: WorkerParams,
    limits: LimitsParams,
    tell: WorkerEventHandler,
    out: Output,
    *,
    stay: bool = True,
) -> Worker:
    """Create a worker for a queue from parameters.

    Parameters
    ----------
    stay : wait for the scans of other workers at the end.
    """
    from scanloom.pipeline.batch.job_concurrency import (
        compute_concurrency,
        estimate_job_memory,
        get_usable_memory,
    )
    from scanloom.pipeline.batch.worker import Worker
    from scanloom.stages.scans.model.threads import get_thread_count

    cores = get_thread_count()
    available = limits.memory_bytes if limits.memory is not None else get_usable_memory()
    slots = params.job_count
    if slots is None:
        slots = min(
            compute_concurrency(estimate_job_memory(queue), available, cores), max(len(queue.numbers), 1)
        )
        memory = "" if available is None else f", in {format_size(available)} of memory"
        out.remark(f"{slots} at a time{memory}")
    return Worker(
        queue,
        slots=slots,
        threads=params.threads or max(cores // slots, 1),
        memory=available,
        is_limit=limits.memory is not None,
        disk=limits.disk_bytes,
        take_over_after=params.worker_timeout,
        timeout=params.timeout,
        wait_for_others=stay,
        on_event=tell,
    )


@contextmanager
def sigterm_as_interrupt() -> Iterator[None]:
    """Treat SIGTERM, which schedulers send before they kill, as Ctrl-C."""

    def interrupt(number: int, frame: FrameType | None) -> None:  # noqa: ARG001
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
