"""The jobs of a queue by Dask: by a scheduler that runs, or workers that SLURM or others start.

Each job is a task that starts a process of its own and waits for it: the limits that Dask sets to threads and
memory of its workers are not the job's, and no job can keep a worker from answering. What a task was at when
its worker died is begun again by Dask elsewhere, from what is in the cache.
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

# Systems that dask-jobqueue starts workers by, and its classes.
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
# Seconds that a scheduler may take to answer.
_PATIENCE = 10
# Seconds that no task ends for, after which it is looked for workers.
_LOOK = 60.0
# Seconds between two looks at what has ended.
_PAUSE = 0.1


def run_task(words: str, threads: int) -> str:
    """Run a job in a process of its own, on a worker of Dask; return what it said on stderr if it failed."""
    done = subprocess.Popen(
        [sys.executable, "-c", _CODE, words],
        # Where this worker is killed, its end of the pipe is closed, by which the process knows.
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
    """Have every job of a queue run by Dask that has not come to an end.

    Parameters
    ----------
    scheduler : an address, or one of `SYSTEMS`.
    workers : how many to ask such a system for.
    threads : of each job.
    memory, disk : bytes that each job may take; None for no limit.

    Raises
    ------
    UsageError
        If Dask is not installed, or a system is named without a number of workers.
    InputError
        If no scheduler answers, or a system refuses to start workers.
    StageError
        If the scheduler is gone before all have ended.
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
        tell(Noted(f"{len(tasks)} scans are given to the scheduler at {client.scheduler.address}"))
        for count, future in enumerate(_completed(client, tasks, tell), 1):
            record = _ended(queue, records, tasks[future], future)
            tell(JobEnded(record))
            tell(Counted(len(queue.numbers) - len(tasks) + count, len(queue.numbers)))


def _completed(client: Any, tasks: Collection[Any], tell: Tell) -> Iterator[Any]:
    """Return tasks as they end, and tell where they wait for want of a worker, once for each time.

    Raises
    ------
    StageError
        If the scheduler is gone.
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
                    (
                        "the scheduler at {address} is gone; what has ended is kept: run the batch "
                        "again, with a scheduler that runs."
                    ),
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
                        f"no worker is at the scheduler {client.scheduler.address}; scans that wait for one: "
                        f"{ended.count()}. Whatever starts workers tells whether they wait for their turn, "
                        "and their logs why they ended"
                    )
                )
            is_told = is_alone


def _ended(queue: Queue, records: Records, number: int, future: Any) -> Record:
    """Return what became of a job whose task has ended; where nothing was written, that is written."""
    known = records.ended()
    if number in known:
        return records.read([known[number]])[0]
    why = str(future.exception() or future.result() or "its process ended without a result")
    if future.status == "error" and type(future.exception()).__name__ == "KilledWorker":
        why = "the workers that ran it died again and again, as they do where memory ends"
    why = f"it could not be run by Dask: {' '.join(why.split())}.".replace("..", ".")
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
            "no scheduler of Dask answers at {scheduler}: {error}.",
            scheduler=scheduler,
            error=error,
        ) from error
    with client:
        yield client


def _cluster(system: str, workers: int | None) -> Any:
    """Return a cluster whose workers a system of a computing centre starts, as the user has configured it."""
    if workers is None:
        raise UsageError(
            BATCH_DASK, "batch.dask={system} needs --jobs N: how many workers to ask it for.", system=system
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
        # As it is imported it takes Ctrl-C for an end in good order: whatever calls this would seem done.
        signal.signal(signal.SIGINT, ctrl_c)
    cluster = None
    try:
        cluster = getattr(dask_jobqueue, SYSTEMS[system])()
        cluster.sync(_ask, cluster, workers)
    except (ValueError, TypeError, OSError, RuntimeError) as error:
        if cluster is not None:
            # It does not expect workers that were refused.
            with suppress(AssertionError):
                cluster.close()
        raise InputError(
            BATCH_DASK,
            "workers cannot be started by {system}: {split}; ~/.config/dask/jobqueue.yaml says how.",
            system=system,
            split=" ".join(str(error).split()),
        ) from error
    return cluster


async def _ask(cluster: Any, workers: int) -> None:
    """Ask for workers, and wait until the system has taken that; raise RuntimeError where it refuses."""
    # As its `scale` does, which would ask later, where a refusal is only logged.
    for _ in range(workers):
        cluster.worker_spec.update(cluster.new_worker_spec())
    await cluster
    # Centres end jobs when their time is over: as long as scans wait, others are asked for in their place.
    cluster.adapt(minimum_jobs=workers, maximum_jobs=workers)
