"""Result details of method `quadric`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from scanloom.stages.printing import by_fields, table
from scanloom.stages.simplification.crowding import report_crowded_by_topology
from scanloom.stages.simplification.result import Details, Simplified


@dataclass(frozen=True, eq=False, kw_only=True)
class QuadricDetails(Details):
    """Result details of method `quadric`.

    Attributes
    ----------
    attribute_scale_m_per_level : metres that weigh as much as one level of colour.
    fitted : True if vertices and colours were fitted to the input at the end.
    """

    __repr__ = by_fields
    _repr_html_ = table

    headline: ClassVar[str] = (
        "{triangles:,} triangles, stopped by {stopped_by}; a level of colour counted as "
        "{attribute_scale_m_per_level:.3g} m"
    )

    attribute_scale_m_per_level: float
    fitted: bool

    def report(self, result: Simplified[Any]) -> None:
        """Warn if most remaining edges cannot collapse because of the topology."""
        report_crowded_by_topology(result)
