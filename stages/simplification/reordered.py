"""Cache-friendly vertex and triangle order during simplification.

The result is in the order of the input.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from scanloom.stages import _kernels
from scanloom.stages.simplification.result import Details, Simplified
from scanloom.stages.simplification.task import Task
from scanloom.stages.surface.spatial_order import is_scattered, ordered, with_rows

P = TypeVar("P")
D = TypeVar("D", bound=Details)


def run_reordered(task: Task[P], run: Callable[[Task[P]], Simplified[D]]) -> Simplified[D]:
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
        return _reordered(task, run)
    except _kernels.InvalidMeshError:
        # Run on the original order, so that the error names the caller's indices.
        return run(task)


def _reordered(task: Task[P], run: Callable[[Task[P]], Simplified[D]]) -> Simplified[D]:
    order = ordered(task.mesh)
    rows = order.vertices
    importance = task.importance[rows] if len(task.importance) else task.importance
    found = run(replace(task, mesh=order.mesh, lock=task.lock[rows], importance=importance))
    sources = rows[found.vertex_source], order.triangles[found.triangle_source]
    # The sort is stable, because several vertices may have one source.
    vertices, triangles = (np.argsort(source, kind="stable") for source in sources)
    return replace(
        found,
        mesh=with_rows(found.mesh, vertices, triangles),
        vertex_source=sources[0][vertices].astype(np.int32),
        triangle_source=sources[1][triangles].astype(np.int32),
    )
