"""Progress events of a run. Diagnostics are emitted separately."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol


@dataclass(frozen=True)
class RunStarted:
    """The scan was read and the stages were planned.

    Attributes
    ----------
    is_metric : True if lengths in metrics are in metres; False if in units of the scan.
    """

    layout: str
    frames: int
    stages: tuple[str, ...]
    is_metric: bool = True


@dataclass(frozen=True)
class StageStarted:
    """A stage started to compute, because of a cache miss explained by `reason`."""

    stage: str
    reason: str


@dataclass(frozen=True)
class StageProgress:
    """Progress of a stage in its own units.

    The stage "scan" is the hashing of the scan files.
    """

    stage: str
    done: int
    total: int


@dataclass(frozen=True)
class StageFinished:
    """The result of a stage is available.

    Attributes
    ----------
    cached : True if the result was in the cache.
    seconds : time spent in this run.
    reason : why the result was computed; empty if cached.
    metrics : JSON-ready metrics, with units in the keys.
    results : files placed in the output folder.
    """

    stage: str
    cached: bool
    seconds: float
    reason: str = ""
    metrics: Mapping[str, Any] = field(default_factory=dict)
    results: tuple[Path, ...] = ()


@dataclass(frozen=True)
class RunWaiting:
    """The run is blocked by another run, as stated in `text`."""

    text: str


RunEvent = RunStarted | StageStarted | StageProgress | StageFinished | RunWaiting


class RunEventHandler(Protocol):
    """Event callback, called from the working thread; exceptions raised from it stop the run."""

    def __call__(self, event: RunEvent) -> None:
        """Handle an event."""


def ignore_run_event(event: RunEvent) -> None:
    """Ignore an event."""
