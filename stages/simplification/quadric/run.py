"""Simplification to a triangle count by attribute quadrics.

A final least-squares fit moves the result towards the input.
"""

from __future__ import annotations

from scanloom.stages import _kernels
from scanloom.stages.progress import Progress
from scanloom.stages.simplification.color_weight import color_weight
from scanloom.stages.simplification.in_sheets import run_in_sheets
from scanloom.stages.simplification.kernel_input import Light, as_result, fitted, kernel_input
from scanloom.stages.simplification.quadric.details import QuadricDetails
from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.simplification.reordered import run_reordered
from scanloom.stages.simplification.result import Simplified
from scanloom.stages.simplification.task import Task

RESULT_VERSION = 2

# Triangles per region of the collapse engine: small enough for the CPU caches.
REGION_TRIANGLES = 8192


def run(task: Task[None]) -> Simplified[QuadricDetails]:
    """Simplify with method `quadric`."""
    return run_in_sheets(task, _in_order)


def _in_order(task: Task[None]) -> Simplified[QuadricDetails]:
    return run_reordered(task, _as_it_is)


def _as_it_is(task: Task[None]) -> Simplified[QuadricDetails]:
    mesh, lock, progress = task.mesh, task.lock, task.progress
    running = task.running(REGION_TRIANGLES)
    given = kernel_input(mesh)
    weight = task.attribute_scale
    if weight is None:
        try:
            weight = color_weight(mesh, running.target_triangles, task.threads)
        except KeyboardInterrupt:
            if not task.partial:
                raise
            # Nothing has been simplified yet, so the partial result is the input.
            weight, progress = 0.0, _no_more
    result = _kernels.simplify_by_quadrics(
        given.vertices,
        given.attributes,
        mesh.triangles,
        lock,
        task.importance,
        weight=weight,
        running=running,
        progress=progress,
    )
    source = result.vertex_source
    vertices, attributes = given.placed_back(result.vertices, source), result.attributes
    stopped_by, is_fitted = result.stopped_by, False
    if task.fit and result.collapses and stopped_by != "request":
        light = Light(vertices, attributes, result.triangles, source, result.became)
        try:
            vertices, attributes = fitted(
                light, given, lock, task.threads, _finishing(progress, len(mesh.triangles), running)
            )
            is_fitted = True
        except (_Content, KeyboardInterrupt) as stop:
            if not (task.partial or isinstance(stop, _Content)):
                raise
            stopped_by = "request"
    light_mesh = as_result(mesh, vertices, attributes, result.triangles, source, "simplify")
    record = None
    if task.record:
        path = result.path.copy()
        path[:, :3] = given.placed_back(path[:, :3], result.survivor)
        base = mesh.with_(texture=None)
        record = CollapseRecord(base, result.removed, result.survivor, path, lock)
    return Simplified(
        mesh=light_mesh,
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


def _no_more(done: int, total: int) -> bool:  # noqa: ARG001
    return False


class _Content(Exception):  # noqa: N818 (nothing went wrong)
    """Request to stop and return the mesh simplified so far."""


def _finishing(progress: Progress, triangles: int, running: _kernels.Running) -> Progress:
    """Create a progress callback that reports 100 % during the final fit.

    Raises
    ------
    _Content
        From the callback, when `progress` requests an early stop.
    """
    going = max(triangles - running.target_triangles, 0)

    def tell(done: int, total: int) -> None:  # noqa: ARG001
        if progress(going, going) is False:
            raise _Content

    return tell
