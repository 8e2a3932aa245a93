"""Simplification with bounds proven at every point of both surfaces."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.simplification.certified.constants import (
    EXPECTED_REDUCTION,
    MAX_SUBDIVISIONS,
    PROOF_TOLERANCE,
    VERTEX_BOUND_RATIO,
)
from scanloom.stages.simplification.certified.corner_attribute_run import run_with_corner_attributes
from scanloom.stages.simplification.certified.details import CertifiedDetails
from scanloom.stages.simplification.certified.params import CertifiedParams
from scanloom.stages.simplification.certified.unproven_warning import create_unproven_warning
from scanloom.stages.simplification.codes import USAGE_METHOD_MISMATCH
from scanloom.stages.simplification.color_weight import compute_balanced_weight
from scanloom.stages.simplification.corner_attributes import has_corner_attributes
from scanloom.stages.simplification.kernel_input import build_result_mesh, require_colors
from scanloom.stages.simplification.manifold_sheets import run_on_manifold_sheets
from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.simplification.task import Task
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.surface_color import get_vertex_attributes, has_color

RESULT_VERSION = 8

# Triangles per region of the collapse engine.
REGION_TRIANGLES = 8192

# Default bound on shape, as a ratio of the bounding box's diagonal.
_SHAPE_PER_DIAGONAL = 0.005


def run(task: Task[CertifiedParams]) -> SimplificationResult[CertifiedDetails]:
    """Simplify with method `certified`.

    Raises
    ------
    UsageError
        For importance below 1, or a bound on colour for a mesh without colours.
    """
    mesh = task.mesh
    has_corner_data = has_corner_attributes(mesh)
    if not has_corner_data:
        require_colors(mesh, task.max_color)
    elif task.max_color is not None and not has_color(mesh):
        raise UsageError(
            USAGE_METHOD_MISMATCH,
            "is given, but the mesh has neither image nor vertex colours",
            DiagnosticLocation(parameter="max_color"),
            remedy="leave it out.",
        )
    if not (np.isfinite(task.importance).all() and (task.importance >= 1).all()):
        raise UsageError(
            USAGE_METHOD_MISMATCH,
            "importance has values below 1 or not finite; method certified divides its "
            "bounds by it, so it must be at least 1.",
        )
    shape = _SHAPE_PER_DIAGONAL * _compute_diagonal(mesh) if task.max_shape is None else float(task.max_shape)
    if has_corner_data:
        return run_with_corner_attributes(task, shape)
    # The default bound depends on the given mesh, which may have unused vertices; split sheets have none.
    return run_on_manifold_sheets(replace(task, max_shape=shape), _run_on_manifold)


def _run_on_manifold(task: Task[CertifiedParams]) -> SimplificationResult[CertifiedDetails]:
    mesh = task.mesh
    shape = task.max_shape or 0.0
    color = math.inf if task.max_color is None else float(task.max_color)
    weight = task.attribute_scale
    if weight is None:
        weight = compute_balanced_weight(mesh, len(mesh.triangles) // EXPECTED_REDUCTION, task.threads)
    # With a weight of 0 and no bound, colours do not matter.
    with_color = mesh.colors is not None and (weight > 0 or task.max_color is not None)
    result = _kernels.simplify_certified(
        mesh.vertices,
        get_vertex_attributes(mesh),
        mesh.triangles,
        task.lock,
        task.importance,
        bounds=(shape, color),
        weight=weight,
        share=VERTEX_BOUND_RATIO,
        tolerance=(PROOF_TOLERANCE, PROOF_TOLERANCE),
        effort=MAX_SUBDIVISIONS,
        close=task.params.tight_bounds,
        running=task.make_kernel_options(REGION_TRIANGLES),
        progress=task.progress,
    )
    simplified = build_result_mesh(
        mesh, result.vertices, result.attributes, result.triangles, result.vertex_source, "simplify"
    )
    # Without a triangle count, the kernel's target is 0 and the bounds are the only limit, even if no
    # triangle is left.
    stopped_by = result.stopped_by if task.triangles or result.stopped_by == "request" else "bounds"
    if not result.proven:
        proven = result.bound[0], result.bound[1] if with_color else None
        fails = (result.shape_bound > max(shape, 2 * result.slack)) | (result.color_bound > color)
        emit(create_unproven_warning(simplified, fails, result.shape_bound, proven))
        stopped_by = "request" if stopped_by == "request" else "unproven"
    record = None
    if task.record:
        base = mesh.with_(texture=None)
        record = CollapseRecord(base, result.removed, result.survivor, result.path, task.lock)
    return SimplificationResult(
        mesh=simplified,
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
            max_color_levels=task.max_color,
        ),
        record=record,
    )


def _compute_diagonal(mesh: Mesh) -> float:
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))) if len(mesh.vertices) else 0.0
