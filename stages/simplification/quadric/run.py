"""Simplification to a number of triangles by attribute quadrics, and a fit to the input at the end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages import _kernels
from stages.progress import Progress
from stages.simplification.color_weight import color_weight
from stages.simplification.kernel_input import Light, as_result, centred, fitted
from stages.simplification.params import SimplifyParams
from stages.simplification.records.record import CollapseRecord
from stages.simplification.reordered import reordered
from stages.simplification.result import Simplified
from stages.surface.mesh import Mesh
from stages.surface.spatial_order import Rows, is_scattered

# Triangles worked on at a time: small enough for the caches.
REGION_TRIANGLES = 8192


def by_quadrics(
    mesh: Mesh,
    params: SimplifyParams,
    lock: NDArray[np.bool_],
    importance: NDArray[np.float64],
    running: _kernels.Running,
    progress: Progress,
) -> Simplified:
    """Simplify with method `quadric`; see `simplify`.

    Parameters
    ----------
    lock : (n,) bool, vertices that stay.
    importance : (n,) float64 above 0, or (0,) for 1 everywhere.
    running : up to how many triangles, on how many threads, with a record or not, and what Ctrl-C does.

    Raises
    ------
    _kernels.InvalidMeshError
        For a mesh that is not an oriented manifold.
    """
    # A record names the vertices of the input all along.
    run = _in_order if not running.record and is_scattered(mesh) else _as_it_is
    return run(mesh, params, lock, importance, running, progress)


def _in_order(
    mesh: Mesh,
    params: SimplifyParams,
    lock: NDArray[np.bool_],
    importance: NDArray[np.float64],
    running: _kernels.Running,
    progress: Progress,
) -> Simplified:
    """Simplify a scattered mesh in an order that suits the caches; the result is in that of the input."""

    def run(mesh: Mesh, vertices: Rows) -> Simplified:
        factors = importance[vertices] if len(importance) else importance
        return _as_it_is(mesh, params, lock[vertices], factors, running, progress)

    try:
        return reordered(mesh, run)
    except _kernels.InvalidMeshError:
        # The message has to name what is wrong as the caller knows it.
        return _as_it_is(mesh, params, lock, importance, running, progress)


def _as_it_is(
    mesh: Mesh,
    params: SimplifyParams,
    lock: NDArray[np.bool_],
    importance: NDArray[np.float64],
    running: _kernels.Running,
    progress: Progress,
) -> Simplified:
    given = centred(mesh)
    weight = params.attribute_scale
    if weight is None:
        try:
            weight = color_weight(mesh, running.target_triangles, running.threads)
        except KeyboardInterrupt:
            if not running.partial:
                raise
            # There is only the input by now.
            weight, progress = 0.0, _no_more
    result = _kernels.simplify_by_quadrics(
        given.vertices,
        given.attributes,
        mesh.triangles,
        lock,
        importance,
        weight=weight,
        running=running,
        progress=progress,
    )
    source = result.vertex_source
    vertices, attributes = given.placed_back(result.vertices, source), result.attributes
    stopped_by, is_fitted = result.stopped_by, False
    if params.fit and result.collapses and stopped_by != "request":
        light = Light(vertices, attributes, result.triangles, source, result.became)
        try:
            vertices, attributes = fitted(
                light, given, lock, running.threads, _finishing(progress, len(mesh.triangles), running)
            )
            is_fitted = True
        except (_Content, KeyboardInterrupt) as stop:
            if not (running.partial or isinstance(stop, _Content)):
                raise
            stopped_by = "request"
    light_mesh = as_result(mesh, vertices, attributes, result.triangles, source, "simplify")
    kept = None
    if running.record:
        path = result.path.copy()
        path[:, :3] = given.placed_back(path[:, :3], result.survivor)
        base = mesh.with_(texture=None, notes=light_mesh.notes)
        kept = CollapseRecord(base, result.removed, result.survivor, path, lock)
    return Simplified(
        mesh=light_mesh,
        vertex_source=source,
        triangle_source=result.triangle_source,
        method="quadric",
        stopped_by=stopped_by,
        refused=result.refused,
        attribute_scale_m_per_level=weight,
        splits=0,
        collapses=result.collapses,
        attempts=result.attempts,
        triangles_before=len(mesh.triangles),
        fitted=is_fitted,
        record=kept,
    )


def _no_more(done: int, total: int) -> bool:  # noqa: ARG001
    return False


class _Content(Exception):  # noqa: N818 (nothing went wrong)
    """The caller wants what there is."""


def _finishing(progress: Progress, triangles: int, running: _kernels.Running) -> Progress:
    """Keep telling that all triangles are gone that had to go, while the rest is being done."""
    going = max(triangles - running.target_triangles, 0)

    def tell(done: int, total: int) -> None:  # noqa: ARG001
        if progress(going, going) is False:
            raise _Content

    return tell
