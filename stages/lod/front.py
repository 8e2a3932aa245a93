"""Active front of a hierarchy: displayed nodes and their vertex splits."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.surface.mesh import Mesh

if TYPE_CHECKING:
    from scanloom.stages.lod.levels import Levels
    from scanloom.stages.lod.view import View

Floats = NDArray[np.float64]


class Region(Protocol):
    """Region of space, such as `scanloom.Sphere` and `scanloom.Box`."""

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """Return a mask of the points (n, 3) that are inside."""


@dataclass(frozen=True, eq=False)
class Cut:
    """Mesh extracted from a hierarchy, with its proven bounds.

    Attributes
    ----------
    mesh : triangles, ordered by node.
    node : (m,) int32, node of each triangle.
    nodes, splits : (k,) int64, nodes of the front, and number of split vertices of each.
    shape_bound, color_bound : (k,) float64, metres and levels: two-sided bound of each node's mesh against
        its part of the input. Between two levels it is the bound of the coarser level, which is expected but
        not proven.
    is_proven : (k,) bool, the node is exactly on a level, so its bound is proven.
    is_one_sided : small components were dropped, and the bounds do not cover them.
    """

    mesh: Mesh
    node: NDArray[np.int32]
    nodes: NDArray[np.int64]
    splits: NDArray[np.int64]
    shape_bound: Floats
    color_bound: Floats
    is_proven: NDArray[np.bool_]
    is_one_sided: bool = False

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    @property
    def shape_bound_m(self) -> float:
        """Maximum bound on the distance, metres."""
        return float(self.shape_bound.max(initial=0.0))

    @property
    def color_bound_levels(self) -> float | None:
        """Maximum bound on the colour difference, levels; None without colours."""
        return None if self.mesh.colors is None else float(self.color_bound.max(initial=0.0))

    def to_dict(self) -> dict[str, Any]:
        """Return size and bounds for JSON, with units in the keys."""
        return {
            "triangles": len(self.mesh.triangles),
            "vertices": len(self.mesh.vertices),
            "nodes": len(self.nodes),
            "shape_bound_m": self.shape_bound_m,
            "color_bound_levels": self.color_bound_levels,
            "proven": bool(self.is_proven.all()),
            "one_sided": self.is_one_sided,
            "nodes_between_levels": int((~self.is_proven).sum()),
        }


class Front:
    """Set of displayed nodes, each with some of its vertex splits done.

    A front always covers the whole surface. Methods that change it return the front itself and leave the
    hierarchy unchanged.
    """

    def __init__(self, hierarchy: Levels) -> None:
        self.hierarchy = hierarchy
        self._splits: dict[int, int] = {0: 0} if hierarchy.nodes else {}

    @property
    def nodes(self) -> tuple[int, ...]:
        """Nodes of the front, ascending."""
        return tuple(sorted(self._splits))

    @property
    def splits(self) -> tuple[int, ...]:
        """Number of split vertices of each node, in the order of `nodes`."""
        return tuple(self._splits[n] for n in self.nodes)

    @property
    def state(self) -> dict[int, int]:
        """Number of splits by node, for `restore`."""
        return dict(self._splits)

    def restore(self, state: dict[int, int]) -> Front:
        """Restore an earlier `state` of the same hierarchy."""
        self._splits = dict(state)
        return self

    @property
    def triangles(self) -> int:
        """Number of triangles of the front."""
        return sum(self._count_triangles(n, s) for n, s in self._splits.items())

    def _count_triangles(self, node: int, splits: int) -> int:
        h = self.hierarchy
        first = h.first_split[node]
        return int(h.coarse[node] + h.born_before[first + splits] - h.born_before[first])

    def split(self, node: int, count: int = 1) -> Front:
        """Split up to `count` vertices of a node of the front.

        If all vertices are already split, the node is replaced by its children.

        Parameters
        ----------
        node : index of a node of the front.
        count : maximum number of splits, at least 1.

        Raises
        ------
        UsageError
            If the node is not in the front, or count is below 1.
        """
        self._require(node, count)
        total = int(self.hierarchy.splits[node])
        if self._splits[node] < total:
            self._splits[node] = min(self._splits[node] + count, total)
        elif len(self.hierarchy.children[node]):
            del self._splits[node]
            self._splits.update((int(child), 0) for child in self.hierarchy.children[node])
        return self

    def merge(self, node: int, count: int = 1) -> Front:
        """Undo up to `count` splits of a node of the front.

        If the node has no splits, its parent replaces all its descendants in the front, whatever their
        splits.

        Parameters
        ----------
        node : index of a node of the front.
        count : maximum number of undone splits, at least 1.

        Raises
        ------
        UsageError
            If the node is not in the front, or count is below 1.
        """
        self._require(node, count)
        if self._splits[node]:
            self._splits[node] = max(self._splits[node] - count, 0)
        elif node:
            parent = int(self.hierarchy.parent[node])
            for n in [n for n in self._splits if self._is_below(n, parent)]:
                del self._splits[n]
            self._splits[parent] = int(self.hierarchy.splits[parent])
        return self

    def _require(self, node: int, count: int) -> None:
        if node not in self._splits:
            raise UsageError(USAGE_ARGUMENT_INVALID, "node {node} is not in the front.", node=node)
        if count < 1:
            raise UsageError(USAGE_ARGUMENT_INVALID, "count must be 1 or more.")

    def _is_below(self, node: int, ancestor: int) -> bool:
        while node > ancestor:
            node = int(self.hierarchy.parent[node])
        return node == ancestor

    def refine(
        self,
        view: View | None = None,
        *,
        triangles: int | None = None,
        error_px: float | None = None,
        max_shape: float | None = None,
        region: Region | None = None,
        keep: float = 1.0,
    ) -> Front:
        """Refine to a view, a number of triangles or an error.

        Nodes outside the view or the region stay as coarse as possible.

        Parameters
        ----------
        view : view in whose pixels errors are measured; without a view, errors are in metres everywhere.
        triangles : maximum number of triangles, spent where the proven error is largest. The last node may
            end between two levels.
        error_px : maximum proven error of visible nodes, pixels; requires a view.
        max_shape : maximum proven error, metres.
        region : object with `contains(points)`, such as Sphere and Box. Only nodes with a vertex inside are
            refined, and completely if there is no other limit.
        keep : hysteresis factor, at least 1. Nodes that are already refined stay refined until their error is
            below the requested error divided by this factor. With 2, small camera movements change nothing.

        Raises
        ------
        UsageError
            If no target is given, `error_px` has no view, or a value is out of range.
        """
        if error_px is not None and view is None:
            raise UsageError(
                USAGE_ARGUMENT_INVALID,
                "error_px is measured in pixels of a view, and no view is given",
                remedy="pass a view, or use max_shape in metres.",
            )
        if triangles is None and error_px is None and max_shape is None and region is None:
            raise UsageError(
                USAGE_ARGUMENT_INVALID,
                "no target for the refinement is given: triangles, error_px, max_shape or region.",
            )
        limits = (("triangles", triangles, 1), ("error_px", error_px, 0), ("max_shape", max_shape, 0))
        for name, value, minimum in limits:
            if value is not None and not value >= minimum:
                raise UsageError(
                    USAGE_ARGUMENT_INVALID, "{name} must be {least} or more.", name=name, least=minimum
                )
        if not keep >= 1:
            raise UsageError(USAGE_ARGUMENT_INVALID, "keep must be 1 or more.")
        priorities = self._compute_priorities(view, error_px, max_shape, region)
        refined_before = self._collect_ancestors() if keep > 1 else set()
        self._splits = {0: 0} if self.hierarchy.nodes else {}
        self._refine_by_priority(priorities, triangles, refined_before, keep)
        return self

    def _compute_priorities(
        self, view: View | None, error_px: float | None, max_shape: float | None, region: Region | None
    ) -> Floats:
        """Compute the refinement priority (n,) of each node.

        The priority is the error relative to the requested error; nodes above 1 are refined.
        """
        h = self.hierarchy
        priorities = np.zeros(h.nodes)
        is_visible, length = np.ones(h.nodes, bool), h.shape_bound
        if view is not None:
            is_visible = view.intersects(*h.spheres)
            length = np.where(is_visible, view.project_lengths(h.shape_bound, *h.spheres), 0.0)
        if max_shape is not None:
            priorities = np.where(is_visible, _divide_errors(h.shape_bound, max_shape), priorities)
        if error_px is not None:
            priorities = np.maximum(priorities, _divide_errors(length, error_px))
        if error_px is None and max_shape is None:
            # Without a requested error only the order of priorities matters.
            priorities = np.where(length > 0, 1 + length / max(float(length.max(initial=0.0)), 1e-300), 0.0)
        if region is not None:
            is_inside = h.node_vertices.contains_any(region.contains(h.vertices))
            priorities = np.where(is_inside, priorities, 0.0)
        return np.asarray(priorities)

    def _collect_ancestors(self) -> set[int]:
        ancestors: set[int] = set()
        for node in self._splits:
            n = int(self.hierarchy.parent[node])
            while n >= 0 and n not in ancestors:
                ancestors.add(n)
                n = int(self.hierarchy.parent[n])
        return ancestors

    def _refine_by_priority(
        self, priorities: Floats, triangles: int | None, refined_before: set[int], keep: float
    ) -> None:
        """Refine nodes in the order of priority while the number of triangles allows."""
        h = self.hierarchy
        if not h.nodes:
            return
        triangle_count = self.triangles
        heap = [(-float(priorities[0]), 0)]
        while heap:
            negative_priority, node = heapq.heappop(heap)
            threshold = 1 / keep if node in refined_before else 1.0
            if -negative_priority <= threshold:
                continue
            added_triangles = int(h.full[node] - h.coarse[node])
            if triangles is not None and triangle_count + added_triangles > triangles:
                self._splits[node] = h.count_affordable_splits(node, triangles - triangle_count)
                return
            triangle_count += added_triangles
            children = h.children[node]
            if not len(children):
                self._splits[node] = int(h.splits[node])
                continue
            del self._splits[node]
            for child in children:
                self._splits[int(child)] = 0
                heapq.heappush(heap, (-float(priorities[child]), int(child)))

    def rebuild(self, triangles: int) -> Front:
        """Refine to at most `triangles`, with the smallest possible error."""
        return self.refine(triangles=triangles)

    def cut(self) -> Cut:
        """Extract the current mesh with its bounds."""
        h = self.hierarchy
        nodes = np.array(self.nodes, np.int64)
        splits = np.array(self.splits, np.int64)
        mesh, node = h.mesh_and_nodes(nodes, splits)
        is_full = splits == h.splits[nodes]
        return Cut(
            mesh=mesh,
            node=node,
            nodes=nodes,
            splits=splits,
            shape_bound=np.where(is_full, h.full_shape_bound[nodes], h.shape_bound[nodes]),
            color_bound=np.where(is_full, h.full_color_bound[nodes], h.color_bound[nodes]),
            is_proven=is_full | (splits == 0),
            is_one_sided=h.is_one_sided,
        )


def _divide_errors(error: Floats, requested: float) -> Floats:
    return np.asarray(np.divide(error, requested, out=np.where(error > 0, np.inf, 0.0), where=requested > 0))
