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
from scanloom.pipeline.batch.one import Task
from scanloom.pipeline.batch.queue import Queue
from scanloom.pipeline.batch.records import FAILED, Record, Records
from scanloom.pipeline.batch.told import Counted, JobEnded, Noted, Tell, untold
from scanloom.pipeline.failures import explained
from scanloom.stages.diagnostics.errors import InputError, StageError, UsageError
from scanloom.stages.scans.model.threads import environment_of

# Job queueing systems and their dask-jobqueue classes.
SYSTEMS = {
    "slurm": "SLURMCluster",
    "pbs": "PBSCluster",
    "sge": "SGECluster",
    "lsf": "LSFCluster",
    "oar": "OARCluster",
    "htcondor": "HTCondorCluster",
}
_ROOT = Path(scanloom.__file__).parents[1]
_CODE = "from scanloom.pipeline.batch.one import main; main()"
# Seconds to wait for the scheduler to answer.
_PATIENCE = 10
# Seconds without a finished task until the number of workers is checked.
_LOOK = 60.0
# Seconds between two checks for finished tasks.
_PAUSE = 0.1


def run_task(words: str, threads: int) -> str:
    """Run a job in a subprocess of a Dask worker.

    Returns the last line of stderr if the job failed, else "".
    """
    done = subprocess.Popen(
        [sys.executable, "-c", _CODE, words],
        # If the Dask worker is killed, the pipe closes and the subprocess notices.
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        cwd=_ROOT,
        env={**os.environ, **environment_of(threads)},
    )
    with done:
        assert done.stderr is not None
        said = done.stderr.read().decode(errors="replace").strip()
    return said.splitlines()[-1] if done.returncode and said else ""


def work_by_dask(
    queue: Queue,
    scheduler: str,
    *,
    workers: int | None = None,
    threads: int = 1,
    memory: int | None = None,
    disk: int | None = None,
    take_over_after: float | None = None,
    tell: Tell = untold,
) -> None:
    """Run all unfinished jobs of a queue with Dask.

    Parameters
    ----------
    scheduler : address of a scheduler, or a key of `SYSTEMS`.
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
    records = Records(queue.folder / "done")
    open_ones = [number for number in queue.numbers if number not in records.ended()]
    with explained(f"the queue {queue.folder} cannot be worked on"), _client(scheduler, workers) as client:
        tasks = {
            client.submit(
                run_task,
                Task(
                    str(queue.out), queue.folder.name, number, threads, memory, disk, take_over_after
                ).words(),
                threads,
                key=f"scanloom-{queue.folder}-{number}",
                pure=False,
            ): number
            for number in open_ones
        }
        tell(Noted(f"{len(tasks)} scans are submitted to the scheduler at {client.scheduler.address}"))
        for count, future in enumerate(_completed(client, tasks, tell), 1):
            record = _ended(queue, records, tasks[future], future)
            tell(JobEnded(record))
            tell(Counted(len(queue.numbers) - len(tasks) + count, len(queue.numbers)))


def _completed(client: Any, tasks: Collection[Any], tell: Tell) -> Iterator[Any]:
    """Yield tasks as they complete; notify once whenever no worker is available.

    Raises
    ------
    StageError
        If the connection to the scheduler is lost.
    """
    from distributed import as_completed

    ended = as_completed(tasks)
    looked, is_told = time.monotonic(), False
    while not ended.is_empty():
        if ended.has_ready():
            one = next(ended)
            if one.cancelled():
                raise StageError(
                    BATCH_DASK,
                    "the connection to the scheduler at {address} is lost; finished scans are kept",
                    remedy="run the batch again, with a running scheduler.",
                    address=client.scheduler.address,
                )
            yield one
            looked, is_told = time.monotonic(), False
        elif time.monotonic() < looked + _LOOK:
            time.sleep(_PAUSE)
        else:
            looked, is_alone = time.monotonic(), not client.nthreads()
            if is_alone and not is_told:
                tell(
                    Noted(
                        f"the scheduler at {client.scheduler.address} has no workers; {ended.count()} scans "
                        "are waiting. Check if the queueing system lists workers as pending, and the logs of "
                        "workers that have ended"
                    )
                )
            is_told = is_alone


def _ended(queue: Queue, records: Records, number: int, future: Any) -> Record:
    """Return the record of a completed task.

    Write a failure record if the job left none.
    """
    known = records.ended()
    if number in known:
        return records.read([known[number]])[0]
    why = str(future.exception() or future.result() or "its process ended without a result")
    if future.status == "error" and type(future.exception()).__name__ == "KilledWorker":
        why = "several workers that ran it died, possibly because memory ran out"
    why = f"Dask could not run it: {' '.join(why.split())}.".replace("..", ".")
    latest = Claims(queue.folder / "claims", "").latest().get(number)
    names = {job.number: job.name for job in queue.jobs}
    record = Record(
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
def _client(scheduler: str, workers: int | None) -> Iterator[Any]:
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError(BATCH_DASK, "batch.dask needs Dask", remedy="install scanloom[dask].") from error
    if scheduler in SYSTEMS:
        with _cluster(scheduler, workers) as cluster, Client(cluster) as client:
            yield client
        return
    try:
        client = Client(scheduler, timeout=_PATIENCE)
    except (OSError, ValueError) as error:
        raise InputError(
            BATCH_DASK,
            "no Dask scheduler answers at {scheduler}: {error}.",
            scheduler=scheduler,
            error=error,
        ) from error
    with client:
        yield client


def _cluster(system: str, workers: int | None) -> Any:
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
        cluster = getattr(dask_jobqueue, SYSTEMS[system])()
        cluster.sync(_ask, cluster, workers)
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


async def _ask(cluster: Any, workers: int) -> None:
    """Request workers and wait until the system accepts; raise RuntimeError on refusal."""
    # Same as `cluster.scale`, which would submit later in the background and only log a refusal.
    for _ in range(workers):
        cluster.worker_spec.update(cluster.new_worker_spec())
    await cluster
    # Queueing systems end jobs at their time limit: replace such workers while scans are waiting.
    cluster.adapt(minimum_jobs=workers, maximum_jobs=workers)
