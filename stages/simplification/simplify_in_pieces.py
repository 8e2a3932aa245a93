"""Simplify a mesh in pieces: their insides, the strips along the faces where they meet, and then the whole.

While a part is simplified, the vertices that other parts name stay as they are, and so do those next to them,
so that parts always fit: nothing cracks, and no edge comes to have more than two triangles. The insides come
one after the other, then the strips along all faces, a few voxels wide. What they leave is simplified once
more, which makes the surface as light where parts were joined as elsewhere. Whatever of this is still large
is halved until its parts are not: those of a round meet elsewhere than those before, so that what stays of
their borders is light. Both rounds share out the bounds, which add up: what is proven for each is proven for
both together, since the distance of surfaces obeys the triangle inequality.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic, Severity, Where
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.progress import Progress, silent
from scanloom.stages.simplification.codes import (
    SIMPLIFY_DEFAULT_COUNT,
    SIMPLIFY_DROP_BELOW_UNUSED,
)
from scanloom.stages.simplification.cuts import (
    Cut,
    Numbers,
    halves,
    joined,
    numbers_of,
    split,
    whole_cut,
)
from scanloom.stages.simplification.params import SimplifyParams
from scanloom.stages.simplification.result import Simplified
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.simplification.strips import Strips
from scanloom.stages.simplification.unmet import report_unmet
from scanloom.stages.surface.codes import FUSE_TOO_LARGE
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.pieces import MOST_AT_ONCE, Pieces

# Of meshes that are too large to be simplified at once: part of their key alone.
RESULT_VERSION = 1

# Times the spacing: a vertex farther inside than this is named by no other piece's triangles, nor are those
# it is joined to.
_RIM = 4.0
# Of bounds, the share that is for the parts; the rest is for the whole.
_FOR_PARTS = 0.6
# Of a number of triangles, how many times as many parts keep for the whole to choose from.
_SPARE = 1.5
# Triangles that are simplified at a time, which takes up to about 400 bytes for each.
AT_ONCE = 1_500_000
# Of its share of a number of triangles, what a part is asked for at least, however much others have kept.
_LEAST_SHARE = 0.5
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
    whole : of the round over all of it, by parts again where it is large; none where what is left of the
        bounds is too little for one.
    diagnostics : of the round over all of it, and requirements that are not reached.
    """

    mesh: Mesh
    parts: tuple[Mapping[str, Any], ...]
    whole: tuple[Mapping[str, Any], ...]
    diagnostics: tuple[Diagnostic, ...] = ()

    def figures(self) -> dict[str, Any]:
        """Return sums of counts; of bounds the worst of the parts' and the whole's together."""
        rounds = (*self.parts, *self.whole)
        before, after = sum(part["triangles_before"] for part in self.parts), len(self.mesh.triangles)
        details = dict(rounds[-1]["details"])
        for name in _ADD_UP:
            if details.get(name) is not None:
                details[name] = sum(
                    max((one["details"][name] for one in some), default=0)
                    for some in (self.parts, self.whole)
                )
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
        }


def simplify_in_pieces(
    path: Path, params: SimplifyParams, *, scratch: Path | None = None, progress: Progress = silent
) -> InPieces:
    """Make a PLY file in pieces light.

    Memory holds 1.5 times the result, and what AT_ONCE triangles take to be simplified.

    Parameters
    ----------
    path : of the file, with its table of pieces beside it: what fusion and cleaning left.
    params : see SimplifyParams. A number of triangles is shared out by the triangles each part has. Without a
        number or a bound no more than MOST_AT_ONCE are left.
    scratch : folder for a while, on a disk with room for a share of the mesh; the system's by default.
    progress : called with the triangles that are done and all.

    Raises
    ------
    InputError, MeshError, UsageError
        As `read_ply` and `simplify`.
    """
    with collecting() as diagnostics:
        found = _in_pieces(path, params, scratch, progress)
        report_unmet(params, found.figures())
    return replace(found, diagnostics=tuple(diagnostics))


def _in_pieces(path: Path, params: SimplifyParams, scratch: Path | None, progress: Progress) -> InPieces:
    if params.bake:
        raise UsageError(
            FUSE_TOO_LARGE,
            "is for meshes that are simplified in one piece",
            Where(parameter="bake"),
            remedy="leave it out, and enable the stage bake.",
        )
    pieces = Pieces(path)
    total = pieces.triangle_count

    def insides(strips: Strips) -> Iterator[Cut]:
        for number, extent in enumerate(pieces.extents):
            inside, strip = halves(pieces.part(number), extent, _RIM * pieces.spacing)
            strips.add(strip)
            yield inside

    # The whole counts as much as a tenth.
    steps = total + total // 10
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        strips = Strips(Path(folder), pieces.extents, pieces.vertex_count)
        of_parts = chain(insides(strips), strips.cells())
        found = _simplified(of_parts, total, _of_parts(params, total), lambda done: progress(done, steps))
        del strips, of_parts
    mesh = joined(found.meshes, pieces.vertex_count)
    parts, found = found.figures, _Round([], [])
    count, left = len(mesh.vertices), len(mesh.triangles)
    again = iter([whole_cut(mesh)])
    del mesh
    rest = (steps - total) / max(left, 1)

    def told(done: int) -> object:
        return progress(total + int(done * rest), steps)

    goal = _of_whole(params, total)
    if params.drop_below is not None:
        emit(
            SIMPLIFY_DROP_BELOW_UNUSED.warning(
                "has no effect on this mesh: it has {total:,} triangles, which are simplified in parts",
                Where(parameter="drop_below"),
                remedy="remove small components with clean.min_island_area.",
                total=total,
            )
        )
    if left > MOST_AT_ONCE and goal.triangles is None and not _asked_bounds(params):
        goal = replace(goal, triangles=MOST_AT_ONCE)
        emit(
            SIMPLIFY_DEFAULT_COUNT.warning(
                "within the default bounds {left:,} triangles would be left, more than what follows takes at "
                "once; {most_at_once:,} are.",
                remedy="Give simplify.triangles, ratio or max_shape for another number.",
                left=left,
                most_at_once=MOST_AT_ONCE,
            )
        )
    found = _simplified(again, left, goal, told, is_last=True)
    progress(steps, steps)
    return InPieces(joined(found.meshes, count), tuple(parts), tuple(found.figures))


@dataclass(frozen=True, eq=False)
class _Round:
    """Meshes of a round with the numbers of their vertices in all, and figures of those made light."""

    meshes: list[tuple[Mesh, Numbers]]
    figures: list[Mapping[str, Any]]


def _simplified(
    cuts: Iterable[Cut],
    total: int,
    params: SimplifyParams,
    progress: Callable[[int], object],
    *,
    is_last: bool = False,
) -> _Round:
    """Make parts light, few triangles at a time.

    Parameters
    ----------
    total : triangles of all of them.
    progress : called with the triangles that are done.
    is_last : what one part cannot do without, its border perhaps, those after it do, as far as that leaves
        them half of their share, so that a number of triangles is kept to; and what a bound is too little for
        stays as it is.
    """
    made, passed = _Round([], []), 0
    target = params.target(total) if is_last else None
    left = target or 0
    for cut in (some for one in cuts for some in split(one, AT_ONCE)):
        count = len(cut.mesh.triangles)
        if not count:
            continue
        share = params
        if target is not None:
            least = max(_LEAST_SHARE * target * count // total, 1)
            share = replace(params, triangles=int(max(left * count // (total - passed), least)))
        light = _light(cut, share, passed, progress)
        if is_last and light.stopped_by == "unproven":
            made.meshes.append((cut.mesh, np.where(cut.is_of_both, cut.numbers, -1)))
        else:
            made.meshes.append((light.mesh, numbers_of(cut, light)))
            made.figures.append(light.figures())
            if is_last:
                # Those of parts are mostly about where they were cut. Requirements are about all of it.
                emit(*(one for one in light.diagnostics if one.severity != Severity.UNMET))
        passed += count
        left = max(left - len(made.meshes[-1][0].triangles), 0)
        progress(passed)
    return made


def _light(
    cut: Cut, params: SimplifyParams, passed: int, progress: Callable[[int], object]
) -> Simplified[Any]:
    def told(done: int, total: int) -> object:
        return progress(passed + len(cut.mesh.triangles) * done // max(total, 1))

    with collecting(forward=False):
        return simplify(cut.mesh, params, lock=cut.lock(), progress=told)


def _of_parts(params: SimplifyParams, total: int) -> SimplifyParams:
    target = params.target(total)
    ratio = None if target is None else min(_SPARE * target / max(total, 1), 1.0)
    return replace(params, triangles=None, ratio=ratio, drop_below=None, **_shares(params, _FOR_PARTS))


def _of_whole(params: SimplifyParams, total: int) -> SimplifyParams:
    triangles = params.target(total)
    return replace(
        params, triangles=triangles, ratio=None, drop_below=None, **_shares(params, 1 - _FOR_PARTS)
    )


def _shares(params: SimplifyParams, share: float) -> dict[str, Any]:
    return {name: share * bound for name, bound in _asked_bounds(params).items()}


def _asked_bounds(params: SimplifyParams) -> dict[str, float]:
    bounds = {name: getattr(params, name) for name in _BOUNDS}
    return {name: bound for name, bound in bounds.items() if bound is not None}
