"""Cache-friendly vertex and triangle order during simplification.

The result is in the order of the input.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from scanloom.stages import _kernels
from scanloom.stages.simplification.result import Details, SimplificationResult
from scanloom.stages.simplification.task import Task
from scanloom.stages.surface.spatial_order import is_scattered, permute_rows, reorder_spatially

P = TypeVar("P")
D = TypeVar("D", bound=Details)


def run_reordered(
    task: Task[P], run: Callable[[Task[P]], SimplificationResult[D]]
) -> SimplificationResult[D]:
    """Run a method on a spatially reordered mesh.

    Meshes that already have spatial locality are not reordered.

    Parameters
    ----------
    task : arguments of the method.
    run : the method.
    """
    # Records must refer to vertices of the input.
    if task.record or not is_scattered(task.mesh):
        return run(task)
    try:
        return _run_on_ordered(task, run)
    except _kernels.InvalidMeshError:
        # Run on the original order, so that the error names the caller's indices.
        return run(task)


def _run_on_ordered(
    task: Task[P], run: Callable[[Task[P]], SimplificationResult[D]]
) -> SimplificationResult[D]:
    order = reorder_spatially(task.mesh)
    rows = order.vertex_source
    importance = task.importance[rows] if len(task.importance) else task.importance
    found = run(replace(task, mesh=order.mesh, lock=task.lock[rows], importance=importance))
    sources = rows[found.vertex_source], order.triangle_source[found.triangle_source]
    # The sort is stable, because several vertices may have one source.
    vertices, triangles = (np.argsort(source, kind="stable") for source in sources)
    return replace(
        found,
        mesh=permute_rows(found.mesh, vertices, triangles),
        vertex_source=sources[0][vertices].astype(np.int32),
        triangle_source=sources[1][triangles].astype(np.int32),
    )
