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

from scanloom.stages.cleaning.regularity import Limits, corner_angles, irregular_neighbourhoods
from scanloom.stages.cleaning.repairs.edited import Edited
from scanloom.stages.cleaning.repairs.judging import Judged, judge
from scanloom.stages.cleaning.repairs.neighbourhood import Neighbourhood, grown, inner, neighbourhood
from scanloom.stages.cleaning.repairs.operations import (
    FINE,
    RIM,
    Operations,
    Sameness,
    collapses,
    drops,
    flips,
    smoothings,
    together,
)
from scanloom.stages.cleaning.repairs.places import REPAIRABLE, edge_keys
from scanloom.stages.surface.edges import Ids

# An operation depends on triangles within two rings. Defects farther away are handled by the next
# neighbourhood.
_RINGS = 2
# Multiplicative hashing (Knuth) gives an arbitrary but reproducible order that does not follow the mesh
# layout.
_SCATTER = 2654435761


@dataclass(eq=False)
class Account:
    """Log of repairs, by class and defect.

    Defects are mesh indices; edges are encoded as smaller · n + larger.

    Attributes
    ----------
    refused : last reason of rejection, by (class, defect).
    made : (class, defect) of each edit, by edit index.
    undone : (class, defect) of undone edits.
    restored : reason of the undo, by restored triangle.
    """

    refused: dict[tuple[int, int], int] = field(default_factory=dict)
    made: list[tuple[int, int]] = field(default_factory=list)
    undone: set[tuple[int, int]] = field(default_factory=set)
    restored: dict[int, int] = field(default_factory=dict)


def repair_all(
    edited: Edited, rows: Ids, limits: Limits, account: Account, progress: Callable[[], object]
) -> None:
    """Apply all valid repairs around some triangles; log them in `account`."""
    same = Sameness(edited.mesh)
    while len(rows):
        before = edited.edits
        count = len(edited.first)
        near = grown(edited.triangles, count, rows, _RINGS)
        is_inner = inner(edited.triangles, count, near)
        waiting = _in_rounds(edited, near, is_inner, same, limits, account, progress)
        rows = waiting if edited.edits > before else rows[:0]


def _in_rounds(
    edited: Edited,
    rows: Ids,
    is_inner: NDArray[np.bool_],
    same: Sameness,
    limits: Limits,
    account: Account,
    progress: Callable[[], object],
) -> Ids:
    """Repair within a fixed neighbourhood.

    Returns
    -------
    Triangles of operations that need a larger neighbourhood.
    """
    waiting = np.zeros(0, np.int64)
    stirred: NDArray[np.bool_] | None = None
    while True:
        progress()
        around = neighbourhood(edited, rows, is_inner)
        operations = _operations(around, same, limits)
        touched = np.zeros(len(operations), bool)
        if stirred is None:
            touched[:] = True
        else:
            seen_again = stirred[around.vertices][around.triangles[operations.row]].any(axis=1)
            touched[operations.owner[seen_again]] = True
        operations = operations.only(touched)
        new = np.searchsorted(around.vertices, edited.vertex_of(operations.corner))
        judged = judge(around, operations, new, edited.mesh.texture, limits)
        places = _places(edited, around, operations)
        of_rim = judged.refused[operations.owner] == RIM
        waiting = np.union1d(waiting, around.rows[operations.row[of_rim]])
        for kind, place, why in zip(operations.kind, places, judged.refused, strict=True):
            if why != FINE:
                account.refused[int(kind), int(place)] = int(why)
        chosen = _independent(judged, operations, places, len(around.rows))
        if not chosen.any():
            return waiting[edited.is_there(waiting)]
        stirred = np.zeros(len(edited.first), bool)
        of_fine = judged.refused[judged.seen[0]] == FINE
        stirred[around.vertices[around.triangles[judged.seen[1][of_fine]]]] = True
        _make(edited, around, operations, judged, chosen)
        account.made += zip(operations.kind[chosen].tolist(), places[chosen].tolist(), strict=True)


def _operations(around: Neighbourhood, same: Sameness, limits: Limits) -> Operations:
    """Create candidate operations for each repairable defect of a neighbourhood."""
    found = irregular_neighbourhoods(around.places, around.triangles.astype(np.int32), limits)
    numbered = {name: number for number, name in enumerate(REPAIRABLE)}

    def made() -> Iterator[Operations]:
        yield drops(numbered["duplicate_triangles"], found["duplicate_triangles"])
        flat = found["degenerate_triangles"]
        obtuse = corner_angles(around.places, around.triangles[flat]).max(axis=1, initial=0) > 90
        for name, some in (("caps", found["caps"]), ("degenerate_triangles", flat[obtuse])):
            yield flips(numbered[name], around, same, some, _side(around, some, longest=True))
        for name, some in (("needles", found["needles"]), ("degenerate_triangles", flat[~obtuse])):
            short = _side(around, some, longest=False)
            for to_head in (True, False):
                yield collapses(numbered[name], around, same, some, short, to_head=to_head)
        folds = _halfedges(around, found["sharp_edges"])
        yield flips(numbered["sharp_edges"], around, same, folds, folds)
        yield smoothings(numbered["spikes"], around, same, found["spikes"])

    return together(list(made()))


def _side(around: Neighbourhood, rows: Ids, *, longest: bool) -> Ids:
    """Return the halfedge of the longest or shortest edge of each triangle."""
    corners = around.places[around.triangles[rows]]
    length = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    return np.asarray(3 * rows + (length.argmax(axis=1) if longest else length.argmin(axis=1)))


def _halfedges(around: Neighbourhood, ends: Ids) -> Ids:
    """Return the first halfedge of each edge (k, 2)."""
    edges, count = around.edges, len(around.vertices)
    keys = edges.ends[:, 0] * count + edges.ends[:, 1]
    return np.asarray(edges.halfedges[edges.start[np.searchsorted(keys, ends[:, 0] * count + ends[:, 1])]])


def _places(edited: Edited, around: Neighbourhood, operations: Operations) -> Ids:
    """Translate the defect of each operation to mesh indices.

    Folded edges become edge keys.
    """
    place, kind = operations.place, operations.kind
    found = np.empty(len(operations), np.int64)
    fold, spike = kind == REPAIRABLE.index("sharp_edges"), kind == REPAIRABLE.index("spikes")
    of_row = ~fold & ~spike
    found[of_row] = around.rows[place[of_row]]
    found[spike] = around.vertices[place[spike]]
    ends = around.edges.ends[around.edges.of_halfedge[place[fold]]]
    found[fold] = edge_keys(around.vertices[ends], len(edited.first))
    return found


def _independent(judged: Judged, operations: Operations, places: Ids, row_count: int) -> NDArray[np.bool_]:
    """Select a maximal independent set of the valid operations.

    Two operations are independent if no triangle affects both.
    """
    order = (places.astype(np.uint64) * np.uint64(_SCATTER)) % np.uint64(2**32)
    # The stable sort prefers the first of several operations on one defect.
    rank = np.empty(len(operations), np.int64)
    rank[np.argsort(order, kind="stable")] = np.arange(len(operations))
    owner, row = judged.seen
    chosen = np.zeros(len(operations), bool)
    is_open = judged.refused == FINE
    is_taken = np.zeros(row_count, bool)
    while is_open.any():
        rows_of_open = is_open[owner]
        a, b = owner[rows_of_open], row[rows_of_open]
        least = np.full(row_count, len(operations))
        np.minimum.at(least, b, rank[a])
        first = is_open.copy()
        first[a[least[b] < rank[a]]] = False
        chosen |= first
        is_taken[b[first[a]]] = True
        is_open &= ~first
        is_open[a[is_taken[b]]] = False
    return chosen


def _make(
    edited: Edited,
    around: Neighbourhood,
    operations: Operations,
    judged: Judged,
    chosen: NDArray[np.bool_],
) -> None:
    number = np.cumsum(chosen) - 1
    seen = chosen[judged.seen[0]]
    written = chosen[operations.owner]
    moves = np.flatnonzero(chosen & (operations.moved >= 0))
    edited.make(
        (number[judged.seen[0][seen]], around.rows[judged.seen[1][seen]]),
        (
            number[operations.owner[written]],
            around.rows[operations.row[written]],
            operations.corner[written],
        ),
        (number[moves], around.vertices[operations.moved[moves]], operations.target[moves]),
        int(np.count_nonzero(chosen)),
    )
