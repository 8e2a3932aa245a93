"""Result details of method `quadric`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from scanloom.stages.printing import format_by_fields, render_table
from scanloom.stages.simplification.blocked_edges import report_topology_blocking
from scanloom.stages.simplification.result import Details, SimplificationResult


@dataclass(frozen=True, eq=False, kw_only=True)
class QuadricDetails(Details):
    """Result details of method `quadric`.

    Attributes
    ----------
    attribute_scale_m_per_level : metres that weigh as much as one level of colour.
    fitted : True if vertices and colours were fitted to the input at the end.
    """

    __repr__ = format_by_fields
    _repr_html_ = render_table

    headline: ClassVar[str] = (
        "{triangles:,} triangles, stopped by {stopped_by}; a level of colour counted as "
        "{attribute_scale_m_per_level:.3g} m"
    )

    attribute_scale_m_per_level: float
    fitted: bool

    def report(self, result: SimplificationResult[Any]) -> None:
        """Warn if most remaining edges cannot collapse because of the topology."""
        report_topology_blocking(result)
