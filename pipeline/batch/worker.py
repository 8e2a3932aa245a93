"""Worker that runs jobs of a queue, one per slot.

The worker only claims, watches and records. Jobs run in subprocesses (`scanloom.pipeline.batch.process`), so
that no job can block the heartbeat or crash the worker.
"""

from __future__ import annotations

import queue as queues
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from scanloom.pipeline.batch.admission import Admission, Needs
from scanloom.pipeline.batch.claims import CRASHED, KILLED, RELEASED, Claim, Claims
from scanloom.pipeline.batch.codes import BATCH_SCAN_STUCK, BATCH_WORKER_STOPPED
from scanloom.pipeline.batch.heartbeat import Heartbeat, Watch, name_of_worker
from scanloom.pipeline.batch.process import Message, Process
from scanloom.pipeline.batch.queue import Queue
from scanloom.pipeline.batch.records import FAILED, UNUSABLE, Record, Records
from scanloom.pipeline.batch.slot import Slot, Work
from scanloom.pipeline.batch.supply import Supply
from scanloom.pipeline.batch.told import Counted, JobAt, JobBegun, JobEnded, Noted, Tell, untold
from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.failures import explained
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import StageError

# Jobs after which a job process is replaced, to bound memory leaks of libraries.
_JOBS_A_PROCESS = 64
# Maximum seconds to wait for messages before looking for jobs again.
_PAUSE = 0.5
# Maximum seconds that one loop iteration adds to a job's time without progress: a suspended machine or a
# stopped worker must not count against the job.
_LONGEST_TURN = 10.0
# Exit codes for SIGKILL and SIGTERM, sent by the system; any other signal counts as a crash.
_KILLING = (-9, -15)


class Worker:
    """Worker on a queue.

    Parameters
    ----------
    slots : number of concurrent jobs.
    threads : threads per job.
    memory : bytes for all jobs together; None if unknown.
    is_limit : True if `memory` is a limit that ends jobs; False if it only bounds how many jobs run
        concurrently.
    disk : bytes that all jobs may write in total; None for no limit.
    take_over_after : seconds of silence after which a worker is presumed dead; None for the setting of the
        queue.
    timeout : seconds without progress after which a job is ended, 0 for never; None for the setting of the
        queue.
    only : numbers of the jobs to run; None for all.
    stay : True to wait for jobs of other workers, and take over those of dead workers.
    tell : callback for progress events.
    clock : monotonic clock in seconds, for `timeout`.
    """

    def __init__(
        self,
        queue: Queue,
        *,
        slots: int,
        threads: int,
        memory: int | None = None,
        is_limit: bool = False,
        disk: int | None = None,
        take_over_after: float | None = None,
        timeout: float | None = None,
        only: frozenset[int] | None = None,
        stay: bool = True,
        tell: Tell = untold,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name = name_of_worker()
        self._queue = queue
        self._threads = threads
        self._stay = stay
        self._tell = tell
        self._patience = take_over_after or queue.settings.take_over_after
        self._timeout = queue.settings.timeout if timeout is None else timeout
        self._clock = clock
        self._turned = clock()
        self._claims = Claims(queue.folder / "claims", self.name)
        self._records = Records(queue.folder / "done")
        watch = Watch(queue.folder / "workers")
        self._supply = Supply(queue, self._claims, self._records, watch, self._patience, only)
        self._admission: Admission[Slot] = Admission(memory, disk, is_limit=is_limit)
        self._inbox: queues.SimpleQueue[tuple[Process, Message]] = queues.SimpleQueue()
        self._slots = [Slot() for _ in range(slots)]
        self._jobs = {job.number: job for job in queue.jobs}

    def work(self) -> None:
        """Run jobs until all have ended or none can be taken.

        Jobs of other workers count, too.

        Raises
        ------
        StageError
            If the queue cannot be written to. Finished jobs keep their records; others are left to other
            workers.
        """
        with (
            explained(f"the queue {self._queue.folder} cannot be worked on"),
            Heartbeat(self._queue.folder / "workers", self.name, self._patience),
        ):
            try:
                self._work()
            except FileNotFoundError:
                # The queue may be removed between two checks.
                self._require_standing()
                raise
            finally:
                self._stop()

    def _work(self) -> None:
        while True:
            self._require_standing()
            for slot in self._slots:
                while slot.work is None and (claim := self._supply.next()) is not None:
                    self._begin(slot, claim)
            for record in self._supply.given_up():
                self._end(record)
            self._tell(Counted(*self._supply.counted()))
            if all(slot.work is None for slot in self._slots) and (
                self._supply.is_finished() or not (self._stay or self._supply.has_more())
            ):
                return
            self._hear()
            self._look_after()

    def _require_standing(self) -> None:
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

    def _begin(self, slot: Slot, claim: Claim) -> None:
        job = self._jobs.get(claim.number)
        if job is None:
            where = self._queue.folder / "jobs.jsonl"
            why = f"{where}: the line of this job is damaged; run the batch again to rewrite it."
            self._end(Record(claim.number, "", FAILED, why, worker=self.name, attempt=claim.attempt))
            return
        slot.work = Work(job, claim)
        if slot.process is None:
            slot.process, slot.ran = Process(self._inbox, self._threads, self._log), 0
        settings = self._queue.settings
        slot.process.say(
            {
                "name": job.name,
                "scan": str(self._queue.scan_of(job)),
                "out": str(self._queue.results_of(job)),
                "cache": str(self._queue.cache),
                "config": settings.config,
                "until": settings.until,
                "force": settings.force,
                "overwrite": settings.overwrite,
            }
        )
        self._tell(JobBegun(job.name, claim.attempt))

    @property
    def _log(self) -> Path:
        return self._queue.folder / "workers" / f"{self.name}.log"

    def _hear(self) -> None:
        """Handle messages of job processes until the inbox is empty."""
        pause = _PAUSE
        while True:
            try:
                process, message = self._inbox.get(timeout=pause)
            except queues.Empty:
                return
            slot = next((one for one in self._slots if one.process is process), None)
            if slot is not None:
                self._take(slot, message)
            for granted, leave in self._admission.admitted():
                if granted.process is not None and granted.work is not None:
                    granted.work.is_queueing = False
                    granted.process.say(leave)
            pause = 0.0

    def _take(self, slot: Slot, message: Message) -> None:
        work = slot.work
        if "gone" in message:
            if slot.process is not None:
                slot.process.end()
            slot.process = None
            if work is not None:
                self._gone(slot, work, message["gone"])
        elif work is None:
            return
        elif "needs" in message:
            needs = message["needs"]
            work.is_queueing = True
            self._admission.ask(slot, Needs(needs["memory"], needs["disk"]))
        elif "at" in message:
            if message["at"] != work.stage:
                self._claims.at(work.claim, message["at"])
            work.at(message["at"], message["share"])
            self._tell(JobAt(work.job.name, work.stage, work.share))
        elif "waiting" in message:
            work.is_waiting = True
            self._tell(Noted(f"{work.job.name}: {message['waiting']}"))
        elif "ended" in message:
            self._ended(slot, work, message["ended"])

    def _ended(self, slot: Slot, work: Work, said: Message) -> None:
        job = work.job
        slot.ran += 1
        if slot.ran >= _JOBS_A_PROCESS and slot.process is not None:
            slot.process.end()
            slot.process = None
        if self._claims.is_lost(work.claim):
            self._lost(slot, work)
            return
        self._free(slot, said["written"])
        state, why = said["state"], said["reason"]
        if state == UNUSABLE and not self._queue.scan_of(job).exists():
            why = f"{self._queue.scan_of(job)}: the scan does not exist any more."
        record = Record(
            job.number,
            job.name,
            state,
            why,
            said["seconds"],
            self.name,
            work.claim.attempt,
            tuple(Diagnostic.from_figures(one) for one in said["diagnostics"]),
            said["figures"],
        )
        self._end(record)

    def _gone(self, slot: Slot, work: Work, code: int) -> None:
        """Retry a job whose process exited; finished stages are in the cache."""
        self._free(slot, 0)
        self._claims.end(work.claim, KILLED if code in _KILLING else CRASHED)
        self._supply.again(work.claim)
        how = f"its process ended unexpectedly ({_how(code)}) in {work.stage}; the scan is run again"
        self._tell(Noted(f"{work.job.name}: {how}"))

    def _look_after(self) -> None:
        """Kill jobs that other workers have taken over or that exceed the timeout."""
        now = self._clock()
        passed, self._turned = min(now - self._turned, _LONGEST_TURN), now
        for slot in self._slots:
            work = slot.work
            if work is None:
                continue
            work.passed(passed)
            if self._claims.is_lost(work.claim):
                self._kill(slot, work)
                self._lost(slot, work)
            elif self._timeout and work.silent > self._timeout:
                self._kill(slot, work)
                self._free(slot, 0)
                why = self._why_ended(work)
                job, attempt = work.job, work.claim.attempt
                self._end(
                    Record(job.number, job.name, FAILED, str(why), work.seconds, self.name, attempt, (why,))
                )

    def _lost(self, slot: Slot, work: Work) -> None:
        """Leave a job to the worker that has taken it over.

        That worker records the outcome.
        """
        self._free(slot, 0)
        self._supply.lost(work.claim.number)
        why = "another worker has taken it over while this worker was unresponsive"
        self._tell(Noted(f"{work.job.name}: {why}"))

    def _kill(self, slot: Slot, work: Work) -> None:
        process, slot.process = slot.process, None
        if process is not None and not process.kill():
            why = "its process cannot be killed, because it is waiting for a drive"
            self._tell(Noted(f"{work.job.name}: {why}"))
        # If drafts cannot be removed now, the next run removes them.
        with suppress(StageError):
            Cache(self._queue.cache).remove_abandoned()

    def _why_ended(self, work: Work) -> Diagnostic:
        if work.is_waiting:
            return BATCH_SCAN_STUCK.error(
                "ended after waiting {seconds:g} s for another run into {folder}",
                remedy="end the other run, and run the batch again.",
                seconds=self._timeout,
                folder=self._queue.results_of(work.job),
            )
        where = f"in {work.stage}" if work.stage else "while reading its files"
        return BATCH_SCAN_STUCK.error(
            "ended after {seconds:g} s without progress {place}",
            remedy="check that the drive of the scan responds, or increase worker.timeout, and run the batch "
            "again: it continues from the cache.",
            place=where,
            seconds=self._timeout,
        )

    def _free(self, slot: Slot, written: int) -> None:
        self._admission.leave(slot, written)
        slot.work = None

    def _end(self, record: Record) -> None:
        named = record if record.name else replace(record, name=self._name(record.number))
        self._records.write(named)
        self._supply.ended(named.number)
        self._tell(JobEnded(named))

    def _name(self, number: int) -> str:
        job = self._jobs.get(number)
        return f"job {number}" if job is None else job.name

    def _stop(self) -> None:
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
                    self._claims.end(slot.work.claim, RELEASED)


def _how(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"exit code {code}"
