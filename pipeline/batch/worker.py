"""A worker: takes jobs of a queue, one for each of its slots, until none is left.

It only claims, watches and writes down; jobs run in processes of their own
(`scanloom.pipeline.batch.process`), so that no job can keep it from beating, or take it along.
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

# A process is replaced after so many jobs: what libraries leave behind in memory does not pile up.
_JOBS_A_PROCESS = 64
# Seconds that nothing is heard for, at most, until it is looked for work again.
_PAUSE = 0.5
# Seconds that one turn counts for at most: what a machine sleeps, or a worker is stopped for, is no fault of
# a job.
_LONGEST_TURN = 10.0
# Of what systems send to end a process, SIGKILL and SIGTERM; what others end by is their own fault.
_KILLING = (-9, -15)


class Worker:
    """Works on a queue.

    Parameters
    ----------
    slots : jobs at a time.
    threads : of each.
    memory : bytes that all jobs may take together; None where it is not known.
    is_limit : `memory` was asked for, and ends jobs that take more; else it only decides how many run at a
        time.
    only : numbers of the jobs to work on; None for all.
    stay : wait for the jobs of others, to take over those of who dies.
    disk : bytes that all jobs may write; None for no limit.
    take_over_after : seconds; None for what the queue says.
    timeout : seconds after which a job that gets no further is ended, 0 for never; None for what the queue
        says.
    clock : seconds that only go forward, by which `timeout` is counted.
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
        """Work until every job has come to an end, by this worker or another, or there is none to take.

        Raises
        ------
        StageError
            If the queue cannot be written to; what is finished stays, and what is not is left to others.
        """
        with (
            explained(f"the queue {self._queue.folder} cannot be worked on"),
            Heartbeat(self._queue.folder / "workers", self.name, self._patience),
        ):
            try:
                self._work()
            except FileNotFoundError:
                # It may go between two looks at it.
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
        """Raise StageError where a later batch has removed this one, as it may when no worker gave a sign."""
        if not self._queue.folder.is_dir():
            raise StageError(
                BATCH_WORKER_STOPPED,
                (
                    "another batch was begun in {out} while this worker gave no sign of life; "
                    "what it had finished is in the cache."
                ),
                out=self._queue.out,
            )

    def _begin(self, slot: Slot, claim: Claim) -> None:
        job = self._jobs.get(claim.number)
        if job is None:
            where = self._queue.folder / "jobs.jsonl"
            why = f"{where}: the line of this job is damaged; run the batch again, which writes it anew."
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
        """Take what processes say, until nothing is waiting."""
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
            why = f"{self._queue.scan_of(job)}: the scan is not there any more."
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
        """Begin a job again whose process ended by itself; what it had finished is in the cache."""
        self._free(slot, 0)
        self._claims.end(work.claim, KILLED if code in _KILLING else CRASHED)
        self._supply.again(work.claim)
        how = f"the process that ran it ended by itself ({_how(code)}) in {work.stage}"
        self._tell(Noted(f"{work.job.name}: {how}"))

    def _look_after(self) -> None:
        """End jobs that others have taken over, and those that get no further."""
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
        """Leave a job to who has taken it over: what becomes of it is theirs to say."""
        self._free(slot, 0)
        self._supply.lost(work.claim.number)
        why = "another worker has taken it over while this one gave no sign of life"
        self._tell(Noted(f"{work.job.name}: {why}"))

    def _kill(self, slot: Slot, work: Work) -> None:
        process, slot.process = slot.process, None
        if process is not None and not process.kill():
            why = "the system cannot end its process, which waits for a drive"
            self._tell(Noted(f"{work.job.name}: {why}"))
        # If it cannot be, the next run does it.
        with suppress(StageError):
            Cache(self._queue.cache).remove_abandoned()

    def _why_ended(self, work: Work) -> Diagnostic:
        if work.is_waiting:
            return BATCH_SCAN_STUCK.error(
                "it waited {seconds:g} s for another run that is working into {folder}, and was ended",
                remedy="end that one, and run the batch again.",
                seconds=self._timeout,
                folder=self._queue.results_of(work.job),
            )
        where = f"in {work.stage}" if work.stage else "while its files were read"
        return BATCH_SCAN_STUCK.error(
            "it got no further {place} for {seconds:g} s and was ended",
            remedy="see whether the drive of its files answers, or give a longer worker.timeout, and run the "
            "batch again: it goes on from what is in the cache.",
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
        """Have jobs that still run put away what they were writing, and leave them to others."""
        for slot in self._slots:
            if slot.process is not None and slot.work is not None:
                slot.process.interrupt()
        for slot in self._slots:
            if slot.process is not None:
                slot.process.end()
            if slot.work is not None:
                # If it cannot be written, others see that this worker has ended.
                with suppress(OSError):
                    self._claims.end(slot.work.claim, RELEASED)


def _how(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"exit code {code}"
