"""Result details of method `certified`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.printing import format_by_fields, render_table
from scanloom.stages.printing.rounding import PRINTED_DIGITS, round_up
from scanloom.stages.simplification.blocked_edges import report_topology_blocking
from scanloom.stages.simplification.result import Details, SimplificationResult


@dataclass(frozen=True, eq=False, kw_only=True)
class CertifiedDetails(Details):
    """Proven bounds of method `certified`.

    Attributes
    ----------
    attribute_scale_m_per_level : metres that weigh as much as one level of colour.
    shape_bound, color_bound : (q,) float64, metres and levels, proven both ways for each triangle: for its
        points, and for input points whose nearest point is on it. `color_bound` is None without colours, and
        if they have neither weight nor a bound.
        Values may equal `max_shape` and `max_color` (or `color_bound_levels`) although smaller ones are true,
        unless `tight_bounds` is set.
    shape_bound_m, color_bound_levels : maximum over all triangles of input and result.
    shape_attained_m, color_attained_levels : largest deviation found at a point. The true maximum is between
        this value and the bound.
    slack_m, color_slack_levels : allowance for single-precision searches, included in the bounds. A smaller
        `max_shape` is raised to twice `slack_m`, a smaller `max_color` to half a level.
    proven : True if `max_shape` and `max_color` are proven. The bounds above hold in any case.
    unproven_triangles : triangles of the result and of the input that are not proven to be within the bounds.
    iterations : rounds of simplification and proof.
    max_shape_m, max_color_levels : applied bounds; `max_color_levels` is None without one.
    color_measured_levels : largest colour difference at samples as dense as the texels, if colours come from
        images. `max_color` is then checked at these samples, and not proven.
    seam_drift : proven bound on the shift of texture seams in the image, as a ratio of the image's side; None
        without texture seams.
    """

    __repr__ = format_by_fields
    _repr_html_ = render_table

    headline: ClassVar[str] = (
        "{triangles:,} triangles, stopped by {stopped_by}; proven to be no more than "
        "{shape_bound_m:at_most} m off"
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

    def report(self, result: SimplificationResult[Any]) -> None:
        """Warn if most remaining edges cannot collapse because of the topology."""
        if result.stopped_by == "triangles":
            report_topology_blocking(result)

    def describe(self) -> str:
        """Describe the proven bounds, and whether the requested bounds were met."""
        bound_text = f"{_format_bound(self.shape_bound_m)} m"
        if self.color_bound_levels is not None:
            bound_text += f" and {_format_bound(self.color_bound_levels)} levels"
        text = f"Proven: no point is more than {bound_text} off."
        if self.color_measured_levels is not None:
            text += (
                f" Measured, not proven: colours differ by {self.color_measured_levels:.3g} levels at most."
            )
        if self.proven:
            return text
        own, original = self.unproven_triangles
        return (
            f"{text}\nNot proven: the requested bounds, at {own:,} triangles of the result and "
            f"{original:,} of the original."
        )


def _format_bound(value: float) -> str:
    return f"{round_up(value):.{PRINTED_DIGITS}g}"
