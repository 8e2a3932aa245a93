"""Simplification within bounds that are proven to hold at every point of both surfaces."""

from __future__ import annotations

import math

import numpy as np

from stages import _kernels
from stages.errors import UsageError
from stages.rounding import rounded_up
from stages.simplification.certified.details import CertifiedDetails
from stages.simplification.certified.params import CertifiedParams
from stages.simplification.color_weight import balanced_weight
from stages.simplification.kernel_input import as_result, attributes_of, require_colors
from stages.simplification.records.record import CollapseRecord
from stages.simplification.result import Simplified
from stages.simplification.task import Task
from stages.surface.mesh import Mesh

RESULT_VERSION = 1

# Triangles worked on at a time.
REGION_TRIANGLES = 8192

# The bound on shape where only colours have one.
_SHAPE_PER_DIAGONAL = 0.005

# Part of the bounds that vertices may use; what is left is for the points between them.
_SHARE_OF_VERTICES = 0.9

# Common bounds leave about an eighth of a scan; the weight of colour is found for triangles of that size,
# also where more are wanted: smaller ones tell the same.
_REDUCTION = 8


def run(task: Task[CertifiedParams]) -> Simplified[CertifiedDetails]:
    """Simplify with method `certified`.

    Raises
    ------
    UsageError
        For importance below 1, or a bound on colour for a mesh without colours.
    _kernels.InvalidMeshError
        For a mesh that is not an oriented manifold; the message names the elements.
    """
    mesh, params = task.mesh, task.params
    require_colors(mesh, params.max_color)
    if not (np.isfinite(task.importance).all() and (task.importance >= 1).all()):
        raise UsageError(
            "importance has values below 1 or not finite; bounds are divided by it, and never grow."
        )
    shape = _SHAPE_PER_DIAGONAL * _diagonal(mesh) if params.max_shape is None else float(params.max_shape)
    color = math.inf if params.max_color is None else float(params.max_color)
    weight = params.attribute_scale
    if weight is None:
        weight = balanced_weight(mesh, len(mesh.triangles) // _REDUCTION, task.threads)
    with_color = mesh.colors is not None
    result = _kernels.simplify_certified(
        mesh.vertices,
        attributes_of(mesh),
        mesh.triangles,
        task.lock,
        task.importance,
        bounds=(shape, color),
        weight=weight,
        share=_SHARE_OF_VERTICES,
        tolerance=(0.05, 0.05),
        effort=16.0,
        # Only so is the bound on colour found where none is wanted.
        close=params.close_bounds or (with_color and params.max_color is None),
        running=task.running(REGION_TRIANGLES),
        progress=task.progress,
    )
    light = as_result(
        mesh, result.vertices, result.attributes, result.triangles, result.vertex_source, "simplify"
    )
    # Where no number is wanted, even no triangles at all are what the bounds led to.
    stopped_by = result.stopped_by if task.triangles or result.stopped_by == "request" else "bounds"
    if not result.proven:
        light = light.with_(notes=(*light.notes, _not_proven(result.bound, with_color)))
        stopped_by = "request" if stopped_by == "request" else "unproven"
    record = None
    if task.record:
        base = mesh.with_(texture=None, notes=light.notes)
        record = CollapseRecord(base, result.removed, result.survivor, result.path, task.lock)
    return Simplified(
        mesh=light,
        vertex_source=result.vertex_source,
        triangle_source=result.triangle_source,
        method="certified",
        stopped_by=stopped_by,
        refused=result.refused,
        collapses=result.collapses,
        attempts=result.attempts,
        triangles_before=len(mesh.triangles),
        details=CertifiedDetails(
            attribute_scale_m_per_level=weight,
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
            max_color_levels=params.max_color,
        ),
        record=record,
    )


def _diagonal(mesh: Mesh) -> float:
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))) if len(mesh.vertices) else 0.0


def _not_proven(bound: tuple[float, float], with_color: bool) -> str:
    """Say what is proven instead of what was asked for."""
    shape, color = (f"{rounded_up(most):.4g}" for most in bound)
    levels = f" and {color} levels" if with_color else ""
    return f"simplify could not prove the bounds that were asked for; proven are {shape} m{levels}."
