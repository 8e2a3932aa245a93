"""What method `cut` has to tell."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.simplification.result import Details


@dataclass(frozen=True, eq=False, kw_only=True)
class CutDetails(Details):
    """What method `cut` has to tell."""

    removed: int

    def describe(self) -> str:
        """Say it in words."""
        return f"Cut off: {self.removed} triangles."
