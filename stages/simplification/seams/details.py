"""What method `seams` has to tell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from stages.printing import by_fields, table
from stages.simplification.crowding import crowded_by_locks, crowded_by_topology
from stages.simplification.result import Details, Simplified
from stages.simplification.seams.params import MAX_SEAM_DRIFT


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
    seam_drift : proven: no point of a seam is farther, in the image, from where it was; as a share of the
        image's side.
    """

    __repr__ = by_fields
    _repr_html_ = table

    headline: ClassVar[str] = (
        "{triangles:,} triangles, stopped by {stopped_by}; {joined_vertices:,} copies of vertices joined, "
        "seams no more than {seam_drift:.3g} of the image's side off"
    )

    attribute_scale_m_per_level: float
    fitted: bool
    similar_distance_m: float
    joined_vertices: int
    texture_scale_m: float
    seam_drift: float

    def warnings(self, result: Simplified[Any]) -> tuple[str, ...]:
        """Return what left too little to choose from, and whether seams went far in the image."""
        return (*crowded_by_topology(result), *crowded_by_locks(result), *_drifted(result, self.seam_drift))


def _drifted(result: Simplified[Any], drift: float) -> tuple[str, ...]:
    if drift > MAX_SEAM_DRIFT:
        return (
            f"texture seams went up to {drift:.2g} of the image's side from where they were, so that "
            "the image is warped beside them; give a smaller max_seam_drift, or keep more triangles.",
        )
    if result.stopped_by == "bounds" and result.refused.get("drift", 0):
        return (
            "there are more triangles than were asked for, since texture seams would go too far in the "
            "image; give a larger max_seam_drift to go on.",
        )
    return ()
