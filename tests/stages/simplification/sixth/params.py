"""Parameters of method `cut`."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.params import check_parameters, param


@dataclass(frozen=True, kw_only=True)
class CutParams:
    """Parameters of method `cut`."""

    max_height: float | None = param(None, "Height above which nothing stays.", unit="m", common=True)
    slope: float = param(0.25, "How much the height grows along x.", low=0)

    def __post_init__(self) -> None:
        check_parameters(self)
