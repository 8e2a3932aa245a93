"""The active front: which nodes of a hierarchy are drawn, and how far each one's vertices are split."""

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
    """A part of space, such as `scanloom.Sphere` and `scanloom.Box`."""

    def holds(self, points: Floats) -> NDArray[np.bool_]:
        """Return which of the points (n, 3) lie within it."""


@dataclass(frozen=True, eq=False)
class Cut:
    """A mesh of a hierarchy, and what is known of it.

    Attributes
    ----------
    mesh : its triangles, node by node.
    node : (m,) int32, the node of each triangle.
    nodes, splits : (k,) int64, the front, and how many vertices of each node are split.
    shape_bound, color_bound : (k,) float64, metres and levels: what is proven of each node's mesh both ways
        against its part of the input; between two levels that of the coarser one, which then is expected.
    is_proven : (k,) bool, whether the node is on a level, and its bound so proven.
    is_one_sided : whether islands were dropped, which then are near nothing here; the bounds are of the rest.
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
        """The largest distance, metres."""
        return float(self.shape_bound.max(initial=0.0))

    @property
    def color_bound_levels(self) -> float | None:
        """The largest difference of colour, levels; None without colours."""
        return None if self.mesh.colors is None else float(self.color_bound.max(initial=0.0))

    def figures(self) -> dict[str, Any]:
        """Return how large it is, and what is proven."""
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
    """The nodes that are drawn, each after some of its splits; all of the surface, at any time.

    What is done to it leaves the hierarchy as it is. Each change returns the front itself.
    """

    def __init__(self, hierarchy: Levels) -> None:
        self.hierarchy = hierarchy
        self._splits: dict[int, int] = {0: 0} if hierarchy.nodes else {}

    @property
    def nodes(self) -> tuple[int, ...]:
        """The nodes, in order."""
        return tuple(sorted(self._splits))

    @property
    def splits(self) -> tuple[int, ...]:
        """How many vertices of each are split, in the order of `nodes`."""
        return tuple(self._splits[n] for n in self.nodes)

    @property
    def state(self) -> dict[int, int]:
        """Nodes and their splits, to go back to with `restore`."""
        return dict(self._splits)

    def restore(self, state: dict[int, int]) -> Front:
        """Go back to an earlier `state` of the same hierarchy."""
        self._splits = dict(state)
        return self

    @property
    def triangles(self) -> int:
        """Triangles there are."""
        return sum(self._triangles(n, s) for n, s in self._splits.items())

    def _triangles(self, node: int, splits: int) -> int:
        h = self.hierarchy
        first = h.first_split[node]
        return int(h.coarse[node] + h.born_before[first + splits] - h.born_before[first])

    def split(self, node: int, count: int = 1) -> Front:
        """Split `count` vertices of a node of the front, or as many as there are.

        Where none is left to split, its children take its place.

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
        """Undo `count` splits of a node of the front, or as many as there are.

        Where none is left to undo, its parent takes the place of all that is below it: whatever of its
        siblings is still split is merged first.

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
            raise UsageError(USAGE_ARGUMENT_INVALID, "count is 1 or more.")

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
        """Go to the front that a view, a number of triangles or an error asks for.

        What is outside the view, or away from the region, stays as coarse as can be.

        Parameters
        ----------
        view : errors are told in its pixels; without one, in metres everywhere.
        triangles : at most so many; those there are go where the proven error is largest. The last node may
            end between two levels.
        error_px : no more than so many pixels of proven error in what is seen; asks for a view.
        max_shape : no more than so many metres of proven error.
        region : something with `holds(points)`, as Sphere and Box; only nodes with a vertex there are
            refined, without another limit to the last.
        keep : 1 or more; where the front is finer than asked already, nodes stay until their error is this
            many times below what is asked for: with 2, small steps of the view there and back change nothing.

        Raises
        ------
        UsageError
            If nothing is asked for, an error comes without a view, or a number is out of range.
        """
        if error_px is not None and view is None:
            raise UsageError(
                USAGE_ARGUMENT_INVALID,
                "error_px is told in pixels of a view",
                remedy="give one, or max_shape in metres.",
            )
        if triangles is None and error_px is None and max_shape is None and region is None:
            raise UsageError(
                USAGE_ARGUMENT_INVALID, "say how far to refine: triangles, error_px, max_shape or region."
            )
        asked = (("triangles", triangles, 1), ("error_px", error_px, 0), ("max_shape", max_shape, 0))
        for name, value, least in asked:
            if value is not None and not value >= least:
                raise UsageError(USAGE_ARGUMENT_INVALID, "{name} is {least} or more.", name=name, least=least)
        if not keep >= 1:
            raise UsageError(USAGE_ARGUMENT_INVALID, "keep is 1 or more.")
        wanted = self._wanted(view, error_px, max_shape, region)
        open_before = self._above_front() if keep > 1 else set()
        self._splits = {0: 0} if self.hierarchy.nodes else {}
        self._descend(wanted, triangles, open_before, keep)
        return self

    def _wanted(
        self, view: View | None, error_px: float | None, max_shape: float | None, region: Region | None
    ) -> Floats:
        """Return how urgent each node (n,) is: its error over that asked for. It is refined above 1."""
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
            # Whatever helps most: the order alone counts.
            urgency = np.where(length > 0, 1 + length / max(float(length.max(initial=0.0)), 1e-300), 0.0)
        if region is not None:
            urgency = np.where(self._in_region(region), urgency, 0.0)
        return np.asarray(urgency)

    def _in_region(self, region: Region) -> NDArray[np.bool_]:
        """Return which nodes (n,) have a vertex in a region, on any level."""
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
        """Refine the most urgent node again and again, as long as there are triangles for it."""
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
        """Go to at most so many triangles, with the error as small as can be."""
        return self.refine(triangles=triangles)

    def cut(self) -> Cut:
        """Return the mesh there is now, and what is proven of it."""
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
