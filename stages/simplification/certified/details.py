"""What method `certified` has to tell: what is proven."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.printing import by_fields, table
from scanloom.stages.printing.rounding import DIGITS, rounded_up
from scanloom.stages.simplification.crowding import report_crowded_by_topology
from scanloom.stages.simplification.result import Details, Simplified


@dataclass(frozen=True, eq=False, kw_only=True)
class CertifiedDetails(Details):
    """What is proven.

    Attributes
    ----------
    attribute_scale_m_per_level : metres that weighed as much as one level of colour.
    shape_bound, color_bound : (q,) float64, metres and levels, proven for each triangle, both ways: for its
        points, and for points of the input whose nearest point is on it. `color_bound` is None for a mesh
        without colours. They may be as large as `max_shape` and `max_color`, or without the latter as
        `color_bound_levels`, though less is true, unless `close_bounds` is set.
    shape_bound_m, color_bound_levels : the greatest of all, input and result.
    shape_attained_m, color_attained_levels : the greatest found at a point; the true maximum is between that
        and the bound.
    slack_m, color_slack_levels : contained in the bounds, for searches in single precision. Twice `slack_m`
        takes the place of a smaller bound on shape, and half a level that of one on colour.
    proven : whether max_shape and max_color are proven. The bounds above hold anyway.
    unproven_triangles : triangles of the result and of the input that are not proven to stay within them.
    iterations : how often it went on simplifying and then looked at the bounds.
    max_shape_m, max_color_levels : what was used; None for no bound.
    color_measured_levels : the greatest difference of colour found at samples as dense as the texels of
        images, where colours come from images; `max_color` is then held at these samples, and not proven.
    seam_drift : proven, where there are texture seams: how far a point of one is in the image from where it
        was, as a share of the image's side.
    """

    __repr__ = by_fields
    _repr_html_ = table

    headline: ClassVar[str] = (
        "{triangles:,} triangles, stopped by {stopped_by}; proven to be no more than "
        "{shape_bound_m:at_most} m and {color_bound_levels:at_most} levels off"
    )
    arrays: ClassVar[tuple[str, ...]] = ("shape_bound", "color_bound")

    attribute_scale_m_per_level: float
    shape_bound: NDArray[np.float64]
    color_bound: NDArray[np.float64] | None
    shape_bound_m: float
    color_bound_levels: float | None
    shape_attained_m: float
    color_attained_levels: float | None
    slack_m: float
    color_slack_levels: float
    proven: bool
    unproven_triangles: tuple[int, int]
    iterations: int
    max_shape_m: float
    max_color_levels: float | None
    color_measured_levels: float | None = None
    seam_drift: float | None = None

    def report(self, result: Simplified[Any]) -> None:
        """Warn if the topology left too little to choose from on the way to a number of triangles."""
        if result.stopped_by == "triangles":
            report_crowded_by_topology(result)

    def text(self) -> str:
        """Say what is proven, and whether that is what was asked for."""
        most = f"{_at_most(self.shape_bound_m)} m"
        if self.color_bound_levels is not None:
            most += f" and {_at_most(self.color_bound_levels)} levels"
        text = f"Proven: no point is more than {most} off."
        if self.color_measured_levels is not None:
            text += (
                f" Measured, not proven: colours differ by {self.color_measured_levels:.3g} levels at most."
            )
        if self.proven:
            return text
        own, original = self.unproven_triangles
        return (
            f"{text}\nNot proven: the bounds that were asked for, at {own:,} triangles of the result and "
            f"{original:,} of the original."
        )


def _at_most(value: float) -> str:
    return f"{rounded_up(value):.{DIGITS}g}"
