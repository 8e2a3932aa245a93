"""Progress bar that is hidden while other output is written, for consecutive tasks."""

from __future__ import annotations

from contextlib import ExitStack

from scanloom.cli.output import Output
from scanloom.stages.progress import Progress, ignore_progress


class TransientProgress:
    """Progress bar of one command."""

    def __init__(self, out: Output) -> None:
        self._out = out
        self._shown = ExitStack()
        self._label = ""
        self._update: Progress = ignore_progress
        out.before_line = self.close

    def show(self, label: str, unit: str) -> Progress:
        """Show the bar of a task, and return the function that updates it."""
        if label != self._label:
            self.close()
            self._update = self._shown.enter_context(self._out.progress(label, unit))
            self._label = label
        return self._update

    def close(self) -> None:
        """Remove the bar."""
        self._shown.close()
        self._label = ""
