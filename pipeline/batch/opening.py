"""Start a batch in an output folder, or resume an existing one."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from scanloom.pipeline.batch.claims import RELEASED, Claim, Claims
from scanloom.pipeline.batch.codes import BATCH_ALREADY_EXISTS, BATCH_SCANS_NOT_DONE
from scanloom.pipeline.batch.heartbeat import Watch
from scanloom.pipeline.batch.queue import Job, Queue, Settings, latest_number, new_queue, standing_queue
from scanloom.pipeline.batch.records import FAILED, Records
from scanloom.pipeline.failures import explained
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Severity
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.printing import counted

# Seconds to watch the workers of another batch (at least four beats), and seconds between two checks.
_WATCHED, _PAUSE = 9.0, 0.1


def open_queue(out: Path, settings: Settings, jobs: Sequence[Job]) -> Queue:
    """Open the queue of a batch.

    An unfinished queue of the same jobs is resumed; otherwise a new queue is written.

    Failed jobs of a resumed queue are run again, because the cause (e.g. a full disk) may be gone.

    Raises
    ------
    InputError
        If workers are running another batch in the folder.
    StageError
        If the queue cannot be written.
    """
    while True:
        seen = latest_number(out)
        try:
            standing = standing_queue(out)
        except InputError as error:
            # Results of a damaged queue are in the cache; only the job list is lost, and is rewritten.
            emit(replace(error.diagnostic, severity=Severity.INFO))
            standing = None
        if standing is not None and not _is_finished(standing):
            if standing.is_of(settings, jobs):
                emit(BATCH_ALREADY_EXISTS.info("an unfinished batch of the same scans is resumed"))
                again = _give_back_failed(standing)
                if again:
                    emit(
                        BATCH_SCANS_NOT_DONE.info(
                            "{scans} that failed: run again", scans=counted(again, "scan")
                        )
                    )
                return standing
            _require_quiet(standing)
        queue = new_queue(out, seen + 1, settings, jobs)
        if queue is not None:
            return queue


def _is_finished(queue: Queue) -> bool:
    ended = Records(queue.folder / "done").ended()
    return all(number in ended for number in queue.numbers)


def _give_back_failed(queue: Queue) -> int:
    """Release failed jobs so that workers retry them, and return their number."""
    with explained(f"the queue {queue.folder} cannot be worked on"):
        records, claims = Records(queue.folder / "done"), Claims(queue.folder / "claims", "")
        failed = [one for one in records.read(records.ended().values()) if one.state == FAILED]
        for record in failed:
            claim = Claim(record.number, record.attempt)
            claims.end(claim, RELEASED)
            records.withdraw(claim)
    return len(failed)


def _require_quiet(queue: Queue) -> None:
    """Raise InputError if a worker of a queue is alive.

    Heartbeats are watched for some seconds.
    """
    watch = Watch(queue.folder / "workers")
    silent = watch.living()
    if silent:
        emit(
            BATCH_ALREADY_EXISTS.info(
                "this folder has another, unfinished batch; checking if its workers are running"
            )
        )
    end = time.monotonic() + _WATCHED
    first = {worker: watch.said(worker) for worker in silent}
    while silent and time.monotonic() < end:
        time.sleep(_PAUSE)
        for worker in watch.living():
            if watch.said(worker) != first.get(worker):
                raise InputError(
                    BATCH_ALREADY_EXISTS,
                    "another batch is running in this folder (worker {worker})",
                    queue.out,
                    remedy="wait for its end, or choose another output folder.",
                    worker=worker,
                )
