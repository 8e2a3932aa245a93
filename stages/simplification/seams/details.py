"""What method `seams` has to tell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.printing import by_fields, table
from scanloom.stages.simplification.codes import SIMPLIFY_SEAM_DRIFT
from scanloom.stages.simplification.crowding import report_crowded_by_locks, report_crowded_by_topology
from scanloom.stages.simplification.result import Details, Simplified

# Shifts of the texture by more texels than this are visible next to a seam.
_VISIBLE_DRIFT_TEXELS = 16
# Share of the refused edges from which the bound on drift is named as the reason. CartoonHouses has 3 %, and
# hardly fewer triangles without the bound.
_MIN_SHARE = 0.2


@dataclass(frozen=True, eq=False, kw_only=True)
class SeamsDetails(Details):
    """What method `seams` has to tell.

    Attributes
    ----------
    attribute_scale_m_per_level : metres that weighed as much as one level of colour; 0 without colours.
    fitted : whether vertices were moved to fit the input at the end.
    similar_distance_m : vertices closer than this were taken for one.
    joined_vertices : how many vertices of the input were copies of others.
    texture_scale_m : metres that a shift by the image's side counted as.
    seam_drift : proven bound on the distance in the image between a seam and its position in the input, as a
        share of the image's side.
    seam_drift_texels : the same in texels of the largest image; None without images.
    """

    __repr__ = by_fields
    _repr_html_ = table

    headline: ClassVar[str] = (
        "{triangles:,} triangles, stopped by {stopped_by}; {joined_vertices:,} copies of vertices joined, "
        "seams moved by up to {seam_drift:.2%} of the image's side"
    )

    attribute_scale_m_per_level: float
    fitted: bool
    similar_distance_m: float
    joined_vertices: int
    texture_scale_m: float
    seam_drift: float
    seam_drift_texels: float | None

    def report(self, result: Simplified[Any]) -> None:
        """Warn of edges that could not collapse, and of seams that moved in the image."""
        report_crowded_by_topology(result)
        report_crowded_by_locks(result)
        self._report_drift(result)

    def _report_drift(self, result: Simplified[Any]) -> None:
        refused = sum(result.refused.values())
        is_main = result.refused.get("drift", 0) > _MIN_SHARE * refused
        if result.stopped_by == "bounds" and is_main:
            emit(
                SIMPLIFY_SEAM_DRIFT.warning(
                    "there are more triangles than were asked for, since texture seams would move too far in "
                    "the image",
                    remedy="give a larger max_seam_drift to go on.",
                )
            )
        elif self.seam_drift_texels is not None and self.seam_drift_texels > _VISIBLE_DRIFT_TEXELS:
            emit(
                SIMPLIFY_SEAM_DRIFT.warning(
                    "texture seams moved by up to {texels:.0f} texels in the image, so the texture may be "
                    "shifted beside them",
                    remedy="give a smaller max_seam_drift, or keep more triangles.",
                    texels=self.seam_drift_texels,
                )
            )
