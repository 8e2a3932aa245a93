"""A progress bar that is there while nothing else is written: for one thing, then for another."""

from __future__ import annotations

from contextlib import ExitStack

from scanloom.cli.output import Output
from scanloom.stages.progress import Progress, silent


class PassingBar:
    """The bar of one command."""

    def __init__(self, out: Output) -> None:
        self._out = out
        self._shown = ExitStack()
        self._label = ""
        self._update: Progress = silent
        out.before_line = self.close

    def show(self, label: str, unit: str) -> Progress:
        """Draw the bar of a thing, and return the function that moves it."""
        if label != self._label:
            self.close()
            self._update = self._shown.enter_context(self._out.progress(label, unit))
            self._label = label
        return self._update

    def close(self) -> None:
        """Take the bar away."""
        self._shown.close()
        self._label = ""
