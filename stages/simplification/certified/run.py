"""Simplification within bounds that are proven to hold at every point of both surfaces."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stages import _kernels
from stages.errors import MeshError, UsageError
from stages.progress import Progress, silent
from stages.rounding import rounded_up
from stages.simplification.color_weight import balanced_weight
from stages.simplification.kernel_input import as_result, attributes_of
from stages.simplification.records.record import CollapseRecord
from stages.simplification.result import Simplified
from stages.surface.mesh import Mesh

REGION_TRIANGLES = 8192

# The bound on shape where only colours have one.
_SHAPE_PER_DIAGONAL = 0.005

# Common bounds leave about an eighth of a scan; the weight of colour is found for triangles of that size,
# also where more are wanted: smaller ones tell the same.
_REDUCTION = 8


def _diagonal(mesh: Mesh) -> float:
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))) if len(mesh.vertices) else 0.0


def simplify_certified(
    mesh: Mesh,
    *,
    max_shape: float | None = None,
    max_color: float | None = None,
    triangles: int = 0,
    fixed: NDArray[np.bool_] | None = None,
    importance: NDArray[np.float64] | None = None,
    weight: float | None = None,
    share: float = 0.9,
    close: bool = False,
    threads: int = 0,
    record: bool = False,
    partial: bool = False,
    progress: Progress = silent,
) -> Simplified:
    """Collapse edges to a number of triangles, or as far as the bounds can be proven to hold.

    Every point of either surface is within `max_shape` of the other, and its colour within `max_color` of the
    colour at every nearest point there. Vertices of the input are watched while edges collapse; then the
    bounds are proven for all points between. Where that fails, the collapses behind it are taken back, the
    limits of the vertices around are tightened, and it goes on from there; what has changed is proven again.
    Equal input gives equal bytes, for any number of threads. A `max_color` below half a level counts as that.

    Parameters
    ----------
    mesh : an oriented manifold, as for `simplify`.
    max_shape : metres; None for 0.5 % of the bounding box's diagonal: colours alone do not hold a shape.
    max_color : 8-bit levels, Euclidean norm over the channels; None for no bound.
    triangles : stop when at most this many are left.
    fixed : (n,) bool, vertices that stay where they are; None or empty for none.
    importance : (n,) float64, at least 1: multiplies the error around a vertex and divides its part of the
        bounds; None or empty for 1.
    weight : metres that count as much as one level of colour when a vertex is placed; None for one that
        follows from the mesh.
    share : part of the bounds that vertices may use; what is left is for the points between them.
    close : bound every triangle about as closely as can be, in two to four times the time. Otherwise a
        triangle's bounds may be as large as those that were asked for. Always so for a mesh with colours and
        no `max_color`, whose colour bound is found this way.
    threads : 0 for one for each core.
    record : keep all collapses that stand at the end.
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
        weight = balanced_weight(mesh, len(mesh.triangles) // _REDUCTION, threads)
    running = _kernels.Running(
        target_triangles=triangles,
        threads=threads,
        region_triangles=REGION_TRIANGLES,
        record=record,
        partial=partial,
    )
    fixed = np.zeros(0, bool) if fixed is None else fixed
    try:
        result = _kernels.simplify_certified(
            mesh.vertices,
            attributes_of(mesh),
            mesh.triangles,
            fixed,
            np.zeros(0) if importance is None else importance,
            bounds=(shape, color),
            weight=weight,
            share=share,
            tolerance=(0.05, 0.05),
            effort=16.0,
            close=close or (mesh.colors is not None and max_color is None),
            running=running,
            progress=progress,
        )
    except _kernels.InvalidMeshError as error:
        raise MeshError(f"{error}; run clean first.", "mesh") from error
    light = as_result(
        mesh, result.vertices, result.attributes, result.triangles, result.vertex_source, "simplify"
    )
    with_color = mesh.colors is not None
    # Where no number is wanted, even no triangles at all are what the bounds led to.
    stopped_by = result.stopped_by if triangles or result.stopped_by == "request" else "bounds"
    if not result.proven:
        light = light.with_(notes=(*light.notes, _not_proven(result.bound, with_color)))
        stopped_by = "request" if stopped_by == "request" else "unproven"
    kept = None
    if record:
        base = mesh.with_(texture=None, notes=light.notes)
        lock = fixed if len(fixed) else np.zeros(len(mesh.vertices), bool)
        kept = CollapseRecord(base, result.removed, result.survivor, result.path, lock)
    return Simplified(
        mesh=light,
        vertex_source=result.vertex_source,
        triangle_source=result.triangle_source,
        method="certified",
        stopped_by=stopped_by,
        refused=result.refused,
        attribute_scale_m_per_level=weight,
        splits=0,
        collapses=result.collapses,
        attempts=result.attempts,
        triangles_before=len(mesh.triangles),
        record=kept,
        shape_bound=result.shape_bound,
        color_bound=result.color_bound if with_color else None,
        shape_bound_m=result.bound[0],
        color_bound_levels=result.bound[1] if with_color else None,
        shape_attained_m=result.attained[0],
        color_attained_levels=result.attained[1] if with_color else None,
        slack_m=result.slack,
        color_slack_levels=result.color_slack,
        proven=result.proven,
        unproven_triangles=result.unproven,
        iterations=result.iterations,
        max_shape_m=shape,
        max_texture_levels=max_color,
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
        raise UsageError(
            "importance has values below 1 or not finite; bounds are divided by it, and never grow."
        )


def _not_proven(bound: tuple[float, float], with_color: bool) -> str:
    """Say what is proven instead of what was asked for."""
    shape, color = (f"{rounded_up(most):.4g}" for most in bound)
    levels = f" and {color} levels" if with_color else ""
    return f"simplify could not prove the bounds that were asked for; proven are {shape} m{levels}."
