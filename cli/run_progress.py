"""Progress of a run: a bar or lines while a stage works, and one line for each finished stage."""

from __future__ import annotations

import re
import string
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from scanloom.cli.output import Output
from scanloom.cli.transient_progress import TransientProgress
from scanloom.pipeline.graph import find_stage
from scanloom.pipeline.run.events import (
    RunEvent,
    RunEventHandler,
    RunStarted,
    RunWaiting,
    StageFinished,
    StageProgress,
    StageStarted,
)
from scanloom.stages.printing import format_upper_bound
from scanloom.stages.progress import Progress

# A metric in metres in a stage's format string.
_IN_METRES = re.compile(r"(\{\w+_m(?:_per_level)?:\S+?\}) m\b")


@contextmanager
def show_run_progress(out: Output) -> Iterator[RunEventHandler]:
    """Show progress, and yield the callback for the events of a run."""
    watcher = _Watcher(out)
    try:
        watcher.bar.show("scan", "files")
        yield watcher
    finally:
        watcher.bar.close()


class _Watcher:
    def __init__(self, out: Output) -> None:
        self._out = out
        self.bar = TransientProgress(out)
        self._is_metric = True

    def __call__(self, event: RunEvent) -> None:
        match event:
            case RunStarted():
                self._started(event)
            case StageStarted():
                if not self._out.has_progress_bar:
                    self._out.remark(f"{event.stage}: started ({event.reason})")
                self._bar_of(event.stage)
            case StageProgress():
                self._bar_of(event.stage)(event.done, event.total)
            case StageFinished():
                self._out.remark(format_stage(event, is_metric=self._is_metric))
            case RunWaiting():
                self._out.remark(event.text)

    def _started(self, event: RunStarted) -> None:
        self._is_metric = event.is_metric
        self._out.remark(f"{event.layout}, {event.frames:,} frames; stages: {', '.join(event.stages)}")

    def _bar_of(self, stage: str) -> Progress:
        known = find_stage(stage)
        # Before the first stage, the files of the scan are read.
        return self.bar.show(stage, "files" if known is None else known.progress_unit)


def format_stage(event: StageFinished, *, is_metric: bool = True) -> str:
    """Return the line of a finished stage: name, cached or seconds, headline, reason."""
    state = "cached" if event.cached else f"{event.seconds:.1f} s"
    reason = f" ({event.reason})" if event.reason else ""
    came_out = headline(event.stage, event.metrics, is_metric=is_metric)
    return f"{event.stage:<9}{state:>8}  {came_out}{reason}".rstrip()


def headline(stage: str, metrics: Mapping[str, Any], *, is_metric: bool = True) -> str:
    """Return the most important metrics of a stage in one line; in units if the scan is not metric."""
    known = find_stage(stage)
    summary = "" if known is None else known.headline
    line = summary if isinstance(summary, str) else summary(metrics)
    line = line if is_metric else _IN_METRES.sub(r"\1 units", line)
    return _Figures({**metrics, **metrics.get("details", {})}).format(line)


class _Figures(string.Formatter):
    """Formatter of metrics by name; a missing metric is a dash."""

    def __init__(self, metrics: Mapping[str, Any]) -> None:
        self._metrics = metrics

    def get_value(self, key: int | str, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:  # noqa: ARG002
        value = self._metrics.get(str(key))
        return len(value) if isinstance(value, list) else value

    def format_field(self, value: Any, format_spec: str) -> str:
        if value is None:
            return "–"
        return format_upper_bound(value) if format_spec == "at_most" else format(value, format_spec)
