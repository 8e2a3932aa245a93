"""Validation of repair operations: reject those that would create new defects.

Each operation is applied to a small copy of the mesh: all triangles around the vertices of its written
triangles. Defects are found there before and after, by the functions used for the complete mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scanloom.stages.cleaning.regularity import AngleLimits, find_local_irregular
from scanloom.stages.cleaning.repairs.defect_indices import REPAIRABLE, find_missing, is_triangle_class
from scanloom.stages.cleaning.repairs.editable_mesh import GONE
from scanloom.stages.cleaning.repairs.neighbourhood import Neighbourhood
from scanloom.stages.cleaning.repairs.operations import (
    ACCEPTED,
    FLIPPED,
    NEW_DEFECT,
    NON_MANIFOLD,
    OUTSIDE_NEIGHBOURHOOD,
    Operations,
)
from scanloom.stages.cleaning.repairs.ragged_array import find_distinct_pairs
from scanloom.stages.surface.cross_products import compute_area_vectors
from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.mesh import Vertices
from scanloom.stages.surface.texture import Texture, compute_signed_areas

# Defects that may turn into one another, because a repair may need several operations.
DEGENERATE_CLASSES = ("degenerate_triangles", "caps", "needles")
_CAP_CLASSES = [REPAIRABLE.index(name) for name in ("degenerate_triangles", "caps")]
# No operation may write triangles at these defects.
_NON_MANIFOLD_CLASSES = ("nonmanifold_edges", "inconsistent_edges", "singular_vertices", "focal_vertices")


@dataclass(frozen=True, eq=False)
class ValidationResult:
    """Outcome of the validation of k operations.

    Attributes
    ----------
    rejections : (k,) reason of rejection, or FINE.
    dependencies : operations (s,) and the triangles (s,) they depend on, as indices in the neighbourhood.
    """

    rejections: Ids
    dependencies: tuple[Ids, Ids]


@dataclass(frozen=True, eq=False)
class _TestMeshes:
    """Test meshes of all operations, merged into one mesh of disjoint parts.

    Attributes
    ----------
    owner : (s,) operation of each triangle.
    row : (s,) index of each triangle in the neighbourhood.
    vertex_owner : (v,) operation of each vertex.
    before, after : (s, 3) triangles before and after; GONE where deleted.
    positions, moved_positions : (v, 3) positions before and after, metres.
    written : (w,) triangles that operations write, in the order of `Operations.row`.
    """

    owner: Ids
    row: Ids
    vertex_owner: Ids
    before: Ids
    after: Ids
    positions: Vertices
    moved_positions: Vertices
    written: Ids


def validate_operations(
    around: Neighbourhood,
    operations: Operations,
    new_triangles: Ids,
    texture: Texture | None,
    limits: AngleLimits,
) -> ValidationResult:
    """Validate operations independently of each other.

    Parameters
    ----------
    around : neighbourhood that the operations refer to.
    operations : k operations.
    new_triangles : (w, 3) neighbourhood vertices of the written triangles; arbitrary in deleted triangles.
    texture : None to skip the check for flipped texture triangles.
    limits : angle thresholds.
    """
    count = len(operations)
    trial = _build_test_meshes(around, operations, new_triangles)
    rejections = operations.refused.copy()

    def refuse(owners: Ids, reason: int) -> None:
        against = np.zeros(count, bool)
        against[owners] = True
        rejections[against & (rejections == ACCEPTED)] = reason

    needed = around.triangles[operations.row].reshape(-1)
    refuse(np.repeat(operations.owner, 3)[~around.is_inner[needed]], OUTSIDE_NEIGHBOURHOOD)
    defects_before = find_local_irregular(trial.positions, trial.before.astype(np.int32), limits)
    there = np.flatnonzero(trial.after[:, 0] != GONE)
    defects_after = find_local_irregular(trial.moved_positions, trial.after[there].astype(np.int32), limits)
    defects_after = {
        name: there[ids] if is_triangle_class(name) else ids for name, ids in defects_after.items()
    }
    refuse(_find_non_manifold(operations, trial, defects_before), NON_MANIFOLD)
    refuse(_find_flipped(trial), FLIPPED)
    if texture is not None:
        refuse(_find_flipped_in_texture(around, operations, texture), FLIPPED)
    flawed = [
        np.concatenate([found[name] for name in DEGENERATE_CLASSES])
        for found in (defects_before, defects_after)
    ]
    refuse(trial.owner[np.setdiff1d(flawed[1], flawed[0])], NEW_DEFECT)
    for name, ids in defects_after.items():
        if name not in DEGENERATE_CLASSES:
            refuse(_find_owners(trial, name, find_missing(ids, defects_before[name])), NEW_DEFECT)
    opened_or_closed = find_missing(defects_before["border_edges"], defects_after["border_edges"])
    refuse(_find_owners(trial, "border_edges", opened_or_closed), NEW_DEFECT)
    refuse(_find_new_caps(operations, trial, defects_after), NEW_DEFECT)
    remaining_spikes = np.intersect1d(defects_before["spikes"], defects_after["spikes"])
    moves = operations.moved >= 0
    refuse(trial.vertex_owner[remaining_spikes][moves[trial.vertex_owner[remaining_spikes]]], NEW_DEFECT)
    return ValidationResult(rejections, (trial.owner, trial.row))


def _build_test_meshes(around: Neighbourhood, operations: Operations, new_triangles: Ids) -> _TestMeshes:
    vertex_count, row_count = len(around.vertex_indices), len(around.triangle_indices)
    touched = around.triangles[operations.row].reshape(-1)
    owner, vertex = find_distinct_pairs(np.repeat(operations.owner, 3), touched, vertex_count)
    which, at = around.find_corners(vertex)
    owner, row = find_distinct_pairs(owner[which], at // 3, row_count)
    keys = owner[:, None] * vertex_count + around.triangles[row]
    all_keys, index = np.unique(keys, return_inverse=True)
    before = index.reshape(-1, 3)
    written = np.searchsorted(owner * row_count + row, operations.owner * row_count + operations.row)
    after = before.copy()
    number = np.searchsorted(all_keys, operations.owner[:, None] * vertex_count + new_triangles)
    after[written] = np.where(operations.corner == GONE, GONE, number)
    of_vertex, number = np.divmod(all_keys, vertex_count)
    positions = around.positions[number]
    is_moved = operations.moved[of_vertex] == number
    moved_positions = np.where(is_moved[:, None], operations.target[of_vertex], positions)
    return _TestMeshes(owner, row, of_vertex, before, after, positions, moved_positions, written)


def _find_non_manifold(operations: Operations, trial: _TestMeshes, defects_before: dict[str, Ids]) -> Ids:
    """Return operations that would write triangles in non-manifold regions."""
    bad = np.zeros(len(trial.vertex_owner), bool)
    for name in _NON_MANIFOLD_CLASSES:
        bad[defects_before[name]] = True
    hit = bad[trial.before[trial.written]].any(axis=1)
    # Operations that only delete triangles are allowed: the triangle may be the cause.
    stays = trial.after[trial.written, 0] != GONE
    writes = np.bincount(operations.owner, stays, len(operations)) > 0
    return operations.owner[hit & writes[operations.owner]]


def _find_new_caps(operations: Operations, trial: _TestMeshes, defects_after: dict[str, Ids]) -> Ids:
    """Return operations on caps that would write caps.

    Rejecting them makes each operation reduce the number of caps, so that the repair terminates.
    """
    flat = np.zeros(len(trial.owner), bool)
    flat[defects_after["caps"]] = flat[defects_after["degenerate_triangles"]] = True
    hit = flat[trial.written] & np.isin(operations.kind[operations.owner], _CAP_CLASSES)
    return np.asarray(operations.owner[hit])


def _find_flipped(trial: _TestMeshes) -> Ids:
    """Return operations that would flip a triangle.

    A triangle counts as flipped if it faces away from the sum of the area vectors. This sum depends only on
    the boundary of the written region, so it is the same before and after.
    """
    owner = trial.owner[trial.written]
    before, after = trial.before[trial.written], trial.after[trial.written]
    count = int(trial.owner.max(initial=-1)) + 1
    sums = [np.bincount(owner, axis, count) for axis in compute_area_vectors(trial.positions[before]).T]
    faces = np.einsum(
        "ij,ij->i", compute_area_vectors(trial.moved_positions[after]), np.stack(sums, axis=1)[owner]
    )
    return np.asarray(owner[(faces <= 0) & (after[:, 0] != GONE)])


def _find_flipped_in_texture(around: Neighbourhood, operations: Operations, texture: Texture) -> Ids:
    """Return operations that would flip a triangle in the texture.

    Triangles without area in the texture cannot flip.
    """
    uvs = texture.uvs.reshape(-1, 2)
    before, after = (
        compute_signed_areas(uvs[corner])
        for corner in (around.input_corners[operations.row], operations.corner)
    )
    sums = np.bincount(operations.owner, before, len(operations))[operations.owner]
    counts = (operations.corner[:, 0] != GONE) & (operations.moved[operations.owner] < 0)
    return np.asarray(operations.owner[counts & (after * np.sign(sums) < 0)])


def _find_owners(trial: _TestMeshes, name: str, ids: Ids) -> Ids:
    """Return the operations of some vertices, edges or triangles."""
    if is_triangle_class(name):
        return np.asarray(trial.owner[ids])
    return np.asarray(trial.vertex_owner[ids[:, 0] if ids.ndim == 2 else ids])
