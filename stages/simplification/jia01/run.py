"""Simplification within bounds on the changes of shape and texture summed around each edge."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stages import _kernels
from stages.errors import UsageError
from stages.progress import Progress
from stages.simplification.jia01.limits import limits_of
from stages.simplification.kernel_input import as_result, attributes_of
from stages.simplification.params import SimplifyParams
from stages.simplification.records.record import CollapseRecord
from stages.simplification.result import Simplified
from stages.surface.mesh import Mesh

# Triangles worked on at a time. Sums that grow from collapse to collapse mind the rims more than quadrics do,
# and want larger patches.
REGION_TRIANGLES = 16384

# What splitting may lead to: about 4 GB.
_TRIANGLE_LIMIT = 20_000_000


def by_sums(
    mesh: Mesh,
    params: SimplifyParams,
    lock: NDArray[np.bool_],
    running: _kernels.Running,
    progress: Progress,
) -> Simplified:
    """Simplify with method `jia01`; see `simplify`.

    Parameters
    ----------
    lock : (n,) bool, vertices that stay.
    running : up to how many triangles, on how many threads, and what Ctrl-C does.

    Raises
    ------
    UsageError
        For a resolution so fine that splitting passes 20 million triangles.
    _kernels.InvalidMeshError
        For a mesh that is not an oriented manifold.
    """
    limits = limits_of(
        mesh,
        params.resolution,
        params.max_shape,
        params.max_texture,
        params.attribute_scale,
        only_given=params.has_count,
        threads=running.threads,
    )
    try:
        result = _kernels.simplify(
            mesh.vertices,
            attributes_of(mesh),
            mesh.triangles,
            lock,
            bounds=limits.bounds,
            scales=limits.scales,
            attribute_scale=limits.attribute_scale,
            paper_rule=params.paper_rule,
            triangle_limit=max(_TRIANGLE_LIMIT, len(mesh.triangles)),
            running=running,
            progress=progress,
        )
    except _kernels.LimitError as error:
        raise UsageError(
            f"resolution is {limits.scales[0]:g} m, and with edges no longer than that {error}; "
            "give a coarser one."
        ) from error
    light = as_result(
        mesh, result.vertices, result.attributes, result.triangles, result.vertex_source, "simplify"
    )
    kept = None
    if running.record:
        base = mesh.with_(texture=None, notes=light.notes)
        way = result.removed, result.survivor, result.path
        if result.split is None:
            kept = CollapseRecord(base, *way, lock)
        else:
            vertices, attributes, triangles, vertex_source, triangle_source = result.split
            split = as_result(base, vertices, attributes, triangles, vertex_source, "simplify")
            kept = CollapseRecord(split, *way, lock[vertex_source], vertex_source, triangle_source)
    names = ("resolution", "max_shape", "max_texture")
    return Simplified(
        mesh=light,
        vertex_source=result.vertex_source,
        triangle_source=result.triangle_source,
        method="jia01",
        stopped_by=result.stopped_by,
        refused=result.refused,
        attribute_scale_m_per_level=limits.attribute_scale,
        splits=result.splits,
        collapses=result.collapses,
        attempts=result.attempts,
        triangles_before=len(mesh.triangles),
        record=kept,
        largest_shape_change_m=result.largest_shape_change,
        largest_texture_change_levels=result.largest_texture_change,
        resolution_m=limits.scales[0],
        max_shape_m=limits.scales[1],
        max_texture_levels=limits.max_texture,
        bounded=dict(zip(names, map(math.isfinite, limits.bounds), strict=True)),
    )
