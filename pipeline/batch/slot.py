"""Slot of a worker, and progress of the job that runs in it."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from scanloom.pipeline.batch.claims import Claim
from scanloom.pipeline.batch.process import Process
from scanloom.pipeline.batch.queue import Job


@dataclass
class Work:
    """Running job.

    Attributes
    ----------
    stage : current stage.
    share : completed ratio of the stage, 0 to 1.
    is_queueing : True while the job waits for permission to start, which cannot hang.
    is_waiting : True while the job waits for another run into the same folder.
    silent : seconds without progress.
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
        """Seconds since the job started."""
        return round(time.monotonic() - self._begun, 3)

    def at(self, stage: str, share: float) -> None:
        """Record progress.

        A repeated message is not progress, because an endless loop can send it, too.
        """
        if (stage, share) != (self.stage, self.share) or self.is_waiting:
            self.stage, self.share, self.is_waiting, self.silent = stage, share, False, 0.0

    def passed(self, seconds: float) -> None:
        """Add seconds without progress, unless the job waits for permission to start."""
        self.silent = 0.0 if self.is_queueing else self.silent + seconds


@dataclass
class Slot:
    """Slot for one job.

    Attributes
    ----------
    process : job process; None if not started.
    work : running job; None if the slot is free.
    ran : number of jobs that the process has run.
    """

    process: Process | None = None
    work: Work | None = None
    ran: int = 0
