"""The limits of method `jia01`, and its rule."""

from __future__ import annotations

from dataclasses import dataclass

from stages.params import check, param
from stages.simplification.shared_params import HOW_FAR, BoundKeywords, ScaleKeywords, require_finite


@dataclass(frozen=True, kw_only=True)
class Jia01Params:
    """The limits of method `jia01`, and its rule."""

    max_shape: float | None = param(
        None,
        "Largest shape change, summed over the collapses around an edge. Default: 0.1 of the resolution, but "
        "at most 0.5 % of the diagonal.",
        unit="m",
        low=0,
        low_open=True,
        group=HOW_FAR,
    )
    max_color: float | None = param(
        None,
        "The strongest contrast in the neighbourhood of a collapse, summed over the collapses around an "
        "edge, which far exceeds the colour error that results. Default: 400.",
        unit="8-bit levels",
        low=0,
        group=HOW_FAR,
    )
    attribute_scale: float | None = param(
        None,
        "Length that weighs as much as one level of colour. Default: max_shape / max_color.",
        unit="m per level",
        low=0,
    )
    resolution: float | None = param(
        None,
        "Wanted edge length: longer edges are split first, and do not collapse. Default: 36 times the mean "
        "edge length, more where splitting would add over 5 % of triangles.",
        unit="m",
        low=0,
        low_open=True,
    )
    paper_rule: bool = param(
        False,
        "Follow the paper: check the bounds after each collapse, so that the last one may overshoot, and "
        "measure shape at vertices only. Otherwise they are checked before, and between vertices too; bounds "
        "then hold.",
    )

    def __post_init__(self) -> None:
        check(self)
        require_finite(self, "resolution", "max_shape", "max_color", "attribute_scale")


class Jia01Keywords(BoundKeywords, ScaleKeywords, total=False):
    """Jia01Params as keywords of `simplify`."""

    resolution: float | None
    paper_rule: bool
