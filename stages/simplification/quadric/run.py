"""Simplification to a triangle count by attribute quadrics.

A final least-squares fit moves the result towards the input.
"""

from __future__ import annotations

from scanloom.stages import _kernels
from scanloom.stages.progress import Progress
from scanloom.stages.simplification.cache_order import run_reordered
from scanloom.stages.simplification.color_weight import compute_color_weight
from scanloom.stages.simplification.kernel_input import (
    ReducedMesh,
    build_result_mesh,
    fit_to_input,
    make_kernel_input,
)
from scanloom.stages.simplification.manifold_sheets import run_on_manifold_sheets
from scanloom.stages.simplification.quadric.details import QuadricDetails
from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.simplification.task import Task

RESULT_VERSION = 6

# Triangles per region of the collapse engine: small enough for the CPU caches.
REGION_TRIANGLES = 8192


def run(task: Task[None]) -> SimplificationResult[QuadricDetails]:
    """Simplify with method `quadric`."""
    return run_on_manifold_sheets(task, _run_in_cache_order)


def _run_in_cache_order(task: Task[None]) -> SimplificationResult[QuadricDetails]:
    return run_reordered(task, _run_on_manifold)


def _run_on_manifold(task: Task[None]) -> SimplificationResult[QuadricDetails]:
    mesh, lock, progress = task.mesh, task.lock, task.progress
    running = task.make_kernel_options(REGION_TRIANGLES)
    kernel_arrays = make_kernel_input(mesh)
    weight = task.attribute_scale
    if weight is None:
        try:
            weight = compute_color_weight(mesh, running.target_triangles, task.threads)
        except KeyboardInterrupt:
            if not task.keep_on_interrupt:
                raise
            # Nothing has been simplified yet, so the partial result is the input.
            weight, progress = 0.0, _stop_immediately
    result = _kernels.simplify_by_quadrics(
        kernel_arrays.vertices,
        kernel_arrays.attributes,
        mesh.triangles,
        lock,
        task.importance,
        weight=weight,
        running=running,
        progress=progress,
    )
    source = result.vertex_source
    vertices, attributes = kernel_arrays.to_world(result.vertices, source), result.attributes
    stopped_by, is_fitted = result.stopped_by, False
    if task.fit and result.collapses and stopped_by != "request":
        reduced = ReducedMesh(vertices, attributes, result.triangles, source, result.became)
        try:
            vertices, attributes = fit_to_input(
                reduced,
                kernel_arrays,
                lock,
                task.threads,
                _make_finish_progress(progress, len(mesh.triangles), running),
            )
            is_fitted = True
        except (_StopRequest, KeyboardInterrupt) as stop:
            if not (task.keep_on_interrupt or isinstance(stop, _StopRequest)):
                raise
            stopped_by = "request"
    simplified = build_result_mesh(mesh, vertices, attributes, result.triangles, source, "simplify")
    record = None
    if task.record:
        path = result.path.copy()
        path[:, :3] = kernel_arrays.to_world(path[:, :3], result.survivor)
        base = mesh.with_(texture=None)
        record = CollapseRecord(base, result.removed, result.survivor, path, lock)
    return SimplificationResult(
        mesh=simplified,
        vertex_source=source,
        triangle_source=result.triangle_source,
        method="quadric",
        stopped_by=stopped_by,
        refused=result.refused,
        collapses=result.collapses,
        attempts=result.attempts,
        triangles_before=len(mesh.triangles),
        details=QuadricDetails(attribute_scale_m_per_level=weight, fitted=is_fitted),
        record=record,
    )


def _stop_immediately(done: int, total: int) -> bool:  # noqa: ARG001
    return False


class _StopRequest(Exception):  # noqa: N818 (nothing went wrong)
    """Request to stop and return the mesh simplified so far."""


def _make_finish_progress(progress: Progress, triangles: int, running: _kernels.RunSettings) -> Progress:
    """Create a progress callback that reports 100 % during the final fit.

    Raises
    ------
    _Content
        From the callback, when `progress` requests an early stop.
    """
    removal_count = max(triangles - running.target_triangles, 0)

    def tell(done: int, total: int) -> None:  # noqa: ARG001
        if progress(removal_count, removal_count) is False:
            raise _StopRequest

    return tell
