"""Progress bar: label, count, rate and time left."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress
from rich.text import Text

from scanloom.stages.progress import Progress


class _RateColumn(ProgressColumn):
    """Recent rate in units per second."""

    def __init__(self, unit: str) -> None:
        super().__init__()
        self._unit = unit

    def render(self, task: Task) -> Text:
        if not task.speed:
            return Text("")
        speed = f"{task.speed:,.0f}" if task.speed >= 10 else f"{task.speed:.1f}"
        return Text(f"{speed} {self._unit}/s", style="progress.data.speed")


@contextmanager
def draw_progress_bar(label: str, unit: str) -> Iterator[Progress]:
    """Draw a progress bar on stderr while the block runs."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        _RateColumn(unit or "steps"),
        TimeRemainingColumn(),
    )
    with RichProgress(*columns, console=Console(stderr=True), transient=True) as display:
        task = display.add_task(label, total=None)

        def update(done: int, total: int) -> None:
            display.update(task, completed=done, total=total or None)

        yield update
