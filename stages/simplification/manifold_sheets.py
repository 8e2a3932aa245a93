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
from scanloom.stages.simplification.result import Details, SimplificationResult
from scanloom.stages.simplification.seams.similar_vertices import (
    group_equal_vertices,
    has_possible_duplicates,
)
from scanloom.stages.simplification.sheet_contacts import find_merging_contacts
from scanloom.stages.simplification.task import Task
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.sheet_decomposition import Sheets, cut_into_sheets

P = TypeVar("P")
D = TypeVar("D", bound=Details)

# Larger differences of colour (levels) or normals (cosine) between duplicates are reported when they are
# averaged.
_MAX_COLOR_DIFFERENCE = 1
_MIN_NORMAL_COSINE = 0.999


def run_on_manifold_sheets(
    task: Task[P], run: Callable[[Task[P]], SimplificationResult[D]]
) -> SimplificationResult[D]:
    """Run a manifold-only method on a mesh.

    The mesh may have duplicate vertices or be non-manifold.

    Parameters
    ----------
    task : arguments of the method.
    run : the method, which may require a manifold.
    """
    sheets = weld_into_sheets(task.mesh)
    if sheets is None:
        try:
            return run(task)
        except _kernels.InvalidMeshError:
            # The mesh is not a manifold; its sheets are.
            sheets = split_into_sheets(task.mesh)
    return run_on_sheets(sheets, task, run)


def run_on_sheets(
    sheets: Sheets, task: Task[P], run: Callable[[Task[P]], SimplificationResult[D]]
) -> SimplificationResult[D]:
    """Run a method on the sheets of a mesh.

    The sources of the result refer to the mesh again.

    Parameters
    ----------
    sheets : sheets of `task.mesh`.
    task : arguments of the method.
    run : the method.
    """
    mesh = build_sheet_mesh(task.mesh, sheets)
    split = find_split_vertices(task.mesh, sheets)
    report_split_vertices(split)
    sets, source = sheets.weld_sets, sheets.vertex_source
    locked = np.zeros(len(sets), bool)
    locked[sets[task.lock]] = True
    importance = task.importance
    if len(importance):
        max_importance = np.zeros(len(sets))
        np.maximum.at(max_importance, sets, importance)
        importance = max_importance[sets[source]]
    found = _run_on_separate_sheets(
        replace(task, mesh=mesh, lock=locked[sets[source]] | split, importance=importance),
        run,
        may_touch=bool(sheets.is_contact.any()),
    )
    return replace(
        found,
        vertex_source=source[found.vertex_source],
        triangle_source=sheets.triangle_source[found.triangle_source],
        triangles_before=len(task.mesh.triangles),
    )


def _run_on_separate_sheets(
    task: Task[P], run: Callable[[Task[P]], SimplificationResult[D]], *, may_touch: bool
) -> SimplificationResult[D]:
    """Run a method on touching sheets; lock and repeat if they merge."""
    with collecting(forward=False) as diagnostics:
        found = run(task)
    # The first run has reported 100 %. Repetitions must not move progress backwards.
    next_task = replace(task, progress=lambda _done, total: task.progress(total, total))
    while may_touch and found.stopped_by != "request":
        is_merging = find_merging_contacts(task.mesh, found) & ~next_task.lock
        if not is_merging.any():
            break
        next_task = replace(next_task, lock=next_task.lock | is_merging)
        with collecting(forward=False) as diagnostics:
            found = run(next_task)
    emit(*diagnostics)
    return found


def weld_into_sheets(mesh: Mesh) -> Sheets | None:
    """Weld duplicate vertices and split a mesh into sheets.

    Returns None if the mesh has no duplicate vertices.
    """
    if not has_possible_duplicates(mesh.vertices):
        return None
    sheets = split_into_sheets(mesh)
    is_used = np.zeros(len(mesh.vertices), bool)
    is_used[mesh.triangles[sheets.triangle_source]] = True
    return sheets if len(sheets.vertex_source) < np.count_nonzero(is_used) else None


def split_into_sheets(mesh: Mesh) -> Sheets:
    """Split a mesh into manifold sheets, after welding vertices at equal positions."""
    return cut_into_sheets(mesh.triangles, group_equal_vertices(mesh.vertices))


def find_split_vertices(mesh: Mesh, sheets: Sheets) -> NDArray[np.bool_]:
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


def report_split_vertices(split: NDArray[np.bool_]) -> None:
    """Warn if vertices were split; see `find_split_vertices`."""
    if split.any():
        emit(
            SIMPLIFY_NOT_MANIFOLD.warning(
                "the surface is not a manifold: it was split into sheets, which stay "
                "unchanged at {count:,} vertices where they touch",
                remedy="run clean first to simplify there, too.",
                count=np.count_nonzero(split),
            )
        )


def build_sheet_mesh(mesh: Mesh, sheets: Sheets) -> Mesh:
    """Build a mesh from sheets, and report attributes lost by welding."""
    source = sheets.vertex_source
    colors, normals = _average_colors(mesh, sheets.weld_sets), _average_normals(mesh, sheets.weld_sets)
    return mesh.with_triangles(sheets.triangles, sheets.triangle_source).with_(
        vertices=mesh.vertices[source],
        colors=None if colors is None else colors[source],
        normals=None if normals is None else normals[source],
    )


def _average_colors(mesh: Mesh, sets: NDArray[Any]) -> NDArray[np.uint8] | None:
    """Average the colours (n, 3) of duplicate vertices."""
    if mesh.colors is None:
        return None
    mean = _average_sets(mesh.colors, sets)
    difference = np.abs(mean - mesh.colors).max(initial=0.0)
    if difference <= _MAX_COLOR_DIFFERENCE:
        return mesh.colors
    emit(
        SIMPLIFY_ATTRIBUTES_LOST.warning(
            "duplicate vertices differ in colour by up to {levels:.0f} levels and were "
            "averaged; method seams of simplify keeps their colours.",
            levels=2 * difference,
        )
    )
    return np.rint(mean).astype(np.uint8)


def _average_normals(mesh: Mesh, sets: NDArray[Any]) -> NDArray[np.float64] | None:
    """Average the normals (n, 3) of duplicate vertices.

    Their length is 1, or 0 where they cancel out.
    """
    if mesh.normals is None:
        return None
    mean: NDArray[np.float64] = _average_sets(mesh.normals, sets)
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    mean = np.divide(mean, length, out=np.zeros_like(mean), where=length > 0)
    cosine = np.einsum("ij,ij->i", mean, mesh.normals)
    if cosine.min(initial=1.0) >= _MIN_NORMAL_COSINE:
        return mesh.normals
    emit(
        SIMPLIFY_ATTRIBUTES_LOST.warning(
            "duplicate vertices differ in their normals and were averaged; method seams of "
            "simplify keeps their normals."
        )
    )
    return mean


def _average_sets(values: NDArray[Any], sets: NDArray[Any]) -> NDArray[np.float64]:
    size = np.maximum(np.bincount(sets), 1)
    sums = np.stack([np.bincount(sets, column) for column in np.asarray(values, np.float64).T], axis=1)
    return np.asarray((sums / size[:, None])[sets])
