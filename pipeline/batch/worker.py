"""A worker: takes jobs of a queue, one for each of its slots, until none is left.

It only claims, watches and writes down; jobs run in processes of their own (`pipeline.batch.process`), so
that no job can keep it from beating, or take it along.
"""

from __future__ import annotations

import queue as queues
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.batch.admission import Admission, Needs
from pipeline.batch.claims import CRASHED, KILLED, RELEASED, Claim, Claims
from pipeline.batch.heartbeat import Heartbeat, Watch, name_of_worker
from pipeline.batch.process import Message, Process
from pipeline.batch.queue import Job, Queue
from pipeline.batch.records import FAILED, UNUSABLE, Record, Records
from pipeline.batch.supply import Supply
from pipeline.batch.told import Counted, JobAt, JobBegun, JobEnded, Noted, Tell, untold
from pipeline.failures import explained

# A process is replaced after so many jobs: what libraries leave behind in memory does not pile up.
_JOBS_A_PROCESS = 64
# Seconds that nothing is heard for, at most, until it is looked for work again.
_PAUSE = 0.5
# Of what systems send to end a process, SIGKILL and SIGTERM; what others end by is their own fault.
_KILLING = (-9, -15)


@dataclass
class _Slot:
    """Place for one job.

    Attributes
    ----------
    job : that runs in it, with its claim; None where it is free.
    stage : that the job is at.
    ran : how many jobs the process has run.
    """

    process: Process | None = None
    job: Job | None = None
    claim: Claim | None = None
    stage: str = ""
    ran: int = 0


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
        only: frozenset[int] | None = None,
        stay: bool = True,
        tell: Tell = untold,
    ) -> None:
        self.name = name_of_worker()
        self._queue = queue
        self._threads = threads
        self._stay = stay
        self._tell = tell
        self._patience = take_over_after or queue.settings.take_over_after
        self._claims = Claims(queue.folder / "claims", self.name)
        self._records = Records(queue.folder / "done")
        watch = Watch(queue.folder / "workers")
        self._supply = Supply(queue, self._claims, self._records, watch, self._patience, only)
        self._admission: Admission[_Slot] = Admission(memory, disk, is_limit=is_limit)
        self._inbox: queues.SimpleQueue[tuple[Process, Message]] = queues.SimpleQueue()
        self._slots = [_Slot() for _ in range(slots)]
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
            finally:
                self._stop()

    def _work(self) -> None:
        while True:
            for slot in self._slots:
                while slot.job is None and (claim := self._supply.next()) is not None:
                    self._begin(slot, claim)
            for record in self._supply.given_up():
                self._end(record)
            self._tell(Counted(*self._supply.counted()))
            if all(slot.job is None for slot in self._slots) and (
                self._supply.is_finished() or not (self._stay or self._supply.has_more())
            ):
                return
            self._hear()

    def _begin(self, slot: _Slot, claim: Claim) -> None:
        job = self._jobs.get(claim.number)
        if job is None:
            where = self._queue.folder / "jobs.jsonl"
            why = f"{where}: the line of this job is damaged; run the batch again, which writes it anew."
            self._end(Record(claim.number, "", FAILED, why, worker=self.name, attempt=claim.attempt))
            return
        slot.job, slot.claim, slot.stage = job, claim, ""
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
                if granted.process is not None:
                    granted.process.say(leave)
            pause = 0.0

    def _take(self, slot: _Slot, message: Message) -> None:
        job, claim = slot.job, slot.claim
        if "gone" in message:
            if slot.process is not None:
                slot.process.end()
            slot.process = None
            if job is not None and claim is not None:
                self._gone(slot, job, claim, message["gone"])
        elif job is None or claim is None:
            return
        elif "needs" in message:
            needs = message["needs"]
            self._admission.ask(slot, Needs(needs["memory"], needs["disk"]))
        elif "at" in message:
            if message["at"] != slot.stage:
                slot.stage = message["at"]
                self._claims.at(claim, slot.stage)
            self._tell(JobAt(job.name, slot.stage, message["share"]))
        elif "waiting" in message:
            self._tell(Noted(f"{job.name}: {message['waiting']}"))
        elif "ended" in message:
            self._ended(slot, job, claim, message["ended"])

    def _ended(self, slot: _Slot, job: Job, claim: Claim, said: Message) -> None:
        self._free(slot, said["written"])
        slot.ran += 1
        if slot.ran >= _JOBS_A_PROCESS and slot.process is not None:
            slot.process.end()
            slot.process = None
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
            claim.attempt,
            tuple(said["warnings"]),
            said["figures"],
        )
        self._end(record)

    def _gone(self, slot: _Slot, job: Job, claim: Claim, code: int) -> None:
        """Begin a job again whose process ended by itself; what it had finished is in the cache."""
        self._free(slot, 0)
        self._claims.end(claim, KILLED if code in _KILLING else CRASHED)
        self._supply.again(claim)
        self._tell(
            Noted(f"{job.name}: the process that ran it ended by itself ({_how(code)}) in {slot.stage}")
        )

    def _free(self, slot: _Slot, written: int) -> None:
        self._admission.leave(slot, written)
        slot.job = slot.claim = None

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
            if slot.process is not None and slot.job is not None:
                slot.process.interrupt()
        for slot in self._slots:
            if slot.process is not None:
                slot.process.end()
            if slot.claim is not None:
                # If it cannot be written, others see that this worker has ended.
                with suppress(OSError):
                    self._claims.end(slot.claim, RELEASED)


def _how(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"exit code {code}"
