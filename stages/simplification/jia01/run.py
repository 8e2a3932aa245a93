"""Simplification within bounds on accumulated shape and texture changes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.simplification.jia01.details import Jia01Details
from scanloom.stages.simplification.jia01.limits import Jia01Limits, resolve_limits
from scanloom.stages.simplification.jia01.params import Jia01Params
from scanloom.stages.simplification.jia01.resolution import choose_resolution
from scanloom.stages.simplification.kernel_input import build_result_mesh
from scanloom.stages.simplification.manifold_sheets import run_on_manifold_sheets
from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.simplification.task import Task
from scanloom.stages.surface.intensity import has_intensity
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.surface_color import get_vertex_attributes

RESULT_VERSION = 3

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
    limits = resolve_limits(task)
    if task.params.resolution is None:
        expected = task.triangles
        if expected is None:
            # The bounds decide how many triangles are needed; a trial without a limit on lengths finds out.
            trial = _run_kernel(replace(task, progress=lambda _done, total: task.progress(0, total)), limits)
            if trial.stopped_by == "request":
                return _build_result(task, limits, trial)
            expected = len(trial.triangles)
        resolution = choose_resolution(task.mesh, expected, task.threads)
        # A strict limit might keep a triangle count from being reached.
        limits = limits.with_resolution(resolution, soft=task.triangles is not None)
    return _build_result(task, limits, _run_kernel(task, limits))


def _build_result(
    task: Task[Jia01Params], limits: Jia01Limits, result: _kernels.Jia01Result
) -> SimplificationResult[Jia01Details]:
    mesh = task.mesh
    simplified = build_result_mesh(
        mesh, result.vertices, result.attributes, result.triangles, result.vertex_source, "simplify"
    )
    record = None
    if task.record:
        base = mesh.with_(texture=None)
        path = result.path
        if path.shape[1] == 4:
            path = np.concatenate([path[:, :3], np.repeat(path[:, 3:], 3, axis=1)], axis=1)
        collapses = result.removed, result.survivor, path
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
            bounded={
                name: math.isfinite(bound) and not (name == "resolution" and limits.soft_length)
                for name, bound in zip(names, limits.bounds, strict=True)
            },
            splits=result.splits,
        ),
        record=record,
    )


def _get_attributes(mesh: Mesh) -> NDArray[np.uint8]:
    """Return the vertex attributes (n, k): one intensity, three colours, or none."""
    attributes = get_vertex_attributes(mesh)
    return attributes[:, :1] if has_intensity(mesh) else attributes


def _run_kernel(task: Task[Jia01Params], limits: Jia01Limits) -> _kernels.Jia01Result:
    mesh = task.mesh
    try:
        return _kernels.simplify(
            mesh.vertices,
            _get_attributes(mesh),
            mesh.triangles,
            task.lock,
            bounds=limits.bounds,
            scales=limits.scales,
            soft_length=limits.soft_length,
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
