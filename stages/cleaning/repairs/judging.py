"""Validation of repair operations: reject those that would create new defects.

Each operation is applied to a small copy of the mesh: all triangles around the vertices of its written
triangles. Defects are found there before and after, by the functions used for the complete mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scanloom.stages.cleaning.regularity import Limits, irregular_neighbourhoods
from scanloom.stages.cleaning.repairs.edited import GONE
from scanloom.stages.cleaning.repairs.neighbourhood import Neighbourhood
from scanloom.stages.cleaning.repairs.operations import FINE, RIM, TANGLED, TURNS, WORSE, Operations
from scanloom.stages.cleaning.repairs.places import REPAIRABLE, is_of_triangles, missing_in
from scanloom.stages.cleaning.repairs.ragged import distinct_pairs
from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.mesh import Vertices
from scanloom.stages.surface.texture import Texture, signed_areas

# Defects that may turn into one another, because a repair may need several operations.
FLAWS = ("degenerate_triangles", "caps", "needles")
_OF_CAPS = [REPAIRABLE.index(name) for name in ("degenerate_triangles", "caps")]
# No operation may write triangles at these defects.
_TANGLES = ("nonmanifold_edges", "inconsistent_edges", "singular_vertices", "focal_vertices")


@dataclass(frozen=True, eq=False)
class Judged:
    """Outcome of the validation of k operations.

    Attributes
    ----------
    refused : (k,) reason of rejection, or FINE.
    seen : operations (s,) and the triangles (s,) they depend on, as indices in the neighbourhood.
    """

    refused: Ids
    seen: tuple[Ids, Ids]


@dataclass(frozen=True, eq=False)
class _Trial:
    """Test meshes of all operations, merged into one mesh of disjoint parts.

    Attributes
    ----------
    owner : (s,) operation of each triangle.
    row : (s,) index of each triangle in the neighbourhood.
    of_vertex : (v,) operation of each vertex.
    before, after : (s, 3) triangles before and after; GONE where deleted.
    places, moved : (v, 3) positions before and after, metres.
    written : (w,) triangles that operations write, in the order of `Operations.row`.
    """

    owner: Ids
    row: Ids
    of_vertex: Ids
    before: Ids
    after: Ids
    places: Vertices
    moved: Vertices
    written: Ids


def judge(
    around: Neighbourhood,
    operations: Operations,
    new: Ids,
    texture: Texture | None,
    limits: Limits,
) -> Judged:
    """Validate operations independently of each other.

    Parameters
    ----------
    around : neighbourhood that the operations refer to.
    operations : k operations.
    new : (w, 3) neighbourhood vertices of the written triangles; arbitrary in deleted triangles.
    texture : None to skip the check for flipped texture triangles.
    limits : angle thresholds.
    """
    count = len(operations)
    trial = _trial(around, operations, new)
    refused = operations.refused.copy()

    def refuse(owners: Ids, reason: int) -> None:
        against = np.zeros(count, bool)
        against[owners] = True
        refused[against & (refused == FINE)] = reason

    needed = around.triangles[operations.row].reshape(-1)
    refuse(np.repeat(operations.owner, 3)[~around.is_inner[needed]], RIM)
    was = irregular_neighbourhoods(trial.places, trial.before.astype(np.int32), limits)
    there = np.flatnonzero(trial.after[:, 0] != GONE)
    now = irregular_neighbourhoods(trial.moved, trial.after[there].astype(np.int32), limits)
    now = {name: there[ids] if is_of_triangles(name) else ids for name, ids in now.items()}
    refuse(_tangled(operations, trial, was), TANGLED)
    refuse(_turned(trial), TURNS)
    if texture is not None:
        refuse(_turned_in_images(around, operations, texture), TURNS)
    flawed = [np.concatenate([found[name] for name in FLAWS]) for found in (was, now)]
    refuse(trial.owner[np.setdiff1d(flawed[1], flawed[0])], WORSE)
    for name, ids in now.items():
        if name not in FLAWS:
            refuse(_owners(trial, name, missing_in(ids, was[name])), WORSE)
    opened_or_closed = missing_in(was["border_edges"], now["border_edges"])
    refuse(_owners(trial, "border_edges", opened_or_closed), WORSE)
    refuse(_still_flat(operations, trial, now), WORSE)
    still = np.intersect1d(was["spikes"], now["spikes"])
    moves = operations.moved >= 0
    refuse(trial.of_vertex[still][moves[trial.of_vertex[still]]], WORSE)
    return Judged(refused, (trial.owner, trial.row))


def _trial(around: Neighbourhood, operations: Operations, new: Ids) -> _Trial:
    vertex_count, row_count = len(around.vertices), len(around.rows)
    touched = around.triangles[operations.row].reshape(-1)
    owner, vertex = distinct_pairs(np.repeat(operations.owner, 3), touched, vertex_count)
    which, at = around.corners_at(vertex)
    owner, row = distinct_pairs(owner[which], at // 3, row_count)
    keys = owner[:, None] * vertex_count + around.triangles[row]
    all_keys, index = np.unique(keys, return_inverse=True)
    before = index.reshape(-1, 3)
    written = np.searchsorted(owner * row_count + row, operations.owner * row_count + operations.row)
    after = before.copy()
    number = np.searchsorted(all_keys, operations.owner[:, None] * vertex_count + new)
    after[written] = np.where(operations.corner == GONE, GONE, number)
    of_vertex, number = np.divmod(all_keys, vertex_count)
    places = around.places[number]
    is_moved = operations.moved[of_vertex] == number
    moved = np.where(is_moved[:, None], operations.target[of_vertex], places)
    return _Trial(owner, row, of_vertex, before, after, places, moved, written)


def _tangled(operations: Operations, trial: _Trial, was: dict[str, Ids]) -> Ids:
    """Return operations that would write triangles in non-manifold regions."""
    bad = np.zeros(len(trial.of_vertex), bool)
    for name in _TANGLES:
        bad[was[name]] = True
    hit = bad[trial.before[trial.written]].any(axis=1)
    # Operations that only delete triangles are allowed: the triangle may be the cause.
    stays = trial.after[trial.written, 0] != GONE
    writes = np.bincount(operations.owner, stays, len(operations)) > 0
    return operations.owner[hit & writes[operations.owner]]


def _still_flat(operations: Operations, trial: _Trial, now: dict[str, Ids]) -> Ids:
    """Return operations on caps that would write caps.

    Rejecting them makes each operation reduce the number of caps, so that the repair terminates.
    """
    flat = np.zeros(len(trial.owner), bool)
    flat[now["caps"]] = flat[now["degenerate_triangles"]] = True
    hit = flat[trial.written] & np.isin(operations.kind[operations.owner], _OF_CAPS)
    return np.asarray(operations.owner[hit])


def _turned(trial: _Trial) -> Ids:
    """Return operations that would flip a triangle.

    A triangle counts as flipped if it faces away from the sum of the area vectors. This sum depends only on
    the boundary of the written region, so it is the same before and after.
    """
    owner = trial.owner[trial.written]
    before, after = trial.before[trial.written], trial.after[trial.written]
    count = int(trial.owner.max(initial=-1)) + 1
    sums = [np.bincount(owner, axis, count) for axis in _area_vectors(trial.places[before]).T]
    faces = np.einsum("ij,ij->i", _area_vectors(trial.moved[after]), np.stack(sums, axis=1)[owner])
    return np.asarray(owner[(faces <= 0) & (after[:, 0] != GONE)])


def _turned_in_images(around: Neighbourhood, operations: Operations, texture: Texture) -> Ids:
    """Return operations that would flip a triangle in the texture.

    Triangles without area in the texture cannot flip.
    """
    uvs = texture.uvs.reshape(-1, 2)
    before, after = (
        signed_areas(uvs[corner]) for corner in (around.corner[operations.row], operations.corner)
    )
    sums = np.bincount(operations.owner, before, len(operations))[operations.owner]
    counts = (operations.corner[:, 0] != GONE) & (operations.moved[operations.owner] < 0)
    return np.asarray(operations.owner[counts & (after * np.sign(sums) < 0)])


def _area_vectors(corners: Vertices) -> Vertices:
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _owners(trial: _Trial, name: str, ids: Ids) -> Ids:
    """Return the operations of some vertices, edges or triangles."""
    if is_of_triangles(name):
        return np.asarray(trial.owner[ids])
    return np.asarray(trial.of_vertex[ids[:, 0] if ids.ndim == 2 else ids])
