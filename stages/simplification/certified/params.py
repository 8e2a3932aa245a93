"""Parameters of method `certified` only."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.params import check, param


@dataclass(frozen=True, kw_only=True)
class CertifiedParams:
    """Parameters of method `certified`."""

    close_bounds: bool = param(
        False,
        "Bound each triangle as closely as can be, in two to four times the time. Otherwise the bounds of a "
        "triangle may be as large as max_shape and max_color (without it, as the largest difference of "
        "colour there is) though less is true.",
    )

    def __post_init__(self) -> None:
        check(self)
