"""Batch execution with Dask.

Jobs run on an existing scheduler, or on workers started by SLURM and similar systems.

Each job is a Dask task that starts a subprocess and waits for it. The subprocess is not bound by the thread
and memory limits of the Dask worker, and no job can block the worker's event loop. If a Dask worker dies,
Dask reschedules its task, and the job continues from the cache.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import scanloom
from scanloom.pipeline.batch.claims import Claims
from scanloom.pipeline.batch.codes import BATCH_DASK
from scanloom.pipeline.batch.dask_task import DaskTask
from scanloom.pipeline.batch.job_queue import BatchQueue
from scanloom.pipeline.batch.job_records import FAILED, JobRecord, JobRecords
from scanloom.pipeline.batch.worker_events import (
    JobEnded,
    Notice,
    QueueProgress,
    WorkerEventHandler,
    ignore_worker_event,
)
from scanloom.pipeline.error_conversion import convert_os_errors
from scanloom.stages.diagnostics.errors import InputError, StageError, UsageError
from scanloom.stages.scans.model.threads import build_thread_environment

# Job queueing systems and their dask-jobqueue classes.
CLUSTER_CLASSES = {
    "slurm": "SLURMCluster",
    "pbs": "PBSCluster",
    "sge": "SGECluster",
    "lsf": "LSFCluster",
    "oar": "OARCluster",
    "htcondor": "HTCondorCluster",
}
_ROOT = Path(scanloom.__file__).parents[1]
_CODE = "from scanloom.pipeline.batch.dask_task import main; main()"
# Seconds to wait for the scheduler to answer.
_CONNECT_TIMEOUT = 10
# Seconds without a finished task until the number of workers is checked.
_WORKER_CHECK_INTERVAL = 60.0
# Seconds between two checks for finished tasks.
_POLL_INTERVAL = 0.1


def run_task(task_json: str, threads: int) -> str:
    """Run a job in a subprocess of a Dask worker.

    Returns the last line of stderr if the job failed, else "".
    """
    process = subprocess.Popen(
        [sys.executable, "-c", _CODE, task_json],
        # If the Dask worker is killed, the pipe closes and the subprocess notices.
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        cwd=_ROOT,
        env={**os.environ, **build_thread_environment(threads)},
    )
    with process:
        assert process.stderr is not None
        errors = process.stderr.read().decode(errors="replace").strip()
    return errors.splitlines()[-1] if process.returncode and errors else ""


def run_with_dask(
    queue: BatchQueue,
    scheduler: str,
    *,
    workers: int | None = None,
    threads: int = 1,
    memory: int | None = None,
    disk: int | None = None,
    take_over_after: float | None = None,
    on_event: WorkerEventHandler = ignore_worker_event,
) -> None:
    """Run all unfinished jobs of a queue with Dask.

    Parameters
    ----------
    scheduler : address of a scheduler, or a key of `CLUSTER_CLASSES`.
    workers : number of workers to request from the queueing system.
    threads : threads per job.
    memory, disk : bytes that each job may use; None for no limit.

    Raises
    ------
    UsageError
        If Dask is not installed, or `workers` is missing for a queueing system.
    InputError
        If the scheduler does not answer, or the queueing system refuses to start workers.
    StageError
        If the connection to the scheduler is lost.
    """
    records = JobRecords(queue.folder / "done")
    open_jobs = [number for number in queue.numbers if number not in records.list_ended()]
    with (
        convert_os_errors(f"the queue {queue.folder} cannot be worked on"),
        _open_client(scheduler, workers) as client,
    ):
        tasks = {
            client.submit(
                run_task,
                DaskTask(
                    str(queue.out), queue.folder.name, number, threads, memory, disk, take_over_after
                ).to_argument(),
                threads,
                key=f"scanloom-{queue.folder}-{number}",
                pure=False,
            ): number
            for number in open_jobs
        }
        on_event(Notice(f"{len(tasks)} scans are submitted to the scheduler at {client.scheduler.address}"))
        for count, future in enumerate(_iterate_completed(client, tasks, on_event), 1):
            record = _read_outcome(queue, records, tasks[future], future)
            on_event(JobEnded(record))
            on_event(QueueProgress(len(queue.numbers) - len(tasks) + count, len(queue.numbers)))


def _iterate_completed(client: Any, tasks: Collection[Any], on_event: WorkerEventHandler) -> Iterator[Any]:
    """Yield tasks as they complete; notify once whenever no worker is available.

    Raises
    ------
    StageError
        If the connection to the scheduler is lost.
    """
    from distributed import as_completed

    completed = as_completed(tasks)
    last_check, is_notified = time.monotonic(), False
    while not completed.is_empty():
        if completed.has_ready():
            one = next(completed)
            if one.cancelled():
                raise StageError(
                    BATCH_DASK,
                    "the connection to the scheduler at {address} is lost; finished scans are kept",
                    remedy="run the batch again, with a running scheduler.",
                    address=client.scheduler.address,
                )
            yield one
            last_check, is_notified = time.monotonic(), False
        elif time.monotonic() < last_check + _WORKER_CHECK_INTERVAL:
            time.sleep(_POLL_INTERVAL)
        else:
            last_check, is_alone = time.monotonic(), not client.nthreads()
            if is_alone and not is_notified:
                on_event(
                    Notice(
                        f"the scheduler at {client.scheduler.address} has no workers; {completed.count()} "
                        "scans "
                        "are waiting. Check if the queueing system lists workers as pending, and the logs of "
                        "workers that have ended"
                    )
                )
            is_notified = is_alone


def _read_outcome(queue: BatchQueue, records: JobRecords, number: int, future: Any) -> JobRecord:
    """Return the record of a completed task.

    Write a failure record if the job left none.
    """
    known = records.list_ended()
    if number in known:
        return records.read_records([known[number]])[0]
    why = str(future.exception() or future.result() or "its process ended without a result")
    if future.status == "error" and type(future.exception()).__name__ == "KilledWorker":
        why = "several workers that ran it died, possibly because memory ran out"
    why = f"Dask could not run it: {' '.join(why.split())}.".replace("..", ".")
    latest = Claims(queue.folder / "claims", "").list_latest().get(number)
    names = {job.number: job.name for job in queue.jobs}
    record = JobRecord(
        number,
        names.get(number, f"job {number}"),
        FAILED,
        why,
        worker="dask",
        attempt=0 if latest is None else latest.attempt,
    )
    records.write(record)
    return record


@contextmanager
def _open_client(scheduler: str, workers: int | None) -> Iterator[Any]:
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError(BATCH_DASK, "batch.dask needs Dask", remedy="install scanloom[dask].") from error
    if scheduler in CLUSTER_CLASSES:
        with _start_cluster(scheduler, workers) as cluster, Client(cluster) as client:
            yield client
        return
    try:
        client = Client(scheduler, timeout=_CONNECT_TIMEOUT)
    except (OSError, ValueError) as error:
        raise InputError(
            BATCH_DASK,
            "no Dask scheduler answers at {scheduler}: {error}.",
            scheduler=scheduler,
            error=error,
        ) from error
    with client:
        yield client


def _start_cluster(system: str, workers: int | None) -> Any:
    """Start a dask-jobqueue cluster, as configured by the user."""
    if workers is None:
        raise UsageError(
            BATCH_DASK,
            "batch.dask={system} needs --jobs N, the number of workers.",
            system=system,
        )
    ctrl_c = signal.getsignal(signal.SIGINT)
    try:
        import dask_jobqueue
    except ImportError as error:
        raise UsageError(
            BATCH_DASK,
            "batch.dask={system} needs dask-jobqueue",
            remedy="install scanloom[dask].",
            system=system,
        ) from error
    if signal.getsignal(signal.SIGINT) is not ctrl_c:
        # Importing dask_jobqueue replaces the SIGINT handler with a clean exit: an interrupted batch would
        # look done.
        signal.signal(signal.SIGINT, ctrl_c)
    cluster = None
    try:
        cluster = getattr(dask_jobqueue, CLUSTER_CLASSES[system])()
        cluster.sync(_request_workers, cluster, workers)
    except (ValueError, TypeError, OSError, RuntimeError) as error:
        if cluster is not None:
            # `close` asserts that all requested workers exist, which is false after a refusal.
            with suppress(AssertionError):
                cluster.close()
        raise InputError(
            BATCH_DASK,
            "{system} cannot start workers: {split}; configure it in ~/.config/dask/jobqueue.yaml.",
            system=system,
            split=" ".join(str(error).split()),
        ) from error
    return cluster


async def _request_workers(cluster: Any, workers: int) -> None:
    """Request workers and wait until the system accepts; raise RuntimeError on refusal."""
    # Same as `cluster.scale`, which would submit later in the background and only log a refusal.
    for _ in range(workers):
        cluster.worker_spec.update(cluster.new_worker_spec())
    await cluster
    # Queueing systems end jobs at their time limit: replace such workers while scans are waiting.
    cluster.adapt(minimum_jobs=workers, maximum_jobs=workers)
