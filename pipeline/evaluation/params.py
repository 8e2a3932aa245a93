"""Parameters of the report."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.params import check_parameters, param


@dataclass(frozen=True, kw_only=True)
class ReportParams:
    """Measurements and pictures of the result, and the page."""

    enabled: bool = param(
        True,
        "Measure the result against the meshes of earlier stages, and draw them; required for the page.",
        # Only decides if the stage runs, so the cache key ignores it.
        invalidates=False,
        common=True,
    )
    pictures: bool = param(True, "Draw the mesh of each stage as PNG files.")

    viewpoints: int = param(3, "Number of viewpoints; every mesh is drawn from each.", low=1, high=100)
    width: int = param(800, "Width of a picture.", unit="px", low=64, high=4096)
    photos: int = param(
        24,
        "Number of small photos, spread evenly over the scan, that the page can overlay on the result.",
        low=0,
        high=1000,
    )
    page: bool = param(
        True,
        "Write report.html, a page that shows the result in any browser.",
        invalidates=False,
        common=True,
    )
    page_size: float = param(
        5.0,
        "Maximum size of the page; its models are simplified to fit.",
        unit="MB",
        low=1.2,
        invalidates=False,
    )

    def __post_init__(self) -> None:
        check_parameters(self)
