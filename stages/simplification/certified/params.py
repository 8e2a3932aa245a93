"""Parameters of method `certified` only."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.params import check_parameters, param


@dataclass(frozen=True, kw_only=True)
class CertifiedParams:
    """Parameters of method `certified`."""

    tight_bounds: bool = param(
        False,
        "Bound each triangle as tightly as possible, which takes two to four times as long. "
        "Otherwise the bounds of a triangle may equal max_shape and max_color (or the "
        "largest colour difference, without max_color), although smaller ones are true.",
    )

    def __post_init__(self) -> None:
        check_parameters(self)
