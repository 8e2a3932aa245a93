"""Result details of method `seams`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.printing import format_by_fields, render_table
from scanloom.stages.simplification.blocked_edges import report_lock_blocking, report_topology_blocking
from scanloom.stages.simplification.codes import SIMPLIFY_SEAM_DRIFT
from scanloom.stages.simplification.result import Details, SimplificationResult

# Texels. Larger shifts of the texture are visible next to a seam.
_VISIBLE_DRIFT_TEXELS = 16
# Minimum ratio of refused edges to report the drift bound as the reason. CartoonHouses has 3 %, and removing
# the bound hardly changes its triangle count.
_MIN_DRIFT_RATIO = 0.2


@dataclass(frozen=True, eq=False, kw_only=True)
class SeamsDetails(Details):
    """Result details of method `seams`.

    Attributes
    ----------
    attribute_scale_m_per_level : metres that weigh as much as one level of colour; 0 without colours.
    fitted : True if vertices were fitted to the input at the end.
    similar_distance_m : vertices closer than this were joined.
    joined_vertices : number of input vertices that duplicate others.
    texture_scale_m : metres that weigh as much as a shift by the image's side.
    seam_drift : proven bound on the distance in the image between a seam and its position in the input, as a
        ratio of the image's side.
    seam_drift_texels : the same in texels of the largest image; None without images.
    """

    __repr__ = format_by_fields
    _repr_html_ = render_table

    headline: ClassVar[str] = (
        "{triangles:,} triangles, stopped by {stopped_by}; {joined_vertices:,} duplicate "
        "vertices joined, seams moved by up to {seam_drift:.2%} of the image's side"
    )

    attribute_scale_m_per_level: float
    fitted: bool
    similar_distance_m: float
    joined_vertices: int
    texture_scale_m: float
    seam_drift: float
    seam_drift_texels: float | None

    def report(self, result: SimplificationResult[Any]) -> None:
        """Warn about blocked edges, and about seams that moved in the image."""
        report_topology_blocking(result)
        report_lock_blocking(result)
        self._report_drift(result)

    def _report_drift(self, result: SimplificationResult[Any]) -> None:
        refused = sum(result.refused.values())
        is_main = result.refused.get("drift", 0) > _MIN_DRIFT_RATIO * refused
        if result.stopped_by == "bounds" and is_main:
            emit(
                SIMPLIFY_SEAM_DRIFT.warning(
                    "the triangle count was not reached, because texture seams would move "
                    "too far in the image",
                    remedy="give a larger max_seam_drift.",
                )
            )
        elif self.seam_drift_texels is not None and self.seam_drift_texels > _VISIBLE_DRIFT_TEXELS:
            emit(
                SIMPLIFY_SEAM_DRIFT.warning(
                    "texture seams moved by up to {texels:.0f} texels in the image, so the "
                    "texture may be visibly shifted next to seams",
                    remedy="give a smaller max_seam_drift, or keep more triangles.",
                    texels=self.seam_drift_texels,
                )
            )
