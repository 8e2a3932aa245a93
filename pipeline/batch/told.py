"""What a worker tells while it works; whoever watches passes one function that takes these."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from scanloom.pipeline.batch.records import Record


@dataclass(frozen=True)
class JobBegun:
    """A scan is taken in hand.

    Attributes
    ----------
    attempt : from 0; more where it is taken over, or begun again.
    """

    name: str
    attempt: int


@dataclass(frozen=True)
class JobAt:
    """A scan's stage has finished this share of its work."""

    name: str
    stage: str
    share: float


@dataclass(frozen=True)
class JobEnded:
    """A scan came to an end, by this worker."""

    record: Record


@dataclass(frozen=True)
class Counted:
    """So many of all scans have come to an end, by whichever worker."""

    ended: int
    total: int


@dataclass(frozen=True)
class Noted:
    """Something a person should know."""

    text: str


Told = JobBegun | JobAt | JobEnded | Counted | Noted


class Tell(Protocol):
    """Called from the thread of the worker."""

    def __call__(self, told: Told) -> None:
        """Take note of one thing."""


def untold(told: Told) -> None:
    """Take note of what nobody watches."""
