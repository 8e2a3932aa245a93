"""Mapping between the number of collapses and the remaining vertices and triangles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.diagnostic import Diagnostic, DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check_parameters, param
from scanloom.stages.printing import format_by_fields, render_table
from scanloom.stages.simplification.codes import SIMPLIFY_RECORD_TOO_SHORT
from scanloom.stages.simplification.records.merge_forest import MergeForest
from scanloom.stages.surface.mesh import Mesh, Triangles
from scanloom.stages.surface.topology import has_repeated_vertex


@dataclass(frozen=True, kw_only=True)
class ReplayParams:
    """Parameters of `CollapseRecord.replay`.

    At most one of the three targets can be given; the default is the end of the record.
    """

    triangles: int | None = param(
        None, "Replay until at most this many triangles are left.", low=1, common=True
    )
    ratio: float | None = param(
        None,
        "Replay until at most this fraction of the input's triangles is left.",
        low=0,
        high=1,
        low_open=True,
        common=True,
    )
    collapses: int | None = param(None, "Replay this many collapses.", low=0)
    fit: bool = param(
        False, "Fit vertices and colours to the input by least squares at the end, as simplify does."
    )

    def __post_init__(self) -> None:
        check_parameters(self)
        given = [name for name in ("triangles", "ratio", "collapses") if getattr(self, name) is not None]
        if len(given) > 1:
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "{given} are given",
                remedy="give one of them.",
                given=" and ".join(given),
            )


@dataclass(frozen=True, eq=False)
class ReplayedMesh:
    """Intermediate mesh of a simplification.

    Attributes
    ----------
    mesh : Mesh
    vertex_source : (p,) int32, an input vertex merged into each vertex.
    triangle_source : (q,) int32, input triangle that each triangle derives from.
    collapses : number of replayed collapses.
    diagnostics : warnings about lost attributes.
    """

    __repr__ = format_by_fields
    _repr_html_ = render_table

    mesh: Mesh
    vertex_source: NDArray[np.int32]
    triangle_source: NDArray[np.int32]
    collapses: int
    diagnostics: tuple[Diagnostic, ...] = ()


@dataclass(frozen=True, eq=False)
class ReplayState:
    """Vertices and triangles that remain after some collapses.

    Attributes
    ----------
    collapses : number of collapses.
    vertices : (p,) int64, remaining vertices.
    triangle_indices : (q,) int64, remaining triangles.
    triangles : (q, 3) int32, their corners, as indices into `vertex_count`.
    merged_into : (n,) int32, index into `vertex_count` of the vertex that each vertex was merged into; −1 for
        none.
    """

    collapses: int
    vertices: NDArray[np.int64]
    triangle_indices: NDArray[np.int64]
    triangles: Triangles
    merged_into: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class CollapseSteps:
    """Triangles, and the collapses that remove them.

    Attributes
    ----------
    triangles : (t, 3) int32, triangles of the input.
    vertex_count : number of vertices.
    removed, survivor : (m,) int32, removed vertex of each collapse, and the vertex it was merged into.
    """

    triangles: Triangles
    vertex_count: int
    removed: NDArray[np.int32]
    survivor: NDArray[np.int32]

    @cached_property
    def removal_steps(self) -> NDArray[np.int64]:
        """Collapse that removes each triangle (t,); `len(removed)` for triangles that stay.

        Input triangles that use a vertex twice get −1: they are gone before the first collapse.
        """
        meetings = MergeForest(self.vertex_count, self.removed, self.survivor)
        ends = np.full(len(self.triangles), len(self.removed))
        for side in range(3):
            a, b = self.triangles[:, side], self.triangles[:, (side + 1) % 3]
            np.minimum(ends, meetings.find_merges(a, b), out=ends)
        ends[has_repeated_vertex(self.triangles)] = -1
        return ends

    @cached_property
    def _sorted_removal_steps(self) -> NDArray[np.int64]:
        return np.sort(self.removal_steps)

    def count_triangles_after(self, collapses: int) -> int:
        """Return the number of triangles after a number of collapses."""
        return len(self.removal_steps) - int(np.searchsorted(self._sorted_removal_steps, collapses))

    def compute_collapse_count(self, params: ReplayParams) -> int:
        """Compute the number of collapses that reaches the requested target.

        Raises
        ------
        UsageError
            For fewer triangles or more collapses than the record contains.
        """
        max_collapses = len(self.removed)
        if params.collapses is not None:
            if params.collapses > max_collapses:
                raise UsageError(
                    SIMPLIFY_RECORD_TOO_SHORT,
                    "is {collapses}, but the record holds only {most}.",
                    DiagnosticLocation(parameter="collapses"),
                    collapses=params.collapses,
                    most=max_collapses,
                )
            return params.collapses
        target_count = params.triangles
        if params.ratio is not None:
            target_count = math.floor(params.ratio * len(self.triangles))
        if target_count is None:
            return max_collapses
        min_triangles = self.count_triangles_after(max_collapses)
        if target_count < min_triangles:
            name = "triangles" if params.ratio is None else "ratio"
            raise UsageError(
                SIMPLIFY_RECORD_TOO_SHORT,
                "{name} asks for {wanted} triangles, but the record ends at {least}.",
                name=name,
                wanted=target_count,
                least=min_triangles,
            )
        # The last of the triangles to remove determines the number of collapses.
        removal_count = len(self.removal_steps) - target_count
        return 0 if removal_count <= 0 else max(int(self._sorted_removal_steps[removal_count - 1]) + 1, 0)

    def compute_state(self, collapses: int) -> ReplayState:
        """Determine the vertices and triangles that remain after a number of collapses."""
        root = find_roots(self.vertex_count, self.removed[:collapses], self.survivor[:collapses])
        rows = np.flatnonzero(self.removal_steps >= collapses)
        corners = root[self.triangles[rows]]
        used = np.zeros(self.vertex_count, bool)
        used[corners] = True
        vertices = np.flatnonzero(used)
        new_index = np.full(self.vertex_count, -1, np.int32)
        new_index[vertices] = np.arange(len(vertices))
        return ReplayState(collapses, vertices, rows, new_index[corners], new_index[root])


def find_roots(count: int, removed: NDArray[np.int32], survivor: NDArray[np.int32]) -> NDArray[np.int64]:
    """Map each of `count` elements to its representative after all merges.

    Parameters
    ----------
    removed, survivor : (m,), element removed by each merge, and the element it is merged into, in order.
    """
    root = np.arange(count)
    root[removed] = survivor
    while (root[root] != root).any():
        root = root[root]
    return root
