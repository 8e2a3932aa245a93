"""Parameters of the coverage analysis."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.params import check, param


@dataclass(frozen=True, kw_only=True)
class CoverageParams:
    """Parameters of `coverage`."""

    few_frames: int | None = param(
        None,
        "Surface that fewer frames measured is thin evidence. Derived: 3, but a fifth of the frames at most.",
        unit="frames",
        low=1,
    )
    oblique: float = param(
        70.0,
        "Surface that no frame saw at a smaller angle to its normal is thin evidence.",
        unit="degrees",
        low=0,
        high=90,
    )
    far: float | None = param(
        None,
        "Surface that no frame measured from nearer is thin evidence. Derived: 2.5 times the distance from "
        "which the median place was measured best.",
        unit="m",
        low=0,
        low_open=True,
    )
    spread: float | None = param(
        None,
        "Surface that frames have measured farther off it than this, RMS, is thin evidence: they disagree "
        "where it is. Derived: 2.5 times that of the median place, but half an edge of the mesh at least.",
        unit="m",
        low=0,
        low_open=True,
    )
    least_area: float | None = param(
        None,
        "Smaller places are not told. Derived: a two-thousandth of the surface.",
        unit="m²",
        low=0,
    )
    place_size: float | None = param(
        None,
        "What is larger is told as several places, each for one look. Derived: three quarters of the "
        "distance from which the median place was measured best.",
        unit="m",
        low=0,
        low_open=True,
    )
    spacing: float | None = param(
        None,
        "How finely space that was seen through is told from space that nobody saw. Derived: four edges of "
        "the mesh, or more where the scan is large.",
        unit="m",
        low=0,
        low_open=True,
    )
    places: int = param(30, "So many places are told at most, the most important first.", low=1, high=1000)

    def __post_init__(self) -> None:
        check(self)
