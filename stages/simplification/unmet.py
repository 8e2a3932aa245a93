"""Whether a simplified mesh is what was asked for: its number of triangles, and its bounds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stages.printing import at_most
from stages.simplification.params import SimplifyParams

# With any of these, stopping short of a number of triangles is what was asked for.
_BOUNDS = ("max_shape", "max_color", "max_seam_drift", "resolution")


def unmet(params: SimplifyParams, figures: Mapping[str, Any]) -> tuple[str, ...]:
    """Return a sentence for each thing that was asked for and is not reached.

    A number of triangles is asked for where no bound is: with both, whichever comes first ends the work. Who
    asked for what there is by then (`stopped_by` is "request") asked for no number any more; bounds have to
    be proven all the same. A default bound was not asked for: a warning says how much of it is proven.

    Parameters
    ----------
    figures : of the result, as `Simplified.figures` returns them.
    """
    said = []
    details = figures["details"]
    if details.get("proven") is False and figures.get("default_max_shape_m") is None:
        most = f"{at_most(details['shape_bound_m'])} m"
        if details["color_bound_levels"] is not None:
            most += f" and {at_most(details['color_bound_levels'])} levels"
        said.append(f"the bounds that were asked for are not proven; proven are {most}.")
    measured, max_color = details.get("color_measured_levels"), details.get("max_color_levels")
    if measured is not None and max_color is not None and measured > max_color:
        said.append(f"colours differ by up to {measured:.3g} levels, which is more than was asked for.")
    wanted, left = params.target(figures["triangles_before"]), figures["triangles"]
    is_alone = all(getattr(params, name) is None for name in _BOUNDS)
    if wanted is not None and is_alone and left > wanted and figures["stopped_by"] != "request":
        said.append(
            f"{left:,} triangles are left, not {wanted:,} as asked: {_why(figures['refused_edges'])}."
        )
    return tuple(said)


def _why(refused: Mapping[str, int]) -> str:
    rule = max(refused, key=lambda name: refused[name], default=None)
    if rule is None or not refused[rule]:
        return "no other edge may collapse"
    return f"no other edge may collapse, for {rule} most often"
