"""Simplify a mesh in pieces: their insides, the strips along the faces where they meet, and then the whole.

While a part is simplified, the vertices that other parts name stay as they are, and so do those next to them,
so that parts always fit: nothing cracks, and no edge comes to have more than two triangles. The insides come
one after the other; the strips along all faces, a few voxels wide, are then one mesh. What they leave has
room in memory and is simplified once more, which makes the surface as light where parts were joined as
elsewhere. Both rounds share out the bounds, which add up: what is proven for each is proven for both
together, since the distance of surfaces obeys the triangle inequality.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.errors import StageError
from stages.progress import Progress, silent
from stages.simplification.params import SimplifyParams
from stages.simplification.result import Simplified
from stages.simplification.simplify import simplify
from stages.surface.mesh import Mesh, Triangles
from stages.surface.pieces import Extent, Part, Pieces

Numbers = NDArray[np.int64]

# Times the spacing: a vertex farther inside than this is named by no other piece's triangles, nor are those
# it is joined to.
_RIM = 4.0
# Of bounds, the share that is for the parts; the rest is for the whole.
_FOR_PARTS = 0.6
# Of a number of triangles, how many times as many parts keep for the whole to choose from.
_SPARE = 1.5
# Figures of bounds, which add up.
_BOUNDS = ("max_shape", "max_color")
_ADD_UP = (
    "shape_bound_m",
    "color_bound_levels",
    "shape_attained_m",
    "color_attained_levels",
    "slack_m",
    "color_slack_levels",
    "max_shape_m",
    "max_color_levels",
)


@dataclass(frozen=True, eq=False)
class InPieces:
    """What `simplify_in_pieces` returns.

    Attributes
    ----------
    mesh : all of it.
    parts : figures of each inside, and of the strips; see `Simplified.figures`.
    whole : of the round over all of it; None where what is left of the bounds is too little for one.
    """

    mesh: Mesh
    parts: tuple[Mapping[str, Any], ...]
    whole: Mapping[str, Any] | None

    def figures(self) -> dict[str, Any]:
        """Return sums of counts; of bounds the worst of the parts' and the whole's together."""
        rounds = self.parts if self.whole is None else (*self.parts, self.whole)
        before, after = sum(part["triangles_before"] for part in self.parts), len(self.mesh.triangles)
        details = dict(rounds[-1]["details"])
        for name in _ADD_UP:
            if details.get(name) is not None:
                details[name] = max(part["details"][name] for part in self.parts)
                details[name] += 0 if self.whole is None else self.whole["details"][name]
        if "proven" in details:
            details["proven"] = all(one["details"]["proven"] for one in rounds)
        return {
            **rounds[-1],
            "triangles_before": before,
            "triangles": after,
            "vertices": len(self.mesh.vertices),
            "reduction": 1 - after / before if before else 0.0,
            "collapses": sum(one["collapses"] for one in rounds),
            "attempts": sum(one["attempts"] for one in rounds),
            "details": details,
            "parts": len(self.parts),
            "warnings": sorted({text for one in rounds for text in one["warnings"]}),
        }


def simplify_in_pieces(path: Path, params: SimplifyParams, *, progress: Progress = silent) -> InPieces:
    """Make a PLY file in pieces light; the result has room in memory.

    Parameters
    ----------
    path : of the file, with its table of pieces beside it: what fusion and cleaning left.
    params : see SimplifyParams. A number of triangles is shared out by the triangles each part has.
    progress : called with the triangles that are done and all.

    Raises
    ------
    InputError, MeshError, UsageError
        As `read_ply` and `simplify`.
    """
    pieces = Pieces(path)
    total = pieces.triangle_count
    of_parts = _of_parts(params, total)
    found: list[tuple[Mesh, Numbers]] = []
    figures: list[Mapping[str, Any]] = []
    strips: list[_Cut] = []
    # The whole counts as much as a tenth.
    steps = total + total // 10
    passed = 0

    def add(cut: _Cut) -> None:
        nonlocal passed
        start, count = passed, len(cut.mesh.triangles)
        lock = _with_neighbours(cut.mesh.triangles, cut.is_of_both)

        def told(done: int, total: int) -> object:
            return progress(start + count * done // max(total, 1), steps)

        light: Simplified[Any] = simplify(cut.mesh, of_parts, lock=lock, progress=told)
        found.append((light.mesh, _numbers(cut, light)))
        figures.append(light.figures())
        passed = start + count
        progress(passed, steps)

    for number, extent in enumerate(pieces.extents):
        inside, strip = _halves(pieces.part(number), extent, _RIM * pieces.spacing)
        strips.append(strip)
        if len(inside.mesh.triangles):
            add(inside)
    strip = _joined_strips(strips)
    strips.clear()
    if len(strip.mesh.triangles):
        add(strip)
    joined = _whole(found, pieces.vertex_count)
    found.clear()
    whole: Simplified[Any] = simplify(joined, _of_whole(params, total))
    progress(steps, steps)
    if whole.stopped_by == "unproven":
        # What is left of the bounds is too little for it: the parts alone keep them.
        return InPieces(joined, tuple(figures), None)
    return InPieces(whole.mesh, tuple(figures), whole.figures())


def _of_parts(params: SimplifyParams, total: int) -> SimplifyParams:
    target = params.target(total)
    ratio = None if target is None else min(_SPARE * target / max(total, 1), 1.0)
    return replace(params, triangles=None, ratio=ratio, **_shares(params, _FOR_PARTS))


def _of_whole(params: SimplifyParams, total: int) -> SimplifyParams:
    return replace(params, triangles=params.target(total), ratio=None, **_shares(params, 1 - _FOR_PARTS))


def _shares(params: SimplifyParams, share: float) -> dict[str, Any]:
    bounds = {name: getattr(params, name) for name in _BOUNDS}
    return {name: share * bound for name, bound in bounds.items() if bound is not None}


def _with_neighbours(triangles: Triangles, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the chosen vertices and all that an edge joins to one."""
    near = chosen.copy()
    near[triangles[chosen[triangles].any(axis=1)]] = True
    return np.asarray(near)


@dataclass(frozen=True, eq=False)
class _Cut:
    """Some triangles as a mesh: numbers (n,) of its vertices in all, and which (n,) others name, too."""

    mesh: Mesh
    numbers: Numbers
    is_of_both: NDArray[np.bool_]


def _halves(part: Part, extent: Extent, rim: float) -> tuple[_Cut, _Cut]:
    """Cut a piece in its inside and the strip along its faces."""
    mesh = part.mesh
    low, high = np.array(extent.low) + rim, np.array(extent.high) - rim
    near = np.asarray(((mesh.vertices < low) | (mesh.vertices > high)).any(axis=1), np.bool_)
    is_strip = np.asarray(near[mesh.triangles].all(axis=1))
    of_strip, of_inside = np.zeros(len(near), np.bool_), np.zeros(len(near), np.bool_)
    of_strip[mesh.triangles[is_strip]] = True
    of_inside[mesh.triangles[~is_strip]] = True
    if of_inside[part.own :].any():
        raise StageError("pieces of the mesh meet farther inside than their voxels tell; fuse again.")
    both = of_strip & of_inside
    return _cut(part, of_inside, ~is_strip, both), _cut(part, of_strip, is_strip, both)


def _cut(part: Part, used: NDArray[np.bool_], chosen: NDArray[np.bool_], both: NDArray[np.bool_]) -> _Cut:
    mesh, index = part.mesh, np.cumsum(used) - 1
    colors = None if mesh.colors is None else mesh.colors[used]
    triangles = index[mesh.triangles[chosen]].astype(np.int32)
    return _Cut(Mesh(mesh.vertices[used], triangles, colors), part.numbers[used], both[used])


def _joined_strips(strips: Sequence[_Cut]) -> _Cut:
    """Make one mesh of the strips of all pieces."""
    if not strips:
        return _Cut(
            Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), np.zeros(0, np.int64), np.zeros(0, bool)
        )
    all_numbers = np.concatenate([strip.numbers for strip in strips])
    numbers, first, place = np.unique(all_numbers, return_index=True, return_inverse=True)
    both = np.zeros(len(numbers), bool)
    np.logical_or.at(both, place, np.concatenate([strip.is_of_both for strip in strips]))
    offsets = np.cumsum([0, *(len(strip.numbers) for strip in strips[:-1])])
    triangles = np.concatenate(
        [place[strip.mesh.triangles + start] for strip, start in zip(strips, offsets, strict=True)]
    )
    colors = [strip.mesh.colors for strip in strips if strip.mesh.colors is not None]
    mesh = Mesh(
        np.concatenate([strip.mesh.vertices for strip in strips])[first],
        triangles.astype(np.int32),
        np.concatenate(colors)[first] if colors else None,
    )
    return _Cut(mesh, numbers, both)


def _numbers(cut: _Cut, light: Simplified[Any]) -> Numbers:
    """Return the numbers in all of the vertices that stayed because others name them, −1 for all else."""
    source = light.vertex_source
    stayed = cut.is_of_both[source]
    if not np.array_equal(light.mesh.vertices[stayed], cut.mesh.vertices[source[stayed]]):
        raise StageError("a vertex that was to stay has moved, which is a defect of this program.")
    return np.where(stayed, cut.numbers[source], -1)


def _whole(found: Sequence[tuple[Mesh, Numbers]], count: int) -> Mesh:
    """Join meshes at the vertices that have a number in all, below `count`."""
    if not found:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    given = np.concatenate([numbers for _, numbers in found])
    # A vertex without one is its own.
    own = np.where(given < 0, count + np.arange(len(given)), given)
    _, first, place = np.unique(own, return_index=True, return_inverse=True)
    # In the order in which they come.
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    place, first = rank[place], first[order]
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh, _ in found[:-1])])
    triangles = [place[mesh.triangles + start] for (mesh, _), start in zip(found, offsets, strict=True)]
    colors = [mesh.colors for mesh, _ in found if mesh.colors is not None]
    return Mesh(
        np.concatenate([mesh.vertices for mesh, _ in found])[first],
        np.concatenate(triangles).astype(np.int32),
        np.concatenate(colors)[first] if colors else None,
        notes=tuple(dict.fromkeys(note for mesh, _ in found for note in mesh.notes)),
    )
