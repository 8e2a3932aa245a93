"""Slot of a worker, and progress of the job that runs in it."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from scanloom.pipeline.batch.claims import Claim
from scanloom.pipeline.batch.job_queue import Job
from scanloom.pipeline.batch.process_handle import JobProcess


@dataclass
class RunningJob:
    """Progress of a running job.

    Attributes
    ----------
    stage : current stage.
    completed_ratio : completed ratio of the stage, 0 to 1.
    is_awaiting_admission : True while the job waits for permission to start. This time does not count as
        idle.
    is_blocked : True while the job waits for another run that uses the same output folder.
    idle_seconds : seconds without progress.
    """

    job: Job
    claim: Claim
    stage: str = ""
    completed_ratio: float = 0.0
    is_awaiting_admission: bool = False
    is_blocked: bool = False
    idle_seconds: float = 0.0
    _started_at: float = field(default_factory=time.monotonic)

    @property
    def seconds(self) -> float:
        """Seconds since the job started."""
        return round(time.monotonic() - self._started_at, 3)

    def record_progress(self, stage: str, share: float) -> None:
        """Record progress.

        A repeated message is not progress, because an endless loop can send it, too.
        """
        if (stage, share) != (self.stage, self.completed_ratio) or self.is_blocked:
            self.stage, self.completed_ratio, self.is_blocked, self.idle_seconds = stage, share, False, 0.0

    def add_idle_time(self, seconds: float) -> None:
        """Add seconds without progress, unless the job waits for permission to start."""
        self.idle_seconds = 0.0 if self.is_awaiting_admission else self.idle_seconds + seconds


@dataclass
class Slot:
    """Slot for one job.

    Attributes
    ----------
    process : job process; None if not started.
    work : running job; None if the slot is free.
    finished_count : number of jobs that the process has run.
    """

    process: JobProcess | None = None
    work: RunningJob | None = None
    finished_count: int = 0
