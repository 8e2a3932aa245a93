"""Iterative repair of the defects in a neighbourhood.

Each round applies all valid operations that are independent of each other:

    extract the neighbourhood of the defects
    repeat:
        find the defects, and create operations that may repair them
        validate operations near changes of the last round
        apply an independent subset of the valid operations
    until no operation is valid
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.cleaning.regularity import AngleLimits, compute_corner_angles, find_local_irregular
from scanloom.stages.cleaning.repairs.defect_indices import REPAIRABLE, compute_edge_keys
from scanloom.stages.cleaning.repairs.editable_mesh import EditableMesh
from scanloom.stages.cleaning.repairs.neighbourhood import (
    Neighbourhood,
    extract_neighbourhood,
    find_inner_vertices,
    grow_rings,
)
from scanloom.stages.cleaning.repairs.operations import (
    ACCEPTED,
    OUTSIDE_NEIGHBOURHOOD,
    CornerEquality,
    Operations,
    concatenate_operations,
    create_collapses,
    create_deletions,
    create_flips,
    create_smoothings,
)
from scanloom.stages.cleaning.repairs.repair_validation import ValidationResult, validate_operations
from scanloom.stages.surface.edges import Ids

# An operation depends on triangles within two rings. Defects farther away are handled by the next
# neighbourhood.
_RINGS = 2
# Multiplicative hashing (Knuth) gives an arbitrary but reproducible order that does not follow the mesh
# layout.
_HASH_MULTIPLIER = 2654435761


@dataclass(eq=False)
class RepairLog:
    """Log of repairs, by class and defect.

    Defects are mesh indices; edges are encoded as smaller · n + larger.

    Attributes
    ----------
    rejections : last reason of rejection, by (class, defect).
    edit_defects : (class, defect) of each edit, by edit index.
    undone_defects : (class, defect) of undone edits.
    restored_triangles : reason of the undo, by restored triangle.
    """

    rejections: dict[tuple[int, int], int] = field(default_factory=dict)
    edit_defects: list[tuple[int, int]] = field(default_factory=list)
    undone_defects: set[tuple[int, int]] = field(default_factory=set)
    restored_triangles: dict[int, int] = field(default_factory=dict)


def repair_all(
    edited: EditableMesh, rows: Ids, limits: AngleLimits, log: RepairLog, progress: Callable[[], object]
) -> None:
    """Apply all valid repairs around some triangles; log them in `log`."""
    equality = CornerEquality(edited.mesh)
    while len(rows):
        before = edited.edit_count
        count = len(edited.first_vertex)
        near = grow_rings(edited.triangles, count, rows, _RINGS)
        is_inner = find_inner_vertices(edited.triangles, count, near)
        waiting = _repair_neighbourhood(edited, near, is_inner, equality, limits, log, progress)
        rows = waiting if edited.edit_count > before else rows[:0]


def _repair_neighbourhood(
    edited: EditableMesh,
    rows: Ids,
    is_inner: NDArray[np.bool_],
    equality: CornerEquality,
    limits: AngleLimits,
    log: RepairLog,
    progress: Callable[[], object],
) -> Ids:
    """Repair defects in a neighbourhood until no valid operation is left.

    Parameters
    ----------
    rows : triangles of the neighbourhood.
    is_inner : (n,) mask of the vertices whose triangles are all in the neighbourhood.

    Returns
    -------
    Triangles of operations that need a larger neighbourhood.
    """
    waiting = np.zeros(0, np.int64)
    is_affected: NDArray[np.bool_] | None = None
    while True:
        progress()
        around = extract_neighbourhood(edited, rows, is_inner)
        operations = _create_operations(around, equality, limits)
        is_affected_operation = np.zeros(len(operations), bool)
        if is_affected is None:
            is_affected_operation[:] = True
        else:
            seen_again = is_affected[around.vertex_indices][around.triangles[operations.row]].any(axis=1)
            is_affected_operation[operations.owner[seen_again]] = True
        operations = operations.select(is_affected_operation)
        if len(operations) == 0:
            return waiting[edited.is_present(waiting)]
        new = np.searchsorted(around.vertex_indices, edited.get_vertices(operations.corner))
        judged = validate_operations(around, operations, new, edited.mesh.texture, limits)
        places = _to_mesh_defects(edited, around, operations)
        of_rim = judged.rejections[operations.owner] == OUTSIDE_NEIGHBOURHOOD
        waiting = np.union1d(waiting, around.triangle_indices[operations.row[of_rim]])
        for kind, place, reason in zip(operations.kind, places, judged.rejections, strict=True):
            if reason != ACCEPTED:
                log.rejections[int(kind), int(place)] = int(reason)
        chosen = _select_independent(judged, operations, places, len(around.triangle_indices))
        if not chosen.any():
            return waiting[edited.is_present(waiting)]
        is_affected = np.zeros(len(edited.first_vertex), bool)
        of_fine = judged.rejections[judged.dependencies[0]] == ACCEPTED
        is_affected[around.vertex_indices[around.triangles[judged.dependencies[1][of_fine]]]] = True
        _apply_operations(edited, around, operations, judged, chosen)
        log.edit_defects += zip(operations.kind[chosen].tolist(), places[chosen].tolist(), strict=True)


def _create_operations(around: Neighbourhood, equality: CornerEquality, limits: AngleLimits) -> Operations:
    """Create candidate operations for each repairable defect of a neighbourhood."""
    found = find_local_irregular(around.positions, around.triangles.astype(np.int32), limits)
    numbered = {name: number for number, name in enumerate(REPAIRABLE)}

    def iterate_operations() -> Iterator[Operations]:
        yield create_deletions(numbered["duplicate_triangles"], found["duplicate_triangles"])
        flat = found["degenerate_triangles"]
        obtuse = compute_corner_angles(around.positions, around.triangles[flat]).max(axis=1, initial=0) > 90
        for name, some in (("caps", found["caps"]), ("degenerate_triangles", flat[obtuse])):
            if len(some):
                side = _find_side(around, some, longest=True)
                yield create_flips(numbered[name], around, equality, some, side)
        for name, some in (("needles", found["needles"]), ("degenerate_triangles", flat[~obtuse])):
            if len(some) == 0:
                continue
            short = _find_side(around, some, longest=False)
            for to_head in (True, False):
                yield create_collapses(numbered[name], around, equality, some, short, to_head=to_head)
        if len(found["sharp_edges"]):
            folds = _find_halfedges(around, found["sharp_edges"])
            yield create_flips(numbered["sharp_edges"], around, equality, folds, folds)
        yield create_smoothings(numbered["spikes"], around, equality, found["spikes"])

    return concatenate_operations(list(iterate_operations()))


def _find_side(around: Neighbourhood, rows: Ids, *, longest: bool) -> Ids:
    """Return the halfedge of the longest or shortest edge of each triangle."""
    corners = around.positions[around.triangles[rows]]
    length = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    return np.asarray(3 * rows + (length.argmax(axis=1) if longest else length.argmin(axis=1)))


def _find_halfedges(around: Neighbourhood, ends: Ids) -> Ids:
    """Return the first halfedge of each edge (k, 2)."""
    edges, count = around.edges, len(around.vertex_indices)
    keys = edges.ends[:, 0] * count + edges.ends[:, 1]
    return np.asarray(edges.halfedges[edges.start[np.searchsorted(keys, ends[:, 0] * count + ends[:, 1])]])


def _to_mesh_defects(edited: EditableMesh, around: Neighbourhood, operations: Operations) -> Ids:
    """Translate the defect of each operation to mesh indices.

    Folded edges become edge keys.
    """
    place, kind = operations.place, operations.kind
    found = np.empty(len(operations), np.int64)
    fold, spike = kind == REPAIRABLE.index("sharp_edges"), kind == REPAIRABLE.index("spikes")
    of_row = ~fold & ~spike
    found[of_row] = around.triangle_indices[place[of_row]]
    found[spike] = around.vertex_indices[place[spike]]
    ends = around.edges.ends[around.edges.of_halfedge[place[fold]]]
    found[fold] = compute_edge_keys(around.vertex_indices[ends], len(edited.first_vertex))
    return found


def _select_independent(
    judged: ValidationResult, operations: Operations, places: Ids, row_count: int
) -> NDArray[np.bool_]:
    """Select a maximal independent set of the valid operations.

    Two operations are independent if no triangle affects both.
    """
    order = (places.astype(np.uint64) * np.uint64(_HASH_MULTIPLIER)) % np.uint64(2**32)
    # The stable sort prefers the first of several operations on one defect.
    rank = np.empty(len(operations), np.int64)
    rank[np.argsort(order, kind="stable")] = np.arange(len(operations))
    owner, row = judged.dependencies
    chosen = np.zeros(len(operations), bool)
    is_open = judged.rejections == ACCEPTED
    is_taken = np.zeros(row_count, bool)
    while is_open.any():
        rows_of_open = is_open[owner]
        a, b = owner[rows_of_open], row[rows_of_open]
        min_rank = np.full(row_count, len(operations))
        np.minimum.at(min_rank, b, rank[a])
        first = is_open.copy()
        first[a[min_rank[b] < rank[a]]] = False
        chosen |= first
        is_taken[b[first[a]]] = True
        is_open &= ~first
        is_open[a[is_taken[b]]] = False
    return chosen


def _apply_operations(
    edited: EditableMesh,
    around: Neighbourhood,
    operations: Operations,
    judged: ValidationResult,
    chosen: NDArray[np.bool_],
) -> None:
    number = np.cumsum(chosen) - 1
    seen = chosen[judged.dependencies[0]]
    written = chosen[operations.owner]
    moves = np.flatnonzero(chosen & (operations.moved >= 0))
    edited.apply_edits(
        (number[judged.dependencies[0][seen]], around.triangle_indices[judged.dependencies[1][seen]]),
        (
            number[operations.owner[written]],
            around.triangle_indices[operations.row[written]],
            operations.corner[written],
        ),
        (number[moves], around.vertex_indices[operations.moved[moves]], operations.target[moves]),
        int(np.count_nonzero(chosen)),
    )
