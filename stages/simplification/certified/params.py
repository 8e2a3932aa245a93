"""The bounds that method `certified` proves, and how closely."""

from __future__ import annotations

from dataclasses import dataclass

from stages.params import check, param
from stages.simplification.shared_params import HOW_FAR, BoundKeywords, ScaleKeywords, require_finite


@dataclass(frozen=True, kw_only=True)
class CertifiedParams:
    """The bounds that method `certified` proves, and how closely."""

    max_shape: float | None = param(
        None,
        "Largest distance of any point of either surface from the other. Default: 0.5 % of the bounding "
        "box's diagonal, as colours alone do not hold a shape.",
        unit="m",
        low=0,
        low_open=True,
        group=HOW_FAR,
    )
    max_color: float | None = param(
        None,
        "Largest difference, Euclidean over the channels, between the colour at any point of either surface "
        "and that at any nearest point of the other. Default: no bound.",
        unit="8-bit levels",
        low=0,
        group=HOW_FAR,
    )
    attribute_scale: float | None = param(
        None,
        "Length that weighs as much as one level of colour. Default: derived from the mesh.",
        unit="m per level",
        low=0,
    )
    close_bounds: bool = param(
        False,
        "Bound each triangle as closely as can be, in two to four times the time. Otherwise the bounds of a "
        "triangle may be as large as max_shape and max_color (without it, as the largest difference of "
        "colour there is) though less is true.",
    )

    def __post_init__(self) -> None:
        check(self)
        require_finite(self, "max_shape", "max_color", "attribute_scale")


class CertifiedKeywords(BoundKeywords, ScaleKeywords, total=False):
    """CertifiedParams as keywords of `simplify`."""

    close_bounds: bool
