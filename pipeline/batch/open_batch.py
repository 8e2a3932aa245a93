"""Start a batch in an output folder, or resume an existing one."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from scanloom.pipeline.batch.claims import RELEASED, Claim, Claims
from scanloom.pipeline.batch.codes import BATCH_ALREADY_EXISTS, BATCH_SCANS_NOT_DONE
from scanloom.pipeline.batch.heartbeat import HeartbeatObserver
from scanloom.pipeline.batch.job_queue import (
    BatchQueue,
    BatchSettings,
    Job,
    create_queue,
    find_latest_number,
    read_current_queue,
)
from scanloom.pipeline.batch.job_records import FAILED, JobRecords
from scanloom.pipeline.error_conversion import convert_os_errors
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Severity
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.printing import format_count

# Seconds to watch the workers of another batch (at least four beats), and seconds between two checks.
_WATCH_SECONDS, _POLL_INTERVAL = 9.0, 0.1


def open_queue(out: Path, settings: BatchSettings, jobs: Sequence[Job]) -> BatchQueue:
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
        latest = find_latest_number(out)
        try:
            current = read_current_queue(out)
        except InputError as error:
            # Results of a damaged queue are in the cache; only the job list is lost, and is rewritten.
            emit(replace(error.diagnostic, severity=Severity.INFO))
            current = None
        if current is not None and not _is_finished(current):
            if current.matches(settings, jobs):
                emit(BATCH_ALREADY_EXISTS.info("an unfinished batch of the same scans is resumed"))
                retry_count = _release_failed(current)
                if retry_count:
                    emit(
                        BATCH_SCANS_NOT_DONE.info(
                            "{scans} that failed: run again", scans=format_count(retry_count, "scan")
                        )
                    )
                return current
            _check_no_living_worker(current)
        queue = create_queue(out, latest + 1, settings, jobs)
        if queue is not None:
            return queue


def _is_finished(queue: BatchQueue) -> bool:
    ended = JobRecords(queue.folder / "done").list_ended()
    return all(number in ended for number in queue.numbers)


def _release_failed(queue: BatchQueue) -> int:
    """Release failed jobs so that workers retry them, and return their number."""
    with convert_os_errors(f"the queue {queue.folder} cannot be worked on"):
        records, claims = JobRecords(queue.folder / "done"), Claims(queue.folder / "claims", "")
        failed = [one for one in records.read_records(records.list_ended().values()) if one.state == FAILED]
        for record in failed:
            claim = Claim(record.number, record.attempt)
            claims.record_end(claim, RELEASED)
            records.delete_record(claim)
    return len(failed)


def _check_no_living_worker(queue: BatchQueue) -> None:
    """Raise InputError if a worker of a queue is alive.

    Heartbeats are watched for some seconds.
    """
    watch = HeartbeatObserver(queue.folder / "workers")
    living = watch.list_living()
    if living:
        emit(
            BATCH_ALREADY_EXISTS.info(
                "this folder has another, unfinished batch; checking if its workers are running"
            )
        )
    end = time.monotonic() + _WATCH_SECONDS
    first = {worker: watch.read_heartbeat(worker) for worker in living}
    while living and time.monotonic() < end:
        time.sleep(_POLL_INTERVAL)
        for worker in watch.list_living():
            if watch.read_heartbeat(worker) != first.get(worker):
                raise InputError(
                    BATCH_ALREADY_EXISTS,
                    "another batch is running in this folder (worker {worker})",
                    queue.out,
                    remedy="wait for its end, or choose another output folder.",
                    worker=worker,
                )
