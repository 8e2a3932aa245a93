"""Progress of a run, for a function that watches it. Diagnostics are emitted, not told as events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol


@dataclass(frozen=True)
class RunStarted:
    """The scan is read, and the stages to come are known.

    Attributes
    ----------
    is_metric : metres in figures are metres, else units of the scan's world.
    """

    layout: str
    frames: int
    stages: tuple[str, ...]
    is_metric: bool = True


@dataclass(frozen=True)
class StageStarted:
    """A stage begins to work; `reason` says why the cache could not answer for it."""

    stage: str
    reason: str


@dataclass(frozen=True)
class StageProgress:
    """A working stage has finished `done` of `total` units; stage "scan" is the hashing of its files."""

    stage: str
    done: int
    total: int


@dataclass(frozen=True)
class StageFinished:
    """A stage's result is there, from the cache or made now.

    Attributes
    ----------
    cached : the cache had it.
    seconds : spent in this run.
    reason : why it was made; empty when cached.
    figures : what came out, JSON-able, units in the names.
    results : the files it placed in the output folder.
    """

    stage: str
    cached: bool
    seconds: float
    reason: str = ""
    figures: Mapping[str, Any] = field(default_factory=dict)
    results: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Waiting:
    """Nothing goes on for a while, and `text` says why: another run works into the same folder."""

    text: str


Event = RunStarted | StageStarted | StageProgress | StageFinished | Waiting


class Events(Protocol):
    """Called from the working thread; raising from it stops the run."""

    def __call__(self, event: Event) -> None:
        """Take note of one event."""


def unwatched(event: Event) -> None:
    """Events that nobody watches."""
