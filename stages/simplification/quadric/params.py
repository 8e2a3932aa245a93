"""How method `quadric` weighs colour, and whether it fits."""

from __future__ import annotations

from dataclasses import dataclass

from stages.params import check, param
from stages.simplification.shared_params import FitKeywords, ScaleKeywords, require_finite


@dataclass(frozen=True, kw_only=True)
class QuadricParams:
    """How method `quadric` weighs colour, and whether it fits."""

    attribute_scale: float | None = param(
        None,
        "Length that weighs as much as one level of colour. Default: derived from the mesh and the number of "
        "triangles.",
        unit="m per level",
        low=0,
    )
    fit: bool = param(
        True,
        "Move vertices and colours to fit the input by least squares at the end; boundaries stay.",
    )

    def __post_init__(self) -> None:
        check(self)
        require_finite(self, "attribute_scale")


class QuadricKeywords(ScaleKeywords, FitKeywords, total=False):
    """QuadricParams as keywords of `simplify`."""
