"""Warning about bounds that could not be proven."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.printing import format_count
from scanloom.stages.printing.rounding import round_up
from scanloom.stages.simplification.codes import SIMPLIFY_BOUND_NOT_PROVEN
from scanloom.stages.surface.mesh import Mesh

# Triangles listed by position in the warning.
_LISTED_TRIANGLES = 3


def create_unproven_warning(
    simplified: Mesh,
    fails: NDArray[np.bool_],
    shape_bound: NDArray[np.float64],
    bound: tuple[float, float | None],
) -> Diagnostic:
    """Create the warning for a result whose bounds are not proven.

    Parameters
    ----------
    simplified : simplified mesh.
    fails : (q,) mask of the triangles without a proof.
    shape_bound : (q,) float64, metres, proven for each triangle.
    bound : metres and levels proven for the complete mesh; the latter None without colours.
    """
    levels = "" if bound[1] is None else f" and {round_up(bound[1]):.4g} levels"
    (where,) = np.nonzero(fails)
    if not len(where):
        return SIMPLIFY_BOUND_NOT_PROVEN.warning(
            "simplify could not prove the requested bounds; {shape:.4g} m{levels} are proven instead.",
            shape=round_up(bound[0]),
            levels=levels,
        )
    worst = where[np.argsort(-shape_bound[where], kind="stable")][:_LISTED_TRIANGLES]
    places = ", ".join(
        _format_point(simplified.vertices[simplified.triangles[t]].mean(axis=0)) for t in worst
    )
    needles = int(_is_needle(simplified, where).sum())
    thin = f", {needles:,} of them too thin for a tighter proof" if needles else ""
    return SIMPLIFY_BOUND_NOT_PROVEN.warning(
        "simplify could not prove the requested bounds at {triangles}{thin}; {shape:.4g} "
        "m{levels} are proven instead. The largest deviations are near {places} m.",
        shape=round_up(bound[0]),
        levels=levels,
        triangles=format_count(len(where), "triangle"),
        thin=thin,
        places=places,
    )


def _format_point(point: NDArray[np.float64]) -> str:
    return f"({', '.join(f'{x:.4g}' for x in point)})"


def _is_needle(mesh: Mesh, triangles: NDArray[np.int64]) -> NDArray[np.bool_]:
    a, b, c = mesh.vertices[mesh.triangles[triangles]].transpose(1, 0, 2)
    longest2 = np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) <= _kernels.NEEDLE * longest2)
