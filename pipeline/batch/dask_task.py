"""Subprocess for one job of a queue, started by `scanloom.pipeline.batch.dask_executor`.

If stdin closes, the Dask worker has died. The job is then released, for Dask to run it elsewhere.
"""

from __future__ import annotations

import _thread
import json
import signal
import sys
import threading
from dataclasses import asdict, dataclass
from pathlib import Path

from scanloom.pipeline.batch.job_queue import read_current_queue
from scanloom.pipeline.batch.worker import Worker
from scanloom.stages.diagnostics.errors import ScanloomError


@dataclass(frozen=True)
class DaskTask:
    """Job description passed to the subprocess.

    Attributes
    ----------
    out : output folder of the batch.
    queue : name of the queue folder; the task does nothing if the current queue is another one.
    number : job number.
    threads : threads of the job.
    memory, disk : bytes that the job may use; None for no limit.
    take_over_after : seconds of silence after which a worker is presumed dead; None for the setting of the
        queue.
    """

    out: str
    queue: str
    number: int
    threads: int = 1
    memory: int | None = None
    disk: int | None = None
    take_over_after: float | None = None

    def to_argument(self) -> str:
        """Serialise the task as a command-line argument."""
        return json.dumps(asdict(self))


def main() -> None:
    """Run the job given by the first command-line argument."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Thread(target=_listen, name="listen", daemon=True).start()
    try:
        run_single_job(DaskTask(**json.loads(sys.argv[1])))
    except KeyboardInterrupt:
        sys.exit(1)
    except ScanloomError as error:
        # In a JSON string, control characters of names are escaped.
        sys.stderr.write(json.dumps(str(error))[1:-1] + "\n")
        sys.exit(1)


def run_single_job(task: DaskTask) -> None:
    """Run one job until it has a record, written by this process or another."""
    queue = read_current_queue(Path(task.out))
    if queue is None or queue.folder.name != task.queue:
        return
    Worker(
        queue,
        slots=1,
        threads=task.threads,
        memory=task.memory,
        is_limit=task.memory is not None,
        disk=task.disk,
        take_over_after=task.take_over_after,
        only=frozenset({task.number}),
    ).run()


def _listen() -> None:
    sys.stdin.buffer.read()
    _thread.interrupt_main()
