"""Which jobs may begin: those whose expected memory fits beside that of the others, as they asked in turn."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

S = TypeVar("S")


@dataclass(frozen=True)
class Needs:
    """What a job is expected to take, bytes."""

    memory: int
    disk: int


class Admission(Generic[S]):
    """Lets jobs begin side by side.

    One that needs more than there is runs alone: what is expected may be wrong. None is overtaken, so that a
    large one does not wait for ever.

    Parameters
    ----------
    memory : bytes for all together; None lets all begin at once.
    disk : bytes that all may write; None for no limit.
    is_limit : a job is ended that takes more memory.
    """

    def __init__(self, memory: int | None, disk: int | None, *, is_limit: bool) -> None:
        self._memory = memory
        self._disk = disk
        self._is_limit = is_limit
        self._waiting: deque[tuple[S, Needs]] = deque()
        self._running: list[tuple[S, Needs]] = []

    def ask(self, who: S, needs: Needs) -> None:
        """Ask for a job to begin."""
        self._waiting.append((who, needs))

    def admitted(self) -> Iterator[tuple[S, dict[str, Any]]]:
        """Return who may begin now, and what each may take at most: `memory`, `disk`; None for no limit."""
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

    def leave(self, who: S, written: int) -> None:
        """Take note that a job has ended, which has written so many bytes."""
        self._waiting = deque(one for one in self._waiting if one[0] is not who)
        self._running = [one for one in self._running if one[0] is not who]
        if self._disk is not None:
            self._disk -= written
