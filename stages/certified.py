"""Simplification within bounds that are proven to hold at every point of both surfaces."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages import _kernels
from stages.centred import as_result, attributes_of
from stages.color_weight import color_weight
from stages.errors import MeshError, UsageError
from stages.mesh import Mesh
from stages.progress import Progress, silent

PATCH_TRIANGLES = 8192

# The bound on shape where only colours have one.
_SHAPE_PER_DIAGONAL = 0.005

# Common bounds leave about an eighth of a scan; the weight of colour is found for triangles of that size.
_REDUCTION = 8


@dataclass(frozen=True, eq=False)
class CertifiedResult:
    """A simplified mesh and what is proven of it.

    Attributes
    ----------
    mesh : Mesh, with colours if the input has them.
    vertex_source : (p,) int32, for each vertex an input vertex that became part of it.
    triangle_source : (q,) int32, for each triangle the input triangle it is what is left of.
    shape_bound, color_bound : (q,) float64, metres and levels, for each triangle, both ways; see `certify`.
    shape_bound_m, color_bound_levels : the greatest of all; no more than what was asked for if `proven`.
    shape_attained_m, color_attained_levels : the greatest found at a point; the true maximum is between.
    slack_m, color_slack_levels : contained in the bounds, for searches in single precision. Twice as much is
        the least that can be proven, and is used in place of smaller bounds.
    proven : whether the bounds that were asked for are proven. If not, the work was stopped, or they do not
        even hold between the input and itself, as where sheets of different colours touch.
    max_shape_m : the bound on shape that was used.
    stopped_by : "bounds", "request" when the caller stopped it, or else "unproven".
    weight : metres that counted as much as one level of colour.
    refused : edges of the result by the rule that refused them last: "shape" and "color" are the bounds,
        "needle" a triangle too thin for a proof, the others as in `Simplified`.
    iterations : how often the mesh was simplified and its bounds looked at.
    unproven : how many triangles of result and input had no proof, each time.
    collapses, attempts : of the last time.

    Colour bounds are None for a mesh without colours.
    """

    mesh: Mesh
    vertex_source: NDArray[np.int32]
    triangle_source: NDArray[np.int32]
    shape_bound: NDArray[np.float64]
    color_bound: NDArray[np.float64] | None
    shape_bound_m: float
    color_bound_levels: float | None
    shape_attained_m: float
    color_attained_levels: float | None
    slack_m: float
    color_slack_levels: float
    proven: bool
    max_shape_m: float
    stopped_by: str
    weight: float
    refused: dict[str, int]
    iterations: int
    unproven: tuple[tuple[int, int], ...]
    collapses: int
    attempts: int

    def figures(self) -> dict[str, Any]:
        """Everything but the arrays, ready for JSON."""
        return {
            "triangles": len(self.mesh.triangles),
            "vertices": len(self.mesh.vertices),
            "shape_bound_m": self.shape_bound_m,
            "shape_attained_m": self.shape_attained_m,
            "color_bound_levels": self.color_bound_levels,
            "color_attained_levels": self.color_attained_levels,
            "slack_m": self.slack_m,
            "color_slack_levels": self.color_slack_levels,
            "proven": self.proven,
            "max_shape_m": self.max_shape_m,
            "stopped_by": self.stopped_by,
            "weight_m_per_level": self.weight,
            "refused_edges": dict(self.refused),
            "iterations": self.iterations,
            "collapses": self.collapses,
            "attempts": self.attempts,
        }


def _diagonal(mesh: Mesh) -> float:
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))) if len(mesh.vertices) else 0.0


def simplify_certified(
    mesh: Mesh,
    *,
    max_shape: float | None = None,
    max_color: float | None = None,
    fixed: NDArray[np.bool_] | None = None,
    importance: NDArray[np.float64] | None = None,
    weight: float | None = None,
    share: float = 0.9,
    close: bool = False,
    threads: int = 0,
    partial: bool = False,
    progress: Progress = silent,
) -> CertifiedResult:
    """Collapse edges as far as the bounds can be proven to hold.

    Every point of either surface is within `max_shape` of the other, and its colour within `max_color` of the
    colour at every nearest point there. Vertices of the input are watched while edges collapse; then the
    bounds are proven for all points between. Where that fails, the limits of the vertices around are
    tightened, and it starts again. Equal input gives equal bytes, for any number of threads.

    Parameters
    ----------
    mesh : an oriented manifold, as for `simplify`.
    max_shape : metres; None for 0.5 % of the bounding box's diagonal: colours alone do not hold a shape.
    max_color : 8-bit levels, Euclidean norm over the channels; None for no bound.
    fixed : (n,) bool, vertices that stay where they are; None or empty for none.
    importance : (n,) float64, at least 1: multiplies the error around a vertex and divides its part of the
        bounds; None or empty for 1.
    weight : metres that count as much as one level of colour when a vertex is placed; None for one that
        follows from the mesh.
    share : part of the bounds that vertices may use; what is left is for the points between them.
    close : bound every triangle about as closely as can be, in about twice the time. Otherwise a triangle's
        bounds may be as large as those that were asked for. Always so for a mesh with colours and no
        `max_color`, whose colour bound is found this way.
    threads : 0 for one for each core.
    partial : on Ctrl-C, or when `progress` returns False, give out what there is, with its bounds.
    progress : called about ten times a second; raising from it stops the work.

    Raises
    ------
    MeshError
        For a mesh that is not an oriented manifold; the message names the elements.
    UsageError
        For a parameter out of range, or a bound on colour for a mesh without colours.

    References
    ----------
    Garland and Heckbert 1997 and Hoppe 1999 for order and placement; Ciampalini, Cignoni, Montani and
    Scopigno, "Multiresolution decimation based on global error", 1997, for watching the input's vertices.
    """
    _check(mesh, max_shape, max_color, fixed, importance)
    if max_shape is None:
        max_shape = _SHAPE_PER_DIAGONAL * _diagonal(mesh)
    shape, color = float(max_shape), math.inf if max_color is None else float(max_color)
    if weight is None:
        weight = color_weight(mesh, len(mesh.triangles) // _REDUCTION)
    try:
        result = _kernels.simplify_certified(
            mesh.vertices,
            attributes_of(mesh),
            mesh.triangles,
            np.zeros(0, bool) if fixed is None else fixed,
            np.zeros(0) if importance is None else importance,
            bounds=(shape, color),
            weight=weight,
            share=share,
            tolerance=(0.05, 0.05),
            effort=16.0,
            close=close or (mesh.colors is not None and max_color is None),
            wanted_threads=threads,
            patch_triangles=PATCH_TRIANGLES,
            partial=partial,
            progress=progress,
        )
    except _kernels.InvalidMeshError as error:
        raise MeshError(f"{error}; run clean first.", "mesh") from error
    bounds_color = mesh.colors is not None
    stopped_by = "bounds" if result.proven else "unproven"
    light = as_result(
        mesh, result.vertices, result.attributes, result.triangles, result.vertex_source, "simplify"
    )
    if not result.proven:
        light = light.with_(notes=(*light.notes, _not_proven(result, bounds_color)))
    return CertifiedResult(
        mesh=light,
        vertex_source=result.vertex_source,
        triangle_source=result.triangle_source,
        shape_bound=result.shape_bound,
        color_bound=result.color_bound if bounds_color else None,
        shape_bound_m=result.bound[0],
        color_bound_levels=result.bound[1] if bounds_color else None,
        shape_attained_m=result.attained[0],
        color_attained_levels=result.attained[1] if bounds_color else None,
        slack_m=result.slack,
        color_slack_levels=result.color_slack,
        proven=result.proven,
        max_shape_m=shape,
        stopped_by="request" if result.stopped_by == "request" else stopped_by,
        weight=weight,
        refused=result.standing,
        iterations=len(result.passes),
        unproven=tuple((a, b) for _, a, b, _, _ in result.passes),
        collapses=result.passes[-1][3],
        attempts=result.passes[-1][4],
    )


def _check(
    mesh: Mesh,
    max_shape: float | None,
    max_color: float | None,
    fixed: NDArray[np.bool_] | None,
    importance: NDArray[np.float64] | None,
) -> None:
    if max_shape is None and max_color is None:
        raise UsageError("neither max_shape nor max_color is given; give one of them, or both.")
    for name, bound in (("max_shape", max_shape), ("max_color", max_color)):
        if bound is not None and not bound >= 0:
            raise UsageError(f"{name} is {bound}; expected 0 or more.")
    if max_color is not None and mesh.colors is None:
        raise UsageError("max_color is given, but the mesh has no vertex colours.")
    for name, values in (("fixed", fixed), ("importance", importance)):
        if values is not None and values.shape not in ((0,), (len(mesh.vertices),)):
            raise UsageError(f"{name} has shape {values.shape}; expected ({len(mesh.vertices)},) or none.")
    if importance is not None and not (np.isfinite(importance).all() and (importance >= 1).all()):
        raise UsageError("importance has values below 1 or not finite; expected 1 or more.")


def _not_proven(result: _kernels.Proven, with_color: bool) -> str:
    """Say what is proven instead of what was asked for."""
    shape, color = result.bound
    levels = f" and {color:.4g} levels" if with_color else ""
    return f"simplify could not prove the bounds that were asked for; proven are {shape:.4g} m{levels}."
