"""Work on one job of a queue that an engine chose: a process that `scanloom.pipeline.batch.dask` starts.

Where its stdin ends, whoever started it is gone; the job is then given back, for the engine to have it run
elsewhere.
"""

from __future__ import annotations

import _thread
import json
import signal
import sys
import threading
from dataclasses import asdict, dataclass
from pathlib import Path

from scanloom.pipeline.batch.queue import standing_queue
from scanloom.pipeline.batch.worker import Worker
from scanloom.stages.diagnostics.errors import ScanloomError


@dataclass(frozen=True)
class Task:
    """What an engine is given of a job.

    Attributes
    ----------
    out : the output folder.
    queue : name of the queue's folder; where another stands by now, nothing is done.
    number : of the job.
    threads : that it uses.
    memory, disk : bytes that it may take; None for no limit.
    take_over_after : seconds; None for what the queue says.
    """

    out: str
    queue: str
    number: int
    threads: int = 1
    memory: int | None = None
    disk: int | None = None
    take_over_after: float | None = None

    def words(self) -> str:
        """Return it as a word of a command line."""
        return json.dumps(asdict(self))


def main() -> None:
    """Work on the job that the first word of the command line tells."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Thread(target=_listen, name="listen", daemon=True).start()
    try:
        work_on(Task(**json.loads(sys.argv[1])))
    except KeyboardInterrupt:
        sys.exit(1)
    except ScanloomError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(1)


def work_on(task: Task) -> None:
    """Work on one job until it has come to an end, here or wherever it is at work already."""
    queue = standing_queue(Path(task.out))
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
    ).work()


def _listen() -> None:
    sys.stdin.buffer.read()
    _thread.interrupt_main()
