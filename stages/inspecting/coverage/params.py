"""Parameters of the coverage analysis."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.params import check_parameters, param


@dataclass(frozen=True, kw_only=True)
class CoverageParams:
    """Parameters of `coverage`."""

    few_frames: int | None = param(
        None,
        "Surface measured by fewer frames is weakly observed. Derived: 3, but at most a fifth of the frames.",
        unit="frames",
        low=1,
    )
    max_angle: float = param(
        70.0,
        "Surface that no frame observed at a smaller angle to its normal is weakly observed.",
        unit="degrees",
        low=0,
        high=90,
    )
    max_distance: float | None = param(
        None,
        "Surface that no frame measured from a smaller distance is weakly observed. Derived: 2.5 times the "
        "median viewing distance.",
        unit="m",
        low=0,
        low_open=True,
    )
    spread: float | None = param(
        None,
        "Surface whose measurements deviate from it by more than this, RMS, is inconsistent. Derived: 2.5 "
        "times the median deviation, but at least half the median edge of the mesh.",
        unit="m",
        low=0,
        low_open=True,
    )
    min_area: float | None = param(
        None,
        "Minimum area of a defect; smaller ones are ignored. Derived: 1/2000 of the surface.",
        unit="m²",
        low=0,
    )
    max_patch_size: float | None = param(
        None,
        "Maximum size of a defect. Larger ones are split, so that each can be captured in one view. Derived: "
        "three quarters of the median viewing distance.",
        unit="m",
        low=0,
        low_open=True,
    )
    spacing: float | None = param(
        None,
        "Cell size of the grid that separates observed from unobserved space. Derived: four median edges of "
        "the mesh, or more for large scans.",
        unit="m",
        low=0,
        low_open=True,
    )
    max_defects: int = param(
        30, "Maximum number of defects listed, the most important first.", low=1, high=1000
    )

    def __post_init__(self) -> None:
        check_parameters(self)
