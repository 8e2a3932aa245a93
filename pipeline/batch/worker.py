"""Worker that runs jobs of a queue, one per slot.

The worker only claims, watches and records. Jobs run in subprocesses
(`scanloom.pipeline.batch.process_handle`), so that no job can block the heartbeat or crash the worker.
"""

from __future__ import annotations

import queue as queues
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from scanloom.pipeline.batch.admission import AdmissionControl, JobNeeds
from scanloom.pipeline.batch.claims import CRASHED, KILLED, RELEASED, Claim, Claims
from scanloom.pipeline.batch.codes import (
    BATCH_QUEUE_DAMAGED,
    BATCH_QUEUE_REFUSED,
    BATCH_SCAN_STUCK,
    BATCH_WORKER_STOPPED,
)
from scanloom.pipeline.batch.heartbeat import Heartbeat, HeartbeatObserver, create_worker_name
from scanloom.pipeline.batch.job_queue import BatchQueue
from scanloom.pipeline.batch.job_records import FAILED, UNUSABLE, JobRecord, JobRecords
from scanloom.pipeline.batch.job_scheduler import JobScheduler
from scanloom.pipeline.batch.process_handle import JobProcess, Message
from scanloom.pipeline.batch.queue_validation import is_inside
from scanloom.pipeline.batch.slot import RunningJob, Slot
from scanloom.pipeline.batch.worker_events import (
    JobEnded,
    JobProgress,
    JobStarted,
    Notice,
    QueueProgress,
    WorkerEventHandler,
    ignore_worker_event,
)
from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.error_conversion import convert_os_errors
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import StageError

# Jobs after which a job process is replaced, to bound memory leaks of libraries.
_MAX_JOBS_PER_PROCESS = 64
# Maximum seconds to wait for messages before looking for jobs again.
_POLL_INTERVAL = 0.5
# Maximum seconds that one loop iteration adds to a job's time without progress: a suspended machine or a
# stopped worker must not count against the job.
_MAX_TURN_SECONDS = 10.0
# Exit codes for SIGKILL and SIGTERM, sent by the system; any other signal counts as a crash.
_KILL_EXIT_CODES = (-9, -15)


class Worker:
    """Worker on a queue.

    Parameters
    ----------
    slots : number of concurrent jobs.
    threads : threads per job.
    memory : bytes for all jobs together; None if unknown.
    is_limit : True if jobs above `memory` are ended; False if `memory` only bounds the number of
        concurrent jobs.
    disk : bytes that all jobs may write in total; None for no limit.
    take_over_after : seconds of silence after which a worker is presumed dead; None for the setting of the
        queue.
    timeout : seconds without progress after which a job is ended, 0 for never; None for the setting of the
        queue.
    only : numbers of the jobs to run; None for all.
    wait_for_others : True to wait for jobs of other workers, and take over jobs of dead workers.
    on_event : callback for progress events.
    clock : monotonic clock in seconds, for `timeout`.
    """

    def __init__(
        self,
        queue: BatchQueue,
        *,
        slots: int,
        threads: int,
        memory: int | None = None,
        is_limit: bool = False,
        disk: int | None = None,
        take_over_after: float | None = None,
        timeout: float | None = None,
        only: frozenset[int] | None = None,
        wait_for_others: bool = True,
        on_event: WorkerEventHandler = ignore_worker_event,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name = create_worker_name()
        self._queue = queue
        self._threads = threads
        self._wait_for_others = wait_for_others
        self._on_event = on_event
        self._take_over_after = take_over_after or queue.settings.take_over_after
        self._timeout = queue.settings.timeout if timeout is None else timeout
        self._clock = clock
        self._last_check = clock()
        self._claims = Claims(queue.folder / "claims", self.name)
        self._records = JobRecords(queue.folder / "done")
        watch = HeartbeatObserver(queue.folder / "workers")
        self._scheduler = JobScheduler(queue, self._claims, self._records, watch, self._take_over_after, only)
        self._admission: AdmissionControl[Slot] = AdmissionControl(memory, disk, is_limit=is_limit)
        self._inbox: queues.SimpleQueue[tuple[JobProcess, Message]] = queues.SimpleQueue()
        self._slots = [Slot() for _ in range(slots)]
        self._jobs = {job.number: job for job in queue.jobs}

    def run(self) -> None:
        """Run jobs until all have ended or none can be taken.

        Jobs of other workers count, too.

        Raises
        ------
        StageError
            If the queue cannot be written to. Finished jobs keep their records; others are left to other
            workers.
        """
        with (
            convert_os_errors(f"the queue {self._queue.folder} cannot be worked on"),
            Heartbeat(self._queue.folder / "workers", self.name, self._take_over_after),
        ):
            try:
                self._run_loop()
            except FileNotFoundError:
                # The queue may be removed between two checks.
                self._check_queue_exists()
                raise
            finally:
                self._stop_jobs()

    def _run_loop(self) -> None:
        while True:
            self._check_queue_exists()
            for slot in self._slots:
                while slot.work is None and (claim := self._scheduler.take_next()) is not None:
                    self._start_job(slot, claim)
            for record in self._scheduler.pop_given_up():
                self._write_record(record)
            self._on_event(QueueProgress(*self._scheduler.count_ended()))
            if all(slot.work is None for slot in self._slots) and (
                self._scheduler.is_finished() or not (self._wait_for_others or self._scheduler.has_more())
            ):
                return
            self._handle_messages()
            self._check_running_jobs()

    def _check_queue_exists(self) -> None:
        """Raise StageError if a later batch has replaced this queue.

        A later batch may do so if this worker seemed dead.
        """
        if not self._queue.folder.is_dir():
            raise StageError(
                BATCH_WORKER_STOPPED,
                "another batch was started in {out} while this worker was unresponsive; its finished stages "
                "are in the cache.",
                out=self._queue.out,
            )

    def _start_job(self, slot: Slot, claim: Claim) -> None:
        job = self._jobs.get(claim.number)
        problem = self._find_problem(claim.number)
        if job is None or problem is not None:
            self._write_record(
                JobRecord(
                    claim.number,
                    "",
                    FAILED,
                    str(problem),
                    worker=self.name,
                    attempt=claim.attempt,
                    diagnostics=() if problem is None else (problem,),
                )
            )
            return
        slot.work = RunningJob(job, claim)
        if slot.process is None:
            slot.process, slot.finished_count = JobProcess(self._inbox, self._threads, self._log), 0
        settings = self._queue.settings
        slot.process.send(
            {
                "name": job.name,
                "scan": str(self._queue.get_scan_path(job)),
                "out": str(self._queue.get_output_folder(job)),
                "cache": str(self._queue.cache),
                "config": settings.config,
                "until": settings.until,
                "force": settings.force,
                "overwrite": settings.overwrite,
            }
        )
        self._on_event(JobStarted(job.name, claim.attempt))

    def _find_problem(self, number: int) -> Diagnostic | None:
        """Return why a job is not run; None if it can be run."""
        job = self._jobs.get(number)
        if job is None and number not in self._queue.refusals:
            return BATCH_QUEUE_DAMAGED.error(
                "the line of this job is damaged",
                self._queue.folder / "jobs.jsonl",
                remedy="run the batch again to rewrite it.",
            )
        folder = None if job is None else self._queue.get_output_folder(job)
        if folder is None:
            reason = self._queue.refusals[number]
        elif not is_inside(folder, self._queue.out):
            reason = f"a link leads from {folder} out of the output folder"
        else:
            return None
        return BATCH_QUEUE_REFUSED.error(
            "this job is refused: {reason}",
            self._queue.folder / "jobs.jsonl",
            remedy="run `scanloom batch` again, which rewrites the queue.",
            reason=reason,
        )

    @property
    def _log(self) -> Path:
        return self._queue.folder / "workers" / f"{self.name}.log"

    def _handle_messages(self) -> None:
        """Handle messages of job processes until the inbox is empty."""
        pause = _POLL_INTERVAL
        while True:
            try:
                process, message = self._inbox.get(timeout=pause)
            except queues.Empty:
                return
            slot = next((one for one in self._slots if one.process is process), None)
            if slot is not None:
                self._handle_message(slot, message)
            for granted, leave in self._admission.pop_admissible():
                if granted.process is not None and granted.work is not None:
                    granted.work.is_awaiting_admission = False
                    granted.process.send(leave)
            pause = 0.0

    def _handle_message(self, slot: Slot, message: Message) -> None:
        work = slot.work
        if "gone" in message:
            if slot.process is not None:
                slot.process.end()
            slot.process = None
            if work is not None:
                self._retry_job(slot, work, message["gone"])
        elif work is None:
            return
        elif "needs" in message:
            needs = message["needs"]
            work.is_awaiting_admission = True
            self._admission.enqueue(slot, JobNeeds(needs["memory"], needs["disk"]))
        elif "at" in message:
            if message["at"] != work.stage:
                self._claims.record_stage(work.claim, message["at"])
            work.record_progress(message["at"], message["share"])
            self._on_event(JobProgress(work.job.name, work.stage, work.completed_ratio))
        elif "waiting" in message:
            work.is_blocked = True
            self._on_event(Notice(f"{work.job.name}: {message['waiting']}"))
        elif "ended" in message:
            self._finish_job(slot, work, message["ended"])

    def _finish_job(self, slot: Slot, work: RunningJob, outcome: Message) -> None:
        job = work.job
        slot.finished_count += 1
        if slot.finished_count >= _MAX_JOBS_PER_PROCESS and slot.process is not None:
            slot.process.end()
            slot.process = None
        if self._claims.is_lost(work.claim):
            self._leave_job(slot, work)
            return
        self._free_slot(slot, outcome["written"])
        state, why = outcome["state"], outcome["reason"]
        if state == UNUSABLE and not self._queue.get_scan_path(job).exists():
            why = f"{self._queue.get_scan_path(job)}: the scan does not exist any more."
        record = JobRecord(
            job.number,
            job.name,
            state,
            why,
            outcome["seconds"],
            self.name,
            work.claim.attempt,
            tuple(Diagnostic.from_dict(one) for one in outcome["diagnostics"]),
            outcome["metrics"],
        )
        self._write_record(record)

    def _retry_job(self, slot: Slot, work: RunningJob, code: int) -> None:
        """Retry a job whose process exited; finished stages are in the cache."""
        self._free_slot(slot, 0)
        self._claims.record_end(work.claim, KILLED if code in _KILL_EXIT_CODES else CRASHED)
        self._scheduler.schedule_retry(work.claim)
        how = (
            f"its process ended unexpectedly ({_format_exit_code(code)}) in {work.stage}; the scan is "
            "run again"
        )
        self._on_event(Notice(f"{work.job.name}: {how}"))

    def _check_running_jobs(self) -> None:
        """Kill jobs that other workers have taken over or that exceed the timeout."""
        now = self._clock()
        passed, self._last_check = min(now - self._last_check, _MAX_TURN_SECONDS), now
        for slot in self._slots:
            work = slot.work
            if work is None:
                continue
            work.add_idle_time(passed)
            if self._claims.is_lost(work.claim):
                self._kill_job(slot, work)
                self._leave_job(slot, work)
            elif self._timeout and work.idle_seconds > self._timeout:
                self._kill_job(slot, work)
                self._free_slot(slot, 0)
                why = self._explain_timeout(work)
                job, attempt = work.job, work.claim.attempt
                self._write_record(
                    JobRecord(
                        job.number, job.name, FAILED, str(why), work.seconds, self.name, attempt, (why,)
                    )
                )

    def _leave_job(self, slot: Slot, work: RunningJob) -> None:
        """Leave a job to the worker that has taken it over.

        That worker records the outcome.
        """
        self._free_slot(slot, 0)
        self._scheduler.record_takeover(work.claim.number)
        why = "another worker has taken it over while this worker was unresponsive"
        self._on_event(Notice(f"{work.job.name}: {why}"))

    def _kill_job(self, slot: Slot, work: RunningJob) -> None:
        process, slot.process = slot.process, None
        if process is not None and not process.kill():
            why = "its process cannot be killed, because it is waiting for a drive"
            self._on_event(Notice(f"{work.job.name}: {why}"))
        # If drafts cannot be removed now, the next run removes them.
        with suppress(StageError):
            Cache(self._queue.cache).remove_abandoned()

    def _explain_timeout(self, work: RunningJob) -> Diagnostic:
        if work.is_blocked:
            return BATCH_SCAN_STUCK.error(
                "ended after waiting {seconds:g} s for another run into {folder}",
                remedy="end the other run, and run the batch again.",
                seconds=self._timeout,
                folder=self._queue.get_output_folder(work.job),
            )
        where = f"in {work.stage}" if work.stage else "while reading its files"
        return BATCH_SCAN_STUCK.error(
            "ended after {seconds:g} s without progress {place}",
            remedy="check that the drive of the scan responds, or increase worker.timeout, and run the batch "
            "again: it continues from the cache.",
            place=where,
            seconds=self._timeout,
        )

    def _free_slot(self, slot: Slot, written: int) -> None:
        self._admission.remove_job(slot, written)
        slot.work = None

    def _write_record(self, record: JobRecord) -> None:
        named = record if record.name else replace(record, name=self._get_job_name(record.number))
        self._records.write(named)
        self._scheduler.record_end(named.number)
        self._on_event(JobEnded(named))

    def _get_job_name(self, number: int) -> str:
        job = self._jobs.get(number)
        return f"job {number}" if job is None else job.name

    def _stop_jobs(self) -> None:
        """Interrupt running jobs and release them for other workers."""
        for slot in self._slots:
            if slot.process is not None and slot.work is not None:
                slot.process.interrupt()
        for slot in self._slots:
            if slot.process is not None:
                slot.process.end()
            if slot.work is not None:
                # If the claim cannot be written, others see from the heartbeat that this worker has ended.
                with suppress(OSError):
                    self._claims.record_end(slot.work.claim, RELEASED)


def _format_exit_code(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"exit code {code}"
