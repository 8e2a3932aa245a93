"""Scheduling within a worker: take unclaimed jobs first, then jobs of dead workers.

Unclaimed jobs are tried in order; the folder of claims is listed only once, at the start. After all jobs have
been tried, unfinished jobs are checked at intervals for dead workers.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator

from scanloom.pipeline.batch.claims import CRASHED, Claim, Claims, Said
from scanloom.pipeline.batch.codes import BATCH_PROCESS_ENDED
from scanloom.pipeline.batch.heartbeat import Watch
from scanloom.pipeline.batch.queue import Queue
from scanloom.pipeline.batch.records import FAILED, Record, Records

# Attempts that end in the same stage without a result, and crashes, after which a job is given up.
_MOST_TRIES, _MOST_CRASHES = 6, 2
# Interval of checks as a ratio of `patience`, and its minimum and maximum in seconds.
_SHARE, _SHORTEST, _LONGEST = 0.05, 0.05, 3.0


class Supply:
    """Scheduler that hands out claims to the slots of a worker.

    Parameters
    ----------
    patience : seconds of silence after which a worker is presumed dead.
    only : numbers of the jobs to take; None for all.
    """

    def __init__(
        self,
        queue: Queue,
        claims: Claims,
        records: Records,
        watch: Watch,
        patience: float,
        only: frozenset[int] | None = None,
    ) -> None:
        self._logs = queue.folder / "workers"
        self._claims = claims
        self._records = records
        self._watch = watch
        self._patience = patience
        self._pause = min(max(_SHARE * patience, _SHORTEST), _LONGEST)
        self._numbers = [number for number in queue.numbers if only is None or number in only]
        self._ended = {*records.ended()}
        self._mine: dict[int, Claim] = {}
        self._again: deque[Claim] = deque()
        self._given_up: list[Record] = []
        taken = claims.latest()
        self._ahead = deque(number for number in self._numbers if number not in taken)
        self._next_look = 0.0

    def next(self) -> Claim | None:
        """Claim the next job; None if no job is available now."""
        while self._again:
            claim = self._again.popleft()
            if not self._is_hopeless(claim) and self._took(claim.next):
                return claim.next
        while self._ahead:
            claim = Claim(self._ahead.popleft(), 0)
            if self._took(claim):
                return claim
        if time.monotonic() < self._next_look:
            return None
        self._next_look = time.monotonic() + self._pause
        return self._taken_over()

    def again(self, claim: Claim) -> None:
        """Schedule a retry of an own job that ended without a result."""
        self._mine.pop(claim.number, None)
        self._again.append(claim)

    def lost(self, number: int) -> None:
        """Record that another worker has taken over an own job."""
        self._mine.pop(number, None)

    def ended(self, number: int) -> None:
        """Record that an own job ended."""
        self._mine.pop(number, None)
        self._ended.add(number)

    def given_up(self) -> Iterator[Record]:
        """Yield failure records of jobs that were given up, for the caller to write."""
        while self._given_up:
            yield self._given_up.pop()

    def counted(self) -> tuple[int, int]:
        """Return the number of jobs known to have ended, and the total number."""
        return len(self._ended), len(self._numbers)

    def has_more(self) -> bool:
        """Return True if jobs are untried or scheduled for a retry."""
        return bool(self._ahead or self._again)

    def is_finished(self) -> bool:
        """Return True if every job has ended."""
        return not self.has_more() and all(one in self._ended for one in self._numbers)

    def _taken_over(self) -> Claim | None:
        self._watch.look()
        self._ended.update(self._records.ended())
        latest = self._claims.latest()
        for number in self._numbers:
            if number in self._ended or number in self._mine:
                continue
            claim = latest.get(number)
            if claim is None:
                following = Claim(number, 0)
            elif self._is_alive(claim, self._claims.said(claim)) or self._is_hopeless(claim):
                continue
            else:
                following = claim.next
            if self._took(following):
                return following
        return None

    def _took(self, claim: Claim) -> bool:
        if not self._claims.take(claim):
            return False
        self._mine[claim.number] = claim
        return True

    def _is_alive(self, claim: Claim, said: Said) -> bool:
        if said.end is not None:
            return False
        # If the claiming worker has not written its name yet, the claim itself is watched for silence.
        return not self._watch.is_dead(said.worker or f"{claim.number}.{claim.attempt}", self._patience)

    def _is_hopeless(self, claim: Claim) -> bool:
        """Return True if a job ended too often without a result.

        A failure record is then queued.
        """
        tries = self._claims.tries(claim)
        crashes = sum(one.end == CRASHED for one in tries)
        last = tries[-1].stage if tries else ""
        alike = 0
        for one in reversed(tries):
            if one.stage != last:
                break
            alike += 1
        if crashes < _MOST_CRASHES and alike < _MOST_TRIES:
            return False
        where = f" in {last}" if last else ""
        how = f"crashed {crashes} times" if crashes >= _MOST_CRASHES else f"was killed {alike} times"
        worker = tries[-1].worker if tries else ""
        why = BATCH_PROCESS_ENDED.error(
            "the process of this scan {how}{place}, possibly because memory ran out; run the scan alone, or "
            "with larger voxels. The output of the process is in {log}.",
            how=how,
            place=where,
            log=f"{self._logs / worker}.log",
        )
        self._given_up.append(
            Record(
                claim.number, "", FAILED, str(why), worker=worker, attempt=claim.attempt, diagnostics=(why,)
            )
        )
        self._ended.add(claim.number)
        return True
