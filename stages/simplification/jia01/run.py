"""Simplification within bounds on accumulated shape and texture changes."""

from __future__ import annotations

import math

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.simplification.in_sheets import run_in_sheets
from scanloom.stages.simplification.jia01.details import Jia01Details
from scanloom.stages.simplification.jia01.limits import limits_of
from scanloom.stages.simplification.jia01.params import Jia01Params
from scanloom.stages.simplification.kernel_input import as_result
from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.simplification.result import Simplified
from scanloom.stages.simplification.task import Task
from scanloom.stages.surface.color import attributes_of

RESULT_VERSION = 2

# Triangles per region of the collapse engine. Accumulated changes suffer more at region boundaries than
# quadrics, so regions are larger than in method `quadric`.
REGION_TRIANGLES = 16384

# Maximum number of triangles after splitting; they need about 4 GB.
_TRIANGLE_LIMIT = 20_000_000


def run(task: Task[Jia01Params]) -> Simplified[Jia01Details]:
    """Simplify with method `jia01`.

    Raises
    ------
    UsageError
        If the resolution is so fine that splitting would create more than 20 million triangles.
    """
    return run_in_sheets(task, _as_it_is)


def _as_it_is(task: Task[Jia01Params]) -> Simplified[Jia01Details]:
    mesh = task.mesh
    limits = limits_of(task)
    try:
        result = _kernels.simplify(
            mesh.vertices,
            attributes_of(mesh),
            mesh.triangles,
            task.lock,
            bounds=limits.bounds,
            scales=limits.scales,
            attribute_scale=limits.attribute_scale,
            paper_rule=task.params.paper_rule,
            triangle_limit=max(_TRIANGLE_LIMIT, len(mesh.triangles)),
            running=task.running(REGION_TRIANGLES),
            progress=task.progress,
        )
    except _kernels.LimitError as error:
        raise UsageError(
            USAGE_VALUE_INVALID,
            "is {scales:g} m; at this edge length, {error}",
            Where(parameter="jia01.resolution"),
            remedy="give a larger value.",
            scales=limits.scales[0],
            error=error,
        ) from error
    light = as_result(
        mesh, result.vertices, result.attributes, result.triangles, result.vertex_source, "simplify"
    )
    record = None
    if task.record:
        base = mesh.with_(texture=None)
        way = result.removed, result.survivor, result.path
        if result.split is None:
            record = CollapseRecord(base, *way, task.lock)
        else:
            vertices, attributes, triangles, vertex_source, triangle_source = result.split
            split = as_result(base, vertices, attributes, triangles, vertex_source, "simplify")
            record = CollapseRecord(split, *way, task.lock[vertex_source], vertex_source, triangle_source)
    names = ("resolution", "max_shape", "max_color")
    return Simplified(
        mesh=light,
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
