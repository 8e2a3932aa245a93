"""Active front of a hierarchy: displayed nodes and their vertex splits."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.printing import by_figures, table
from scanloom.stages.surface.mesh import Mesh

if TYPE_CHECKING:
    from scanloom.stages.lod.levels import Levels
    from scanloom.stages.lod.view import View

Floats = NDArray[np.float64]


class Region(Protocol):
    """Region of space, such as `scanloom.Sphere` and `scanloom.Box`."""

    def holds(self, points: Floats) -> NDArray[np.bool_]:
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

    __repr__ = by_figures
    _repr_html_ = table

    @property
    def shape_bound_m(self) -> float:
        """Maximum bound on the distance, metres."""
        return float(self.shape_bound.max(initial=0.0))

    @property
    def color_bound_levels(self) -> float | None:
        """Maximum bound on the colour difference, levels; None without colours."""
        return None if self.mesh.colors is None else float(self.color_bound.max(initial=0.0))

    def figures(self) -> dict[str, Any]:
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
        return sum(self._triangles(n, s) for n, s in self._splits.items())

    def _triangles(self, node: int, splits: int) -> int:
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
        all_of_it = int(self.hierarchy.splits[node])
        if self._splits[node] < all_of_it:
            self._splits[node] = min(self._splits[node] + count, all_of_it)
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
            above = int(self.hierarchy.parent[node])
            for n in [n for n in self._splits if self._is_below(n, above)]:
                del self._splits[n]
            self._splits[above] = int(self.hierarchy.splits[above])
        return self

    def _require(self, node: int, count: int) -> None:
        if node not in self._splits:
            raise UsageError(USAGE_ARGUMENT_INVALID, "node {node} is not in the front.", node=node)
        if count < 1:
            raise UsageError(USAGE_ARGUMENT_INVALID, "count must be 1 or more.")

    def _is_below(self, node: int, above: int) -> bool:
        while node > above:
            node = int(self.hierarchy.parent[node])
        return node == above

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
        region : object with `holds(points)`, such as Sphere and Box. Only nodes with a vertex inside are
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
        asked = (("triangles", triangles, 1), ("error_px", error_px, 0), ("max_shape", max_shape, 0))
        for name, value, least in asked:
            if value is not None and not value >= least:
                raise UsageError(
                    USAGE_ARGUMENT_INVALID, "{name} must be {least} or more.", name=name, least=least
                )
        if not keep >= 1:
            raise UsageError(USAGE_ARGUMENT_INVALID, "keep must be 1 or more.")
        wanted = self._wanted(view, error_px, max_shape, region)
        open_before = self._above_front() if keep > 1 else set()
        self._splits = {0: 0} if self.hierarchy.nodes else {}
        self._descend(wanted, triangles, open_before, keep)
        return self

    def _wanted(
        self, view: View | None, error_px: float | None, max_shape: float | None, region: Region | None
    ) -> Floats:
        """Compute the refinement priority (n,) of each node.

        The priority is the error relative to the requested error; nodes above 1 are refined.
        """
        h = self.hierarchy
        urgency = np.zeros(h.nodes)
        seen, length = np.ones(h.nodes, bool), h.shape_bound
        if view is not None:
            seen = view.sees(*h.spheres)
            length = np.where(seen, view.pixels(h.shape_bound, *h.spheres), 0.0)
        if max_shape is not None:
            urgency = np.where(seen, _over(h.shape_bound, max_shape), urgency)
        if error_px is not None:
            urgency = np.maximum(urgency, _over(length, error_px))
        if error_px is None and max_shape is None:
            # Without a requested error only the order of priorities matters.
            urgency = np.where(length > 0, 1 + length / max(float(length.max(initial=0.0)), 1e-300), 0.0)
        if region is not None:
            urgency = np.where(self._in_region(region), urgency, 0.0)
        return np.asarray(urgency)

    def _in_region(self, region: Region) -> NDArray[np.bool_]:
        """Return a mask (n,) of nodes with a vertex in a region, on any level."""
        h = self.hierarchy
        inside = region.holds(h.vertices)
        found = np.array([bool(inside[h.vertices_of(n)].any()) for n in range(h.nodes)], bool)
        for node in range(h.nodes - 1, 0, -1):
            found[h.parent[node]] |= found[node]
        return found

    def _above_front(self) -> set[int]:
        above: set[int] = set()
        for node in self._splits:
            n = int(self.hierarchy.parent[node])
            while n >= 0 and n not in above:
                above.add(n)
                n = int(self.hierarchy.parent[n])
        return above

    def _descend(self, urgency: Floats, triangles: int | None, open_before: set[int], keep: float) -> None:
        """Refine nodes in the order of priority while the number of triangles allows."""
        h = self.hierarchy
        if not h.nodes:
            return
        there = self.triangles
        heap = [(-float(urgency[0]), 0)]
        while heap:
            minus, node = heapq.heappop(heap)
            least = 1 / keep if node in open_before else 1.0
            if -minus <= least:
                continue
            more = int(h.full[node] - h.coarse[node])
            if triangles is not None and there + more > triangles:
                self._splits[node] = h.splits_for(node, triangles - there)
                return
            there += more
            children = h.children[node]
            if not len(children):
                self._splits[node] = int(h.splits[node])
                continue
            del self._splits[node]
            for child in children:
                self._splits[int(child)] = 0
                heapq.heappush(heap, (-float(urgency[child]), int(child)))

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


def _over(error: Floats, wanted: float) -> Floats:
    return np.asarray(np.divide(error, wanted, out=np.where(error > 0, np.inf, 0.0), where=wanted > 0))
