"""Result details of method `cut`."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.simplification.result import Details


@dataclass(frozen=True, eq=False, kw_only=True)
class CutDetails(Details):
    """Result details of method `cut`."""

    removed: int

    def describe(self) -> str:
        """Describe the result in a sentence."""
        return f"Cut off: {self.removed} triangles."
