"""Admission control: start queued jobs in order while their expected memory fits."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

S = TypeVar("S")


@dataclass(frozen=True)
class JobNeeds:
    """Expected memory and disk use of a job, in bytes."""

    memory: int
    disk: int


class AdmissionControl(Generic[S]):
    """First-in-first-out admission of jobs by expected memory.

    A job that exceeds the total memory still runs, alone, because the expectation may be wrong. Jobs never
    overtake each other, so a large job does not starve.

    Parameters
    ----------
    memory : bytes for all running jobs together; None admits all jobs at once.
    disk : bytes that all jobs may write in total; None for no limit.
    is_limit : True to also enforce `memory` as a limit on each job.
    """

    def __init__(self, memory: int | None, disk: int | None, *, is_limit: bool) -> None:
        self._memory = memory
        self._disk = disk
        self._is_limit = is_limit
        self._waiting: deque[tuple[S, JobNeeds]] = deque()
        self._running: list[tuple[S, JobNeeds]] = []

    def enqueue(self, slot: S, needs: JobNeeds) -> None:
        """Queue a job for admission."""
        self._waiting.append((slot, needs))

    def pop_admissible(self) -> Iterator[tuple[S, dict[str, Any]]]:
        """Yield the jobs that may start now, each with its limits.

        The limits are a dict with `memory` and `disk` in bytes; None for no limit.
        """
        while self._waiting:
            who, needs = self._waiting[0]
            taken = sum(one.memory for _, one in self._running)
            if self._running and self._memory is not None and taken + needs.memory > self._memory:
                return
            self._waiting.popleft()
            reserved = sum(one.disk for _, one in self._running)
            self._running.append((who, needs))
            yield (
                who,
                {
                    "memory": None if self._memory is None or not self._is_limit else self._memory - taken,
                    "disk": None if self._disk is None else max(self._disk - reserved, 0),
                },
            )

    def remove_job(self, slot: S, written_bytes: int) -> None:
        """Remove a finished job and deduct the bytes it wrote from the disk budget."""
        self._waiting = deque(one for one in self._waiting if one[0] is not slot)
        self._running = [one for one in self._running if one[0] is not slot]
        if self._disk is not None:
            self._disk -= written_bytes
