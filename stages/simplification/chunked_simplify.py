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

import math
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic, DiagnosticLocation, Severity
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.simplification.boundary_strips import BoundaryStrips
from scanloom.stages.simplification.codes import (
    SIMPLIFY_DEFAULT_COUNT,
    SIMPLIFY_DROP_BELOW_UNUSED,
)
from scanloom.stages.simplification.mesh_subsets import (
    Indices,
    MeshSubset,
    get_shared_indices,
    join_meshes,
    make_full_subset,
    split_chunk,
    split_subset,
)
from scanloom.stages.simplification.method_selection import select_method
from scanloom.stages.simplification.params import SimplifyParams
from scanloom.stages.simplification.requirements import report_unmet_requirements
from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.chunked_ply import MAX_IN_MEMORY_TRIANGLES, ChunkedPly
from scanloom.stages.surface.codes import FUSE_TOO_LARGE
from scanloom.stages.surface.mesh import Mesh

# Version of results for meshes too large to be simplified at once; included only in their cache keys.
RESULT_VERSION = 2

# In units of the voxel spacing: vertices farther inside a chunk are not used by other chunks' triangles, nor
# are their neighbours.
_RIM_SPACINGS = 4.0
# Ratio of the bounds for the parts; the joined mesh gets the remainder.
_PART_BOUND_RATIO = 0.6
# Factor on the triangle count for the parts, so that the joined mesh has edges to choose from.
_PART_COUNT_FACTOR = 1.5
# Triangles simplified at a time; each needs up to about 400 bytes.
MAX_TRIANGLES_AT_ONCE = 1_500_000
# Minimum count of a part, as a ratio of its proportional share, even if earlier parts exceeded theirs.
_MIN_SHARE_RATIO = 0.5
# Bounds, and metrics that add up over both rounds.
_BOUND_PARAMETERS = ("max_shape", "max_color")
_ADDITIVE_METRICS = (
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
class ChunkedSimplifyResult:
    """Result of `simplify_chunked`.

    Attributes
    ----------
    mesh : simplified mesh.
    parts : statistics of each interior and strip; see `SimplificationResult.statistics`.
    joined : statistics of the joined round, one entry per part if the mesh is large; empty if the remaining
        bounds are too small to simplify further.
    diagnostics : diagnostics of the joined round, and unmet requirements.
    """

    mesh: Mesh
    parts: tuple[Mapping[str, Any], ...]
    joined: tuple[Mapping[str, Any], ...]
    diagnostics: tuple[Diagnostic, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return statistics for JSON.

        Counts are summed over all parts. For bounds, the maxima of the two rounds are added.
        """
        rounds = (*self.parts, *self.joined)
        before, after = sum(part["triangles_before"] for part in self.parts), len(self.mesh.triangles)
        details = dict(rounds[-1]["details"])
        for name in _ADDITIVE_METRICS:
            if details.get(name) is not None:
                details[name] = sum(
                    max((one["details"][name] for one in some), default=0)
                    for some in (self.parts, self.joined)
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


def simplify_chunked(
    path: Path, params: SimplifyParams, *, scratch: Path | None = None, progress: Progress = ignore_progress
) -> ChunkedSimplifyResult:
    """Simplify a chunked PLY file.

    Memory usage is 1.5 times the result, plus the memory to simplify MAX_TRIANGLES_AT_ONCE triangles.

    Parameters
    ----------
    path : PLY file next to its chunk table, as written by fusion and cleaning.
    params : see SimplifyParams. A triangle count is distributed in proportion to the triangles of each part.
        Without a count or a bound, at most MAX_IN_MEMORY_TRIANGLES are left.
    scratch : folder for temporary files on a disk with enough space; the system's default if None.
    progress : called with (triangles done, all triangles).

    Raises
    ------
    InputError, MeshError, UsageError
        As `read_ply` and `simplify`.
    """
    with collecting() as diagnostics:
        found = _simplify_chunks(path, params, scratch, progress)
        report_unmet_requirements(params, found.to_dict())
    return replace(found, diagnostics=tuple(diagnostics))


def _simplify_chunks(
    path: Path, params: SimplifyParams, scratch: Path | None, progress: Progress
) -> ChunkedSimplifyResult:
    for name, is_given, remedy in (
        ("bake", params.bake, "leave it out, and enable the stage bake."),
        ("jia01.resolution", params.jia01.resolution is not None, "leave it out."),
    ):
        if is_given:
            raise UsageError(
                FUSE_TOO_LARGE,
                "is not supported for a mesh that is too large to be simplified at once",
                DiagnosticLocation(parameter=name),
                remedy=remedy,
            )
    pieces = ChunkedPly(path)
    total = pieces.triangle_count

    def iterate_interiors(strips: BoundaryStrips) -> Iterator[MeshSubset]:
        for number, extent in enumerate(pieces.extents):
            inside, strip = split_chunk(pieces.read_chunk(number), extent, _RIM_SPACINGS * pieces.spacing)
            strips.add(strip)
            yield inside

    # The joined round counts as a tenth of the work.
    steps = total + total // 10
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        strips = BoundaryStrips(Path(folder), pieces.extents, pieces.vertex_count)
        of_parts = chain(iterate_interiors(strips), strips.iterate_cells())
        found = _simplify_parts(
            of_parts, total, _make_part_params(params, total), lambda done: progress(done, steps)
        )
        del strips, of_parts
    mesh = join_meshes(found.meshes, pieces.vertex_count)
    parts, found = found.statistics, _RoundResult([], [])
    count, remaining_count = len(mesh.vertices), len(mesh.triangles)
    joined_subsets = iter([make_full_subset(mesh)])
    del mesh
    progress_scale = (steps - total) / max(remaining_count, 1)

    def report_joined(done: int) -> object:
        return progress(total + int(done * progress_scale), steps)

    goal = _make_joined_params(params, total)
    if params.drop_below is not None:
        emit(
            SIMPLIFY_DROP_BELOW_UNUSED.warning(
                "has no effect, because the mesh has {total:,} triangles and is simplified in parts",
                DiagnosticLocation(parameter="drop_below"),
                remedy="remove small components with clean.min_island_area.",
                total=total,
            )
        )
    if remaining_count > MAX_IN_MEMORY_TRIANGLES and goal.triangles is None and not _get_bounds(params):
        goal = replace(goal, triangles=MAX_IN_MEMORY_TRIANGLES)
        emit(
            SIMPLIFY_DEFAULT_COUNT.warning(
                "the default bounds would leave {left:,} triangles, more than later stages "
                "process at once; {most_at_once:,} are kept.",
                remedy="Give simplify.triangles, simplify.ratio or simplify.max_shape for another count.",
                left=remaining_count,
                most_at_once=MAX_IN_MEMORY_TRIANGLES,
            )
        )
    found = _simplify_parts(joined_subsets, remaining_count, goal, report_joined, is_last=True)
    progress(steps, steps)
    return ChunkedSimplifyResult(join_meshes(found.meshes, count), tuple(parts), tuple(found.statistics))


@dataclass(frozen=True, eq=False)
class _RoundResult:
    """Simplified meshes of one round with global vertex indices, and their statistics."""

    meshes: list[tuple[Mesh, Indices]]
    statistics: list[Mapping[str, Any]]


def _simplify_parts(
    subsets: Iterable[MeshSubset],
    total: int,
    params: SimplifyParams,
    progress: Callable[[int], object],
    *,
    is_last: bool = False,
) -> _RoundResult:
    """Simplify parts one by one, at most MAX_TRIANGLES_AT_ONCE triangles at a time.

    Parameters
    ----------
    subsets : parts to simplify.
    total : triangles of all parts.
    params : parameters of `simplify`.
    progress : called with the number of triangles done.
    is_last : True in the joined round. If a part keeps more triangles than its share, later parts get fewer,
        but at least half of their share. Parts whose remaining bound is too small to prove stay unchanged.
    """
    result, done_count = _RoundResult([], []), 0
    target = params.compute_target_count(total) if is_last else None
    left = target or 0
    for cut in (some for one in subsets for some in split_subset(one, MAX_TRIANGLES_AT_ONCE)):
        count = len(cut.mesh.triangles)
        if not count:
            continue
        share = params
        if target is not None:
            min_count = max(_MIN_SHARE_RATIO * target * count // total, 1)
            share = replace(params, triangles=int(max(left * count // (total - done_count), min_count)))
        part_result = _simplify_part(cut, share, done_count, progress)
        if is_last and part_result.stopped_by == "unproven":
            result.meshes.append((cut.mesh, np.where(cut.is_shared, cut.global_indices, -1)))
        else:
            result.meshes.append((part_result.mesh, get_shared_indices(cut, part_result)))
            result.statistics.append(part_result.to_dict())
            if is_last:
                # Warnings of earlier rounds mostly concern artificial borders. Requirements are checked for
                # the complete result.
                emit(*(one for one in part_result.diagnostics if one.severity != Severity.UNMET))
        done_count += count
        left = max(left - len(result.meshes[-1][0].triangles), 0)
        progress(done_count)
    return result


def _simplify_part(
    subset: MeshSubset, params: SimplifyParams, done_count: int, progress: Callable[[int], object]
) -> SimplificationResult[Any]:
    def report_part(done: int, total: int) -> object:
        return progress(done_count + len(subset.mesh.triangles) * done // max(total, 1))

    if subset.is_shared.any() and select_method(params).name == "jia01":
        # Vertices of split edges would be missing in the adjacent part.
        params = replace(params, jia01=replace(params.jia01, resolution=math.inf))
    with collecting(forward=False):
        return simplify(subset.mesh, params, lock=subset.find_locked_vertices(), progress=report_part)


def _make_part_params(params: SimplifyParams, total: int) -> SimplifyParams:
    target = params.compute_target_count(total)
    ratio = None if target is None else min(_PART_COUNT_FACTOR * target / max(total, 1), 1.0)
    return replace(
        params, triangles=None, ratio=ratio, drop_below=None, **_scale_bounds(params, _PART_BOUND_RATIO)
    )


def _make_joined_params(params: SimplifyParams, total: int) -> SimplifyParams:
    triangles = params.compute_target_count(total)
    return replace(
        params,
        triangles=triangles,
        ratio=None,
        drop_below=None,
        **_scale_bounds(params, 1 - _PART_BOUND_RATIO),
    )


def _scale_bounds(params: SimplifyParams, share: float) -> dict[str, Any]:
    return {name: share * bound for name, bound in _get_bounds(params).items()}


def _get_bounds(params: SimplifyParams) -> dict[str, float]:
    bounds = {name: getattr(params, name) for name in _BOUND_PARAMETERS}
    return {name: bound for name, bound in bounds.items() if bound is not None}
