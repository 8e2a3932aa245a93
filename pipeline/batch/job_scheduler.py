"""Scheduling within a worker: take unclaimed jobs first, then jobs of dead workers.

Unclaimed jobs are tried in order; the folder of claims is listed only once, at the start. After all jobs have
been tried, unfinished jobs are checked at intervals for dead workers.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator

from scanloom.pipeline.batch.claims import CRASHED, Claim, ClaimContent, Claims
from scanloom.pipeline.batch.codes import BATCH_PROCESS_ENDED
from scanloom.pipeline.batch.heartbeat import HeartbeatObserver
from scanloom.pipeline.batch.job_queue import BatchQueue
from scanloom.pipeline.batch.job_records import FAILED, JobRecord, JobRecords

# Maximum attempts that end in the same stage without a result, and maximum crashes. Beyond either, the job
# has failed.
_MAX_ATTEMPTS, _MAX_CRASHES = 6, 2
# Interval of checks as a ratio of `take_over_after`, and its minimum and maximum in seconds.
_CHECK_RATIO, _MIN_INTERVAL, _MAX_INTERVAL = 0.05, 0.05, 3.0


class JobScheduler:
    """Scheduler that hands out claims to the slots of a worker.

    Parameters
    ----------
    patience : seconds of silence after which a worker is presumed dead.
    only : numbers of the jobs to take; None for all.
    """

    def __init__(
        self,
        queue: BatchQueue,
        claims: Claims,
        records: JobRecords,
        observer: HeartbeatObserver,
        take_over_after: float,
        only: frozenset[int] | None = None,
    ) -> None:
        self._logs = queue.folder / "workers"
        self._claims = claims
        self._records = records
        self._observer = observer
        self._take_over_after = take_over_after
        self._pause = min(max(_CHECK_RATIO * take_over_after, _MIN_INTERVAL), _MAX_INTERVAL)
        self._numbers = [number for number in queue.numbers if only is None or number in only]
        self._ended = {*records.list_ended()}
        self._own_claims: dict[int, Claim] = {}
        self._retries: deque[Claim] = deque()
        self._given_up: list[JobRecord] = []
        taken = claims.list_latest()
        self._unclaimed = deque(number for number in self._numbers if number not in taken)
        self._next_look = 0.0

    def take_next(self) -> Claim | None:
        """Claim the next job; None if no job is available now."""
        while self._retries:
            claim = self._retries.popleft()
            if not self._is_hopeless(claim) and self._try_take(claim.successor):
                return claim.successor
        while self._unclaimed:
            claim = Claim(self._unclaimed.popleft(), 0)
            if self._try_take(claim):
                return claim
        if time.monotonic() < self._next_look:
            return None
        self._next_look = time.monotonic() + self._pause
        return self._take_over_job()

    def schedule_retry(self, claim: Claim) -> None:
        """Schedule a retry of an own job that ended without a result."""
        self._own_claims.pop(claim.number, None)
        self._retries.append(claim)

    def record_takeover(self, number: int) -> None:
        """Record that another worker has taken over an own job."""
        self._own_claims.pop(number, None)

    def record_end(self, number: int) -> None:
        """Record that an own job ended."""
        self._own_claims.pop(number, None)
        self._ended.add(number)

    def pop_given_up(self) -> Iterator[JobRecord]:
        """Yield failure records of jobs that exceeded the maximum attempts, for the caller to write."""
        while self._given_up:
            yield self._given_up.pop()

    def count_ended(self) -> tuple[int, int]:
        """Return the number of jobs known to have ended, and the total number."""
        return len(self._ended), len(self._numbers)

    def has_more(self) -> bool:
        """Return True if jobs are untried or scheduled for a retry."""
        return bool(self._unclaimed or self._retries)

    def is_finished(self) -> bool:
        """Return True if every job has ended."""
        return not self.has_more() and all(one in self._ended for one in self._numbers)

    def _take_over_job(self) -> Claim | None:
        self._observer.refresh()
        self._ended.update(self._records.list_ended())
        latest = self._claims.list_latest()
        for number in self._numbers:
            if number in self._ended or number in self._own_claims:
                continue
            claim = latest.get(number)
            if claim is None:
                following = Claim(number, 0)
            elif self._is_worker_alive(claim, self._claims.read_claim(claim)) or self._is_hopeless(claim):
                continue
            else:
                following = claim.successor
            if self._try_take(following):
                return following
        return None

    def _try_take(self, claim: Claim) -> bool:
        if not self._claims.take(claim):
            return False
        self._own_claims[claim.number] = claim
        return True

    def _is_worker_alive(self, claim: Claim, content: ClaimContent) -> bool:
        if content.end is not None:
            return False
        # If the claiming worker has not written its name yet, the claim itself is watched for silence.
        return not self._observer.is_dead(
            content.worker or f"{claim.number}.{claim.attempt}", self._take_over_after
        )

    def _is_hopeless(self, claim: Claim) -> bool:
        """Return True if a job ended too often without a result.

        A failure record is then queued.
        """
        tries = self._claims.read_attempts(claim)
        crashes = sum(one.end == CRASHED for one in tries)
        last = tries[-1].stage if tries else ""
        alike = 0
        for one in reversed(tries):
            if one.stage != last:
                break
            alike += 1
        if crashes < _MAX_CRASHES and alike < _MAX_ATTEMPTS:
            return False
        where = f" in {last}" if last else ""
        how = f"crashed {crashes} times" if crashes >= _MAX_CRASHES else f"was killed {alike} times"
        worker = tries[-1].worker if tries else ""
        why = BATCH_PROCESS_ENDED.error(
            "the process of this scan {how}{place}, possibly because memory ran out; run the scan alone, or "
            "with larger voxels. The output of the process is in {log}.",
            how=how,
            place=where,
            log=f"{self._logs / worker}.log",
        )
        self._given_up.append(
            JobRecord(
                claim.number, "", FAILED, str(why), worker=worker, attempt=claim.attempt, diagnostics=(why,)
            )
        )
        self._ended.add(claim.number)
        return True
