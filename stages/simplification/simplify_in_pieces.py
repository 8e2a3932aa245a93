"""Out-of-core simplification of chunked meshes.

The order is: chunk interiors, strips between chunks, then the joined mesh.

While a part is simplified, the vertices that it shares with other parts are locked, with their neighbours. So
the parts always fit together without cracks or non-manifold edges. The interiors of all chunks come first,
one by one, then the strips along chunk faces, which are a few voxels wide. The joined result is simplified
once more, so that former part borders become as coarse as the remaining surface. Anything that is still too
large is halved; the halves meet at other positions than in the previous round. Both rounds share the bounds.
By the triangle inequality, the bounds proven for each round add up to the bound of the result.
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

# Version of results for meshes too large to be simplified at once; included only in their cache keys.
RESULT_VERSION = 1

# In units of the voxel spacing: vertices farther inside a chunk are not used by other chunks' triangles, nor
# are their neighbours.
_RIM = 4.0
# Ratio of the bounds for the parts; the joined mesh gets the remainder.
_FOR_PARTS = 0.6
# Factor on the triangle count for the parts, so that the joined mesh has edges to choose from.
_SPARE = 1.5
# Triangles simplified at a time; each needs up to about 400 bytes.
AT_ONCE = 1_500_000
# Minimum count of a part, as a ratio of its proportional share, even if earlier parts exceeded theirs.
_LEAST_SHARE = 0.5
# Bounds, and metrics that add up over both rounds.
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
    """Result of `simplify_in_pieces`.

    Attributes
    ----------
    mesh : simplified mesh.
    parts : statistics of each interior and strip; see `Simplified.figures`.
    whole : statistics of the joined round, one entry per part if the mesh is large; empty if the remaining
        bounds are too small to simplify further.
    diagnostics : diagnostics of the joined round, and unmet requirements.
    """

    mesh: Mesh
    parts: tuple[Mapping[str, Any], ...]
    whole: tuple[Mapping[str, Any], ...]
    diagnostics: tuple[Diagnostic, ...] = ()

    def figures(self) -> dict[str, Any]:
        """Return statistics for JSON.

        Counts are summed over all parts. For bounds, the maxima of the two rounds are added.
        """
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
    """Simplify a chunked PLY file.

    Memory usage is 1.5 times the result, plus the memory to simplify AT_ONCE triangles.

    Parameters
    ----------
    path : PLY file next to its chunk table, as written by fusion and cleaning.
    params : see SimplifyParams. A triangle count is distributed in proportion to the triangles of each part.
        Without a count or a bound, at most MOST_AT_ONCE triangles are left.
    scratch : folder for temporary files on a disk with enough space; the system's default if None.
    progress : called with (triangles done, all triangles).

    Returns
    -------
    InPieces

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
            "is not supported for a mesh that is too large to be simplified at once",
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

    # The joined round counts as a tenth of the work.
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
                "has no effect, because the mesh has {total:,} triangles and is simplified in parts",
                Where(parameter="drop_below"),
                remedy="remove small components with clean.min_island_area.",
                total=total,
            )
        )
    if left > MOST_AT_ONCE and goal.triangles is None and not _asked_bounds(params):
        goal = replace(goal, triangles=MOST_AT_ONCE)
        emit(
            SIMPLIFY_DEFAULT_COUNT.warning(
                "the default bounds would leave {left:,} triangles, more than later stages "
                "process at once; {most_at_once:,} are kept.",
                remedy="Give simplify.triangles, simplify.ratio or simplify.max_shape for another count.",
                left=left,
                most_at_once=MOST_AT_ONCE,
            )
        )
    found = _simplified(again, left, goal, told, is_last=True)
    progress(steps, steps)
    return InPieces(joined(found.meshes, count), tuple(parts), tuple(found.figures))


@dataclass(frozen=True, eq=False)
class _Round:
    """Simplified meshes of one round with global vertex indices, and their statistics."""

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
    """Simplify parts one by one, at most AT_ONCE triangles at a time.

    Parameters
    ----------
    cuts : parts to simplify.
    total : triangles of all parts.
    params : parameters of `simplify`.
    progress : called with the number of triangles done.
    is_last : True in the joined round. If a part keeps more triangles than its share, later parts get fewer,
        but at least half of their share. Parts whose remaining bound is too small to prove stay unchanged.
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
                # Warnings of earlier rounds mostly concern artificial borders. Requirements are checked for
                # the complete result.
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
