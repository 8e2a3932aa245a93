"""Manifold-only methods on arbitrary meshes.

Files duplicate vertices that have several texture coordinates, normals or colours, and scans contain
non-manifold vertices and edges. Methods that require a manifold get one: vertices at equal positions are
welded, and the surface is split into sheets at non-manifold vertices, which are then locked.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.simplification.codes import SIMPLIFY_ATTRIBUTES_LOST, SIMPLIFY_NOT_MANIFOLD
from scanloom.stages.simplification.grown_together import grown_together
from scanloom.stages.simplification.result import Details, Simplified
from scanloom.stages.simplification.seams.similar import equal_sets, may_have_equal
from scanloom.stages.simplification.task import Task
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.sheets import Sheets, taken_apart

P = TypeVar("P")
D = TypeVar("D", bound=Details)

# Larger differences of colour (levels) or normals (cosine) between duplicates are reported when they are
# averaged.
_SAME_COLOR = 1
_SAME_NORMAL = 0.999


def run_in_sheets(task: Task[P], run: Callable[[Task[P]], Simplified[D]]) -> Simplified[D]:
    """Run a manifold-only method on a mesh.

    The mesh may have duplicate vertices or be non-manifold.

    Parameters
    ----------
    task : arguments of the method.
    run : the method, which may require a manifold.
    """
    sheets = joined(task.mesh)
    if sheets is None:
        try:
            return run(task)
        except _kernels.InvalidMeshError:
            # The mesh is not a manifold; its sheets are.
            sheets = sheets_of(task.mesh)
    return run_on(sheets, task, run)


def run_on(sheets: Sheets, task: Task[P], run: Callable[[Task[P]], Simplified[D]]) -> Simplified[D]:
    """Run a method on the sheets of a mesh.

    The sources of the result refer to the mesh again.

    Parameters
    ----------
    sheets : sheets of `task.mesh`.
    task : arguments of the method.
    run : the method.
    """
    mesh = in_sheets(task.mesh, sheets)
    split = is_split(task.mesh, sheets)
    report_split(split)
    sets, source = sheets.sets, sheets.vertex_source
    locked = np.zeros(len(sets), bool)
    locked[sets[task.lock]] = True
    importance = task.importance
    if len(importance):
        most = np.zeros(len(sets))
        np.maximum.at(most, sets, importance)
        importance = most[sets[source]]
    found = _run_apart(
        replace(task, mesh=mesh, lock=locked[sets[source]] | split, importance=importance),
        run,
        may_touch=bool(sheets.touches.any()),
    )
    return replace(
        found,
        vertex_source=source[found.vertex_source],
        triangle_source=sheets.triangle_source[found.triangle_source],
        triangles_before=len(task.mesh.triangles),
    )


def _run_apart(task: Task[P], run: Callable[[Task[P]], Simplified[D]], *, may_touch: bool) -> Simplified[D]:
    """Run a method on touching sheets; lock and repeat if they merge."""
    with collecting(forward=False) as diagnostics:
        found = run(task)
    # The first run has reported 100 %. Repetitions must not move progress backwards.
    again = replace(task, progress=lambda _done, total: task.progress(total, total))
    while may_touch and found.stopped_by != "request":
        stays = grown_together(task.mesh, found) & ~again.lock
        if not stays.any():
            break
        again = replace(again, lock=again.lock | stays)
        with collecting(forward=False) as diagnostics:
            found = run(again)
    emit(*diagnostics)
    return found


def joined(mesh: Mesh) -> Sheets | None:
    """Weld duplicate vertices and split a mesh into sheets.

    Returns None if the mesh has no duplicate vertices.
    """
    if not may_have_equal(mesh.vertices):
        return None
    sheets = sheets_of(mesh)
    used = np.unique(mesh.triangles[sheets.triangle_source])
    return sheets if len(sheets.vertex_source) < len(used) else None


def sheets_of(mesh: Mesh) -> Sheets:
    """Split a mesh into manifold sheets, after welding vertices at equal positions."""
    return taken_apart(mesh.triangles, equal_sets(mesh.vertices))


def is_split(mesh: Mesh, sheets: Sheets) -> NDArray[np.bool_]:
    """Return a mask (p,) of vertices that splitting into sheets created.

    They must stay fixed, or cracks would open. Vertices that are separate in the mesh and only touch another
    vertex may move.
    """
    corners = mesh.triangles[sheets.triangle_source].reshape(-1).astype(np.int64)
    key = np.unique(corners << 32 | sheets.triangles.reshape(-1))
    of_mesh, of_sheets = key >> 32, key & 0xFFFFFFFF
    split = np.zeros(len(sheets.vertex_source), bool)
    split[of_sheets[np.bincount(of_mesh, minlength=len(mesh.vertices))[of_mesh] > 1]] = True
    return split


def report_split(split: NDArray[np.bool_]) -> None:
    """Warn if vertices were split; see `is_split`."""
    if split.any():
        emit(
            SIMPLIFY_NOT_MANIFOLD.warning(
                "the surface is not a manifold: it was split into sheets, which stay "
                "unchanged at {count:,} vertices where they touch",
                remedy="run clean first to simplify there, too.",
                count=np.count_nonzero(split),
            )
        )


def in_sheets(mesh: Mesh, sheets: Sheets) -> Mesh:
    """Build a mesh from sheets, and report attributes lost by welding."""
    source = sheets.vertex_source
    colors, normals = _one_color(mesh, sheets.sets), _one_normal(mesh, sheets.sets)
    return mesh.with_triangles(sheets.triangles, sheets.triangle_source).with_(
        vertices=mesh.vertices[source],
        colors=None if colors is None else colors[source],
        normals=None if normals is None else normals[source],
    )


def _one_color(mesh: Mesh, sets: NDArray[Any]) -> NDArray[np.uint8] | None:
    """Average the colours (n, 3) of duplicate vertices."""
    if mesh.colors is None:
        return None
    mean = _means(mesh.colors, sets)
    apart = np.abs(mean - mesh.colors).max(initial=0.0)
    if apart <= _SAME_COLOR:
        return mesh.colors
    emit(
        SIMPLIFY_ATTRIBUTES_LOST.warning(
            "duplicate vertices differ in colour by up to {levels:.0f} levels and were "
            "averaged; method seams of simplify keeps their colours.",
            levels=2 * apart,
        )
    )
    return np.rint(mean).astype(np.uint8)


def _one_normal(mesh: Mesh, sets: NDArray[Any]) -> NDArray[np.float64] | None:
    """Average the normals (n, 3) of duplicate vertices.

    Their length is 1, or 0 where they cancel out.
    """
    if mesh.normals is None:
        return None
    mean: NDArray[np.float64] = _means(mesh.normals, sets)
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    mean = np.divide(mean, length, out=np.zeros_like(mean), where=length > 0)
    cosine = np.einsum("ij,ij->i", mean, mesh.normals)
    if cosine.min(initial=1.0) >= _SAME_NORMAL:
        return mesh.normals
    emit(
        SIMPLIFY_ATTRIBUTES_LOST.warning(
            "duplicate vertices differ in their normals and were averaged; method seams of "
            "simplify keeps their normals."
        )
    )
    return mean


def _means(values: NDArray[Any], sets: NDArray[Any]) -> NDArray[np.float64]:
    size = np.maximum(np.bincount(sets), 1)
    sums = np.stack([np.bincount(sets, column) for column in np.asarray(values, np.float64).T], axis=1)
    return np.asarray((sums / size[:, None])[sets])
