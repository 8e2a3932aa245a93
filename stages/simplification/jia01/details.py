"""Result details of method `jia01`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from scanloom.stages.printing import format_by_fields, render_table
from scanloom.stages.simplification.blocked_edges import report_topology_blocking
from scanloom.stages.simplification.result import Details, SimplificationResult


@dataclass(frozen=True, eq=False, kw_only=True)
class Jia01Details(Details):
    """Limits of method `jia01`, and the largest changes that occurred.

    Attributes
    ----------
    attribute_scale_m_per_level : metres that weigh as much as one level of colour.
    largest_shape_change_m, largest_color_change_levels : maximum accumulated change on any edge at any time.
    resolution_m, max_shape_m, max_color_levels : limits that were applied.
    bounded : for resolution, max_shape and max_color: True if it was a bound, False if it only affected the
        order of collapses.
    splits : number of edges that were split.
    """

    __repr__ = format_by_fields
    _repr_html_ = render_table

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

    def report(self, result: SimplificationResult[Any]) -> None:
        """Warn if most remaining edges cannot collapse because of the topology."""
        if result.stopped_by == "triangles":
            report_topology_blocking(result)
