"""Parameters of method `jia01` only."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.params import check_parameters, param


@dataclass(frozen=True, kw_only=True)
class Jia01Params:
    """Parameters of method `jia01`."""

    resolution: float | None = param(
        None,
        "Target edge length: longer edges are split first, and do not collapse. Default: 1.33 times the mean "
        "edge length weighted by length, or more if few triangles are needed or many edges would be split. "
        "With a triangle count, longer edges collapse last by default. inf: no limit, and no edge is split.",
        unit="m",
        low=0,
        low_open=True,
    )
    paper_rule: bool = param(
        False,
        "Follow the paper exactly: check the bounds after each collapse, so that the last "
        "one may exceed them, and measure shape at vertices only. Otherwise the bounds are "
        "checked before each collapse and between vertices, so that they hold.",
    )

    def __post_init__(self) -> None:
        check_parameters(self)
