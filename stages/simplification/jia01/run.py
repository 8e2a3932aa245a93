"""Simplification within bounds on accumulated shape and texture changes."""

from __future__ import annotations

import math

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.simplification.jia01.details import Jia01Details
from scanloom.stages.simplification.jia01.limits import resolve_limits
from scanloom.stages.simplification.jia01.params import Jia01Params
from scanloom.stages.simplification.kernel_input import build_result_mesh
from scanloom.stages.simplification.manifold_sheets import run_on_manifold_sheets
from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.simplification.task import Task
from scanloom.stages.surface.surface_color import get_vertex_attributes

RESULT_VERSION = 2

# Triangles per region of the collapse engine. Accumulated changes suffer more at region boundaries than
# quadrics, so regions are larger than in method `quadric`.
REGION_TRIANGLES = 16384

# Maximum number of triangles after splitting; they need about 4 GB.
_MAX_TRIANGLES = 20_000_000


def run(task: Task[Jia01Params]) -> SimplificationResult[Jia01Details]:
    """Simplify with method `jia01`.

    Raises
    ------
    UsageError
        If the resolution is so fine that splitting would create more than 20 million triangles.
    """
    return run_on_manifold_sheets(task, _run_on_manifold)


def _run_on_manifold(task: Task[Jia01Params]) -> SimplificationResult[Jia01Details]:
    mesh = task.mesh
    limits = resolve_limits(task)
    try:
        result = _kernels.simplify(
            mesh.vertices,
            get_vertex_attributes(mesh),
            mesh.triangles,
            task.lock,
            bounds=limits.bounds,
            scales=limits.scales,
            attribute_scale=limits.attribute_scale,
            paper_rule=task.params.paper_rule,
            triangle_limit=max(_MAX_TRIANGLES, len(mesh.triangles)),
            running=task.make_kernel_options(REGION_TRIANGLES),
            progress=task.progress,
        )
    except _kernels.LimitError as error:
        raise UsageError(
            USAGE_VALUE_INVALID,
            "is {scales:g} m; at this edge length, {error}",
            DiagnosticLocation(parameter="jia01.resolution"),
            remedy="give a larger value.",
            scales=limits.scales[0],
            error=error,
        ) from error
    simplified = build_result_mesh(
        mesh, result.vertices, result.attributes, result.triangles, result.vertex_source, "simplify"
    )
    record = None
    if task.record:
        base = mesh.with_(texture=None)
        collapses = result.removed, result.survivor, result.path
        if result.split is None:
            record = CollapseRecord(base, *collapses, task.lock)
        else:
            vertices, attributes, triangles, vertex_source, triangle_source = result.split
            split = build_result_mesh(base, vertices, attributes, triangles, vertex_source, "simplify")
            record = CollapseRecord(
                split, *collapses, task.lock[vertex_source], vertex_source, triangle_source
            )
    names = ("resolution", "max_shape", "max_color")
    return SimplificationResult(
        mesh=simplified,
        vertex_source=result.vertex_source,
        triangle_source=result.triangle_source,
        method="jia01",
        stopped_by=result.stopped_by,
        refused=result.refused,
        collapses=result.collapses,
        attempts=result.attempts,
        triangles_before=len(mesh.triangles),
        details=Jia01Details(
            attribute_scale_m_per_level=limits.attribute_scale,
            largest_shape_change_m=result.largest_shape_change,
            largest_color_change_levels=result.largest_texture_change,
            resolution_m=limits.scales[0],
            max_shape_m=limits.scales[1],
            max_color_levels=limits.max_color,
            bounded=dict(zip(names, map(math.isfinite, limits.bounds), strict=True)),
            splits=result.splits,
        ),
        record=record,
    )
