"""Progress events of a worker, passed to a single callback."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from scanloom.pipeline.batch.job_records import JobRecord


@dataclass(frozen=True)
class JobStarted:
    """A worker started a job.

    Attributes
    ----------
    name : name of the scan.
    attempt : attempt number; above 0 for a retry or a takeover.
    """

    name: str
    attempt: int


@dataclass(frozen=True)
class JobProgress:
    """Progress of a job: completed ratio of its current stage."""

    name: str
    stage: str
    completed_ratio: float


@dataclass(frozen=True)
class JobEnded:
    """A job of this worker ended."""

    record: JobRecord


@dataclass(frozen=True)
class QueueProgress:
    """Number of ended jobs of all workers, and total number."""

    ended: int
    total: int


@dataclass(frozen=True)
class Notice:
    """Notice for the user."""

    text: str


WorkerEvent = JobStarted | JobProgress | JobEnded | QueueProgress | Notice


class WorkerEventHandler(Protocol):
    """Callback for worker events, called from the worker's thread."""

    def __call__(self, event: WorkerEvent) -> None:
        """Handle an event."""


def ignore_worker_event(event: WorkerEvent) -> None:
    """Ignore an event."""
