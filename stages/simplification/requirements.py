"""Requirements of simplification: the triangle count, and the bounds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.params import get_value
from scanloom.stages.printing import format_upper_bound
from scanloom.stages.simplification.codes import SIMPLIFY_BOUND_NOT_PROVEN, SIMPLIFY_COUNT_NOT_REACHED
from scanloom.stages.simplification.params import SimplifyParams

# With any of these, a triangle count is not required: the simplification may stop at the bound.
_BOUND_PARAMETERS = ("max_shape", "max_color", "seams.max_seam_drift", "jia01.resolution")


def report_unmet_requirements(params: SimplifyParams, statistics: Mapping[str, Any]) -> None:
    """Emit a diagnostic for each unmet requirement.

    A triangle count is required only without a bound; with both, whichever is reached first stops the
    simplification. It is not required after an early stop on request (`stopped_by` is "request"). Bounds must
    be proven in any case. A default bound is not a requirement: a warning reports the proven bound instead.

    Parameters
    ----------
    params : parameters of `simplify`.
    statistics : statistics of the result, from `SimplificationResult.to_dict`.
    """
    details = statistics["details"]
    if details.get("proven") is False and statistics.get("default_max_shape_m") is None:
        bound_text = f"{format_upper_bound(details['shape_bound_m'])} m"
        if details["color_bound_levels"] is not None:
            bound_text += f" and {format_upper_bound(details['color_bound_levels'])} levels"
        emit(
            SIMPLIFY_BOUND_NOT_PROVEN.unmet(
                "the requested bounds are not proven; {most} are proven instead.", most=bound_text
            )
        )
    asked = details.get("max_shape_m")
    is_required = asked is not None and statistics.get("default_max_shape_m") is None
    if details.get("proven") is True and is_required and details["shape_bound_m"] > asked * (1 + 1e-9):
        emit(
            SIMPLIFY_BOUND_NOT_PROVEN.unmet(
                "max_shape ({asked:.3g} m) is below the resolution of a proof for this mesh; "
                "{bound} m are proven instead.",
                remedy="increase max_shape to at least {least} m, or move the mesh to the origin.",
                asked=asked,
                bound=format_upper_bound(details["shape_bound_m"]),
                least=format_upper_bound(2 * details["slack_m"]),
            )
        )
    measured, max_color = details.get("color_measured_levels"), details.get("max_color_levels")
    if measured is not None and max_color is not None and measured > max_color:
        emit(
            SIMPLIFY_BOUND_NOT_PROVEN.unmet(
                "colours differ by up to {measured:.3g} levels, more than max_color ({max_color:g} levels).",
                measured=measured,
                max_color=max_color,
            )
        )
    wanted, left = params.compute_target_count(statistics["triangles_before"]), statistics["triangles"]
    is_alone = all(get_value(params, name) is None for name in _BOUND_PARAMETERS)
    if wanted is not None and is_alone and left > wanted and statistics["stopped_by"] != "request":
        emit(
            SIMPLIFY_COUNT_NOT_REACHED.unmet(
                "{left:,} triangles are left instead of {wanted:,}: {why}.",
                left=left,
                wanted=wanted,
                why=_explain_refusal(statistics["refused_edges"]),
            )
        )


def _explain_refusal(refused: Mapping[str, int]) -> str:
    rule = max(refused, key=lambda name: refused[name], default=None)
    if rule is None or not refused[rule]:
        return "no other edge can collapse"
    return f'no other edge can collapse, mostly because of the rule "{rule}"'
