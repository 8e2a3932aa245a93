"""What a person sees of a run: a bar while a stage works, and one line when it is done."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any

from cli.options import as_typed
from cli.output import Output, name_and_value
from pipeline.events import Event, Events, RunStarted, StageFinished, StageProgress, StageStarted, Warned
from stages.progress import Progress

# What is counted while a stage works.
_UNITS = {"scan": "files", "depth": "pairs", "fuse": "frames", "simplify": "collapses"}
# What came out of a stage and what was derived for it, in one line; all figures are in report.json.
_HEADLINES = {
    "depth": ("frames_used", "used_share", "median_depth_m", "max_depth_m"),
    "fuse": ("triangles", "voxel_size_m", "truncation_m", "max_depth_m", "frames_used"),
    "clean": ("triangles",),
    "simplify": ("triangles", "resolution_m", "max_shape_m", "max_texture_levels", "stopped_by"),
}


@contextmanager
def watching(out: Output) -> Iterator[Events]:
    """Give the function a run tells its events to."""
    watcher = _Watcher(out)
    try:
        yield watcher
    finally:
        watcher.close()


class _Watcher:
    def __init__(self, out: Output) -> None:
        self._out = out
        self._bar = ExitStack()
        self._update: Progress | None = None
        self._bar_stage = ""

    def __call__(self, event: Event) -> None:
        match event:
            case RunStarted():
                self._started(event)
            case StageStarted():
                self._show_bar(event.stage)
            case StageProgress():
                self._show_bar(event.stage)
                if self._update is not None:
                    self._update(event.done, event.total)
            case StageFinished():
                self.close()
                self._out.remark(line_of(event))
            case Warned():
                self.close()
                self._out.remark(f"warning: {event.text}")

    def close(self) -> None:
        """Take the bar away."""
        self._bar.close()
        self._update, self._bar_stage = None, ""

    def _started(self, event: RunStarted) -> None:
        self.close()
        self._out.remark(f"{event.layout}, {event.frames:,} frames; stages: {', '.join(event.stages)}")
        for warning in event.warnings:
            self._out.remark(as_typed(f"warning: {warning}"))

    def _show_bar(self, stage: str) -> None:
        if stage != self._bar_stage:
            self.close()
            self._update = self._bar.enter_context(self._out.progress(stage, _UNITS.get(stage, "steps")))
            self._bar_stage = stage


def line_of(event: StageFinished) -> str:
    """Return the line of a finished stage: its name, cached or the seconds, what came out, why it ran."""
    state = "cached" if event.cached else f"{event.seconds:.1f} s"
    reason = f" ({event.reason})" if event.reason else ""
    return f"{event.stage:<9}{state:>8}  {headline(event.stage, event.figures)}{reason}".rstrip()


def headline(stage: str, figures: Mapping[str, Any]) -> str:
    """Return the figures of a stage that say most, as one line."""
    words = [name_and_value(key, figures.get(key)) for key in _HEADLINES.get(stage, ())]
    return ", ".join(f"{name} {value}" for name, value in words)
