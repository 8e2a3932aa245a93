"""Place for one job of a worker: what runs in it, how far that is, and for how long it has told nothing."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from scanloom.pipeline.batch.claims import Claim
from scanloom.pipeline.batch.process import Process
from scanloom.pipeline.batch.queue import Job


@dataclass
class Work:
    """A job that runs.

    Attributes
    ----------
    stage : that it is at.
    share : of that stage that is done.
    is_queueing : it waits for leave to begin, and for nothing that could hang.
    is_waiting : it waits for another run.
    silent : seconds for which it has told nothing new.
    """

    job: Job
    claim: Claim
    stage: str = ""
    share: float = 0.0
    is_queueing: bool = False
    is_waiting: bool = False
    silent: float = 0.0
    _begun: float = field(default_factory=time.monotonic)

    @property
    def seconds(self) -> float:
        """Since it began."""
        return round(time.monotonic() - self._begun, 3)

    def at(self, stage: str, share: float) -> None:
        """Take note of how far it is; the same again is nothing new, which what is endless tells, too."""
        if (stage, share) != (self.stage, self.share) or self.is_waiting:
            self.stage, self.share, self.is_waiting, self.silent = stage, share, False, 0.0

    def passed(self, seconds: float) -> None:
        """Take note of time in which it could have told something."""
        self.silent = 0.0 if self.is_queueing else self.silent + seconds


@dataclass
class Slot:
    """Place for one job.

    Attributes
    ----------
    work : the job that runs in it; None where it is free.
    ran : how many jobs the process has run.
    """

    process: Process | None = None
    work: Work | None = None
    ran: int = 0
