"""What method `jia01` has to tell: its limits, and how far they were used."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from scanloom.stages.printing import by_fields, table
from scanloom.stages.simplification.crowding import report_crowded_by_topology
from scanloom.stages.simplification.result import Details, Simplified


@dataclass(frozen=True, eq=False, kw_only=True)
class Jia01Details(Details):
    """The limits of JIA01, and how far they were used.

    Attributes
    ----------
    attribute_scale_m_per_level : metres that weighed as much as one level of colour.
    largest_shape_change_m, largest_color_change_levels : largest sums on any edge at any time.
    resolution_m, max_shape_m, max_color_levels : what was used.
    bounded : whether resolution, max_shape and max_color were bounds, or only ordered the collapses.
    splits : edges that were split.
    """

    __repr__ = by_fields
    _repr_html_ = table

    headline: ClassVar[str] = (
        "{triangles:,} triangles, stopped by {stopped_by}; resolution {resolution_m:.3g} m, largest change "
        "of shape {largest_shape_change_m:.3g} m, of texture {largest_color_change_levels:,.0f} levels"
    )

    attribute_scale_m_per_level: float
    largest_shape_change_m: float
    largest_color_change_levels: float
    resolution_m: float
    max_shape_m: float
    max_color_levels: float
    bounded: dict[str, bool]
    splits: int

    def report(self, result: Simplified[Any]) -> None:
        """Warn if the topology left too little to choose from on the way to a number of triangles."""
        if result.stopped_by == "triangles":
            report_crowded_by_topology(result)
