"""Progress events of a worker, passed to a single callback."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from scanloom.pipeline.batch.records import Record


@dataclass(frozen=True)
class JobBegun:
    """A worker started a job.

    Attributes
    ----------
    name : name of the scan.
    attempt : attempt number; above 0 for a retry or a takeover.
    """

    name: str
    attempt: int


@dataclass(frozen=True)
class JobAt:
    """Progress of a job: completed ratio of its current stage."""

    name: str
    stage: str
    share: float


@dataclass(frozen=True)
class JobEnded:
    """A job of this worker ended."""

    record: Record


@dataclass(frozen=True)
class Counted:
    """Number of ended jobs of all workers, and total number."""

    ended: int
    total: int


@dataclass(frozen=True)
class Noted:
    """Notice for the user."""

    text: str


Told = JobBegun | JobAt | JobEnded | Counted | Noted


class Tell(Protocol):
    """Callback for worker events, called from the worker's thread."""

    def __call__(self, told: Told) -> None:
        """Handle an event."""


def untold(told: Told) -> None:
    """Ignore an event."""
