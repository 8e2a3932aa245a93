"""Which job a worker takes next: one that nobody has, else one of a worker that is dead.

Jobs that nobody has are tried in their order: whoever makes a claim first has it, and a folder is listed once
only, at the beginning. When all have been tried, what is not finished is looked through every now and then.
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

# A job is given up after so many tries that ended in one stage without a result, and so many that crashed.
_MOST_TRIES, _MOST_CRASHES = 6, 2
# Seconds between two looks, as a share of those after which a worker is taken for dead, and their bounds.
_SHARE, _SHORTEST, _LONGEST = 0.05, 0.05, 3.0


class Supply:
    """Hands out claims.

    Parameters
    ----------
    patience : seconds of silence after which a worker is taken for dead.
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
        """Return a claim that is ours now, or None if there is nothing to take at the moment."""
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
        """Take note that a job of ours ended without a result: it is tried again, or given up."""
        self._mine.pop(claim.number, None)
        self._again.append(claim)

    def lost(self, number: int) -> None:
        """Take note that another has taken over a job of ours."""
        self._mine.pop(number, None)

    def ended(self, number: int) -> None:
        """Take note that a job of ours came to an end."""
        self._mine.pop(number, None)
        self._ended.add(number)

    def given_up(self) -> Iterator[Record]:
        """Return what has to be written of jobs that were given up."""
        while self._given_up:
            yield self._given_up.pop()

    def counted(self) -> tuple[int, int]:
        """Return how many jobs have come to an end, as far as known, and how many there are."""
        return len(self._ended), len(self._numbers)

    def has_more(self) -> bool:
        """Return whether there are jobs that were not tried yet, or that have to be again."""
        return bool(self._ahead or self._again)

    def is_finished(self) -> bool:
        """Return whether every job has come to an end."""
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
        # Of a claim whose maker has not come to write its name, the claim itself is watched.
        return not self._watch.is_dead(said.worker or f"{claim.number}.{claim.attempt}", self._patience)

    def _is_hopeless(self, claim: Claim) -> bool:
        """Return whether a job ended too often without a result; it is then given up."""
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
            "the process that ran it {how}{place}, as it does where memory ends; run this scan alone, or "
            "with larger voxels. Its output is in {log}.",
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
