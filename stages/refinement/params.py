"""Parameters of refinement."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.params import check_parameters, param


@dataclass(frozen=True, kw_only=True)
class RefineParams:
    """Parameters of `refine`."""

    strength: float = param(
        1.0,
        "Scale of the maximum displacement: at 1, a vertex moves by up to three standard deviations of its "
        "position. 0 leaves the mesh as it is.",
        low=0,
        high=10,
        common=True,
    )
    planes: bool = param(
        True,
        "Make patches planar that are planar within the noise, with straight creases between them.",
    )

    fill_holes: float | None = param(
        None,
        "Fill holes whose border is at most this long, if no frame has looked through them; 0 fills none. "
        "Default: 20 times the mean edge length.",
        unit="m",
        low=0,
    )

    def __post_init__(self) -> None:
        check_parameters(self)
