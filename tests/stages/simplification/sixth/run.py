"""Method `cut`: remove everything above a height."""

from __future__ import annotations

import numpy as np

from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.simplification.sixth.details import CutDetails
from scanloom.stages.simplification.sixth.params import CutParams
from scanloom.stages.simplification.task import Task

RESULT_VERSION = 1


def run(task: Task[CutParams]) -> SimplificationResult[CutDetails]:
    """Keep the triangles below the height."""
    x, _, z = task.mesh.vertices.T
    below = z <= task.params.max_height + task.params.slope * x
    kept = np.flatnonzero(below[task.mesh.triangles].all(axis=1)).astype(np.int32)
    return SimplificationResult(
        mesh=task.mesh.with_triangles(task.mesh.triangles[kept], kept),
        vertex_source=np.arange(len(task.mesh.vertices), dtype=np.int32),
        triangle_source=kept,
        method="cut",
        stopped_by="bounds",
        refused={},
        collapses=0,
        attempts=0,
        triangles_before=len(task.mesh.triangles),
        details=CutDetails(removed=len(task.mesh.triangles) - len(kept)),
    )
