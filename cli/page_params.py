"""Parameters of pages that a command writes."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.params import check_parameters, param


@dataclass(frozen=True, kw_only=True)
class PageParams:
    """Page in one file."""

    size: float = param(
        5.0, "Maximum size of the page; its models are simplified to fit.", unit="MB", low=1.2
    )

    def __post_init__(self) -> None:
        check_parameters(self)

    @property
    def max_bytes(self) -> int:
        """Return the size in bytes."""
        return int(1e6 * self.size)
