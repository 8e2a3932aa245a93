"""What a person sees of a run: a bar while a stage works, and one line when it is done."""

from __future__ import annotations

import re
import string
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from cli.options import as_typed
from cli.output import Output
from cli.passing_bar import PassingBar
from pipeline.events import (
    Event,
    Events,
    RunStarted,
    StageFinished,
    StageProgress,
    StageStarted,
    Waiting,
    Warned,
)
from stages.printing import at_most
from stages.progress import Progress
from stages.simplification.methods import METHODS

# What is counted while a stage works.
_UNITS = {
    "scan": "files",
    "depth": "pairs",
    "fuse": "frames",
    "coverage": "frames",
    "simplify": "triangles",
    "remesh": "levels",
    "lod": "triangles",
    "tiles": "tiles",
}
# What came out of a stage and what was derived for it, in one line; all figures are in report.json. That of
# simplify is with the method's details.
_HEADLINES = {
    "depth": "{frames_used} pairs; depth for {used_share:.0%} of the pixels, median {median_depth_m:.3g} m, "
    "up to {max_depth_m:.3g} m",
    "register": "{frames} frames of the {subject} placed; pieces: {pieces}",
    "adjust": "{why}",
    "fuse": "{triangles:,} triangles from {frames_used} frames; voxel size {voxel_size_m:.3g} m, "
    "truncation {truncation_m:.3g} m, depth up to {max_depth_m:.3g} m",
    "clean": "{triangles:,} triangles; {islands:,} islands removed",
    "upright": "what is up is told by: {up_source}",
    "texture": "{photos} photos on {triangles:,} triangles; {seen_share:.0%} of the surface seen, texels of "
    "{texel_size_m:.2g} m",
    "remesh": "{triangles:,} triangles after {levels} levels from {base_triangles:,}; "
    "{exceptions:,} exceptions; {file_bytes:,} bytes",
    "lod": "{levels} levels above {base_triangles:,} triangles within {base_shape_bound_m:at_most} m; "
    "{file_bytes:,} bytes",
    "tiles": "{tiles:,} tiles; {total_bytes:,} bytes, the root {root_bytes:,}",
    "coverage": "{places} places to go again",
    "report": "{pictures} pictures",
}
# Of a frame alone the pixels are joined, without voxels or a field.
_JOINED = "{triangles:,} triangles, the pixels of a frame alone joined; depth up to {max_depth_m:.3g} m"

# A figure in metres in such a line.
_IN_METRES = re.compile(r"(\{\w+_m(?:_per_level)?:\S+?\}) m\b")


@contextmanager
def watching(out: Output) -> Iterator[Events]:
    """Give the function a run tells its events to."""
    watcher = _Watcher(out)
    try:
        yield watcher
    finally:
        watcher.bar.close()


class _Watcher:
    def __init__(self, out: Output) -> None:
        self._out = out
        self.bar = PassingBar(out)
        self._is_metric = True

    def __call__(self, event: Event) -> None:
        match event:
            case RunStarted():
                self._started(event)
            case StageStarted():
                self._bar_of(event.stage)
            case StageProgress():
                self._bar_of(event.stage)(event.done, event.total)
            case StageFinished():
                self.bar.close()
                self._out.remark(line_of(event, is_metric=self._is_metric))
            case Warned():
                self.bar.close()
                self._out.warn(as_typed(event.text))
            case Waiting():
                self.bar.close()
                self._out.remark(event.text)

    def _started(self, event: RunStarted) -> None:
        self.bar.close()
        self._is_metric = event.is_metric
        self._out.remark(f"{event.layout}, {event.frames:,} frames; stages: {', '.join(event.stages)}")
        for warning in event.warnings:
            self._out.warn(as_typed(warning))

    def _bar_of(self, stage: str) -> Progress:
        return self.bar.show(stage, _UNITS.get(stage, "steps"))


def line_of(event: StageFinished, *, is_metric: bool = True) -> str:
    """Return the line of a finished stage: its name, cached or the seconds, what came out, why it ran."""
    state = "cached" if event.cached else f"{event.seconds:.1f} s"
    reason = f" ({event.reason})" if event.reason else ""
    came_out = headline(event.stage, event.figures, is_metric=is_metric)
    return f"{event.stage:<9}{state:>8}  {came_out}{reason}".rstrip()


def headline(stage: str, figures: Mapping[str, Any], *, is_metric: bool = True) -> str:
    """Return the figures of a stage that say most, as one line; lengths in units where they are no metres."""
    lines = _HEADLINES | {"simplify": _of_method(figures.get("method"))}
    if figures.get("truncation_m") == 0:
        lines["fuse"] = _JOINED
    line = lines.get(stage, "")
    line = line if is_metric else _IN_METRES.sub(r"\1 units", line)
    return _Figures({**figures, **figures.get("details", {})}).format(line)


def _of_method(name: str | None) -> str:
    return next((method.details.headline for method in METHODS if method.name == name), "")


class _Figures(string.Formatter):
    """Formats figures by their names; one that a stage had nothing to say for is a dash."""

    def __init__(self, figures: Mapping[str, Any]) -> None:
        self._figures = figures

    def get_value(self, key: int | str, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:  # noqa: ARG002
        value = self._figures.get(str(key))
        return len(value) if isinstance(value, list) else value

    def format_field(self, value: Any, format_spec: str) -> str:
        if value is None:
            return "–"
        return at_most(value) if format_spec == "at_most" else format(value, format_spec)
