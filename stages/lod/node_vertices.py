"""Vertices of the nodes of a hierarchy, in flat arrays for fast counts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]
Mask = NDArray[np.bool_]
Values = TypeVar("Values", bound=NDArray[Any])


@dataclass(frozen=True, eq=False)
class NodeVertices:
    """Vertices of each node, and of the finest level below each node.

    Attributes
    ----------
    parent : (n,) parent of each node, with a smaller index; -1 for the root.
    start : (n + 1,) start of each node in `vertices`.
    vertices : (k,) vertices that each node uses at any number of splits, ascending in each node.
    counted_node, counted_vertex, counted_sign : (e,) terms of a count of distinct vertices of the finest
        level. A leaf counts each of its vertices. A node whose children share a vertex subtracts the
        surplus, so that sums over the nodes of a subtree count each vertex once.
    """

    parent: Ids
    start: Ids
    vertices: NDArray[np.uint32]
    counted_node: Ids
    counted_vertex: Ids
    counted_sign: Floats

    @staticmethod
    def of(
        lists: Sequence[NDArray[np.uint32]],
        parent: NDArray[np.integer[Any]],
        full: Ids,
        triangles: NDArray[np.uint32],
    ) -> NodeVertices:
        """Collect the vertices of all nodes.

        Parameters
        ----------
        lists : vertices of each node, ascending.
        parent, full : (n,) parent of each node, and number of its triangles with all splits done.
        triangles : (t, 3) triangles of all nodes, in their order.
        """
        start = np.concatenate([[0], np.cumsum([len(one) for one in lists], dtype=np.int64)])
        vertices = np.concatenate([np.zeros(0, np.uint32), *lists])
        above = parent.astype(np.int64)
        return NodeVertices(above, start, vertices, *_list_counts(above, full, triangles))

    @cached_property
    def _nodes_by_depth(self) -> Sequence[Ids]:
        """Nodes of each depth below the root, deepest first."""
        return _group_by_depth(self.parent)

    @cached_property
    def finest_counts(self) -> Floats:
        """Number of distinct vertices (n,) of the finest level below each node."""
        return self.count_finest(np.ones(int(self.counted_vertex.max(initial=-1)) + 1, bool))

    def count_finest(self, inside: Mask) -> Floats:
        """Count the distinct vertices of the finest level below each node that are inside a mask, (n,)."""
        chosen = np.flatnonzero(inside[self.counted_vertex])
        counts: Floats = np.zeros(len(self.parent))
        np.add.at(counts, self.counted_node[chosen], self.counted_sign[chosen])
        for nodes in self._nodes_by_depth:
            np.add.at(counts, self.parent[nodes], counts[nodes])
        return counts

    def contains_any(self, inside: Mask) -> Mask:
        """Return a mask (n,) of the nodes with a vertex inside a mask, at any split or level below."""
        found = np.zeros(len(self.parent), bool)
        found[np.searchsorted(self.start, np.flatnonzero(inside[self.vertices]), side="right") - 1] = True
        return self.propagate_max(found)

    def propagate_max(self, values: Values) -> Values:
        """Return the maximum (n,) of each node's value and of all nodes below."""
        values = values.copy()
        for nodes in self._nodes_by_depth:
            np.maximum.at(values, self.parent[nodes], values[nodes])
        return values

    def reduce(self, ufunc: np.ufunc, values: NDArray[np.float64], empty: float) -> Floats:
        """Reduce values (k, ...) of `vertices` to one row per node (n, ...), or `empty`."""
        found = np.full((len(self.parent), *values.shape[1:]), empty)
        filled = np.flatnonzero(np.diff(self.start))
        if len(filled):
            found[filled] = ufunc.reduceat(values, self.start[filled], axis=0)
        return found


def _group_by_depth(parent: Ids) -> list[Ids]:
    """Group all nodes but the root by their depth, deepest first."""
    depth = np.zeros(len(parent), np.int64)
    for node, above in enumerate(parent.tolist()):
        if above >= 0:
            depth[node] = depth[above] + 1
    return [np.flatnonzero(depth == d) for d in range(int(depth.max(initial=0)), 0, -1)]


def _list_counts(parent: Ids, full: Ids, triangles: NDArray[np.uint32]) -> tuple[Ids, Ids, Floats]:
    """List the terms of `NodeVertices.count_finest`: nodes, vertices and signs (e,)."""
    width = int(triangles.max(initial=0)) + 1
    is_leaf = np.ones(len(parent), bool)
    is_leaf[parent[1:]] = False
    node = np.repeat(np.arange(len(parent)), full)
    rows = np.flatnonzero(is_leaf[node])
    keys = _sort_unique((node[rows, None] * width + triangles[rows]).reshape(-1))
    terms: list[tuple[Ids, Floats]] = [(keys, np.ones(len(keys)))]
    # Only vertices of several leaves can be counted twice.
    shared = keys[(np.bincount(keys % width, minlength=width) > 1)[keys % width]]
    raised = np.zeros(0, np.int64)
    for nodes in _group_by_depth(parent):
        is_here = np.zeros(len(parent), bool)
        is_here[nodes] = True
        below = np.concatenate([raised, shared[is_here[shared // width]]])
        raised, count = np.unique(parent[below // width] * width + below % width, return_counts=True)
        surplus: Floats = 1.0 - count[count > 1].astype(np.float64)
        terms.append((raised[count > 1], surplus))
    keys, signs = (np.concatenate(parts) for parts in zip(*terms, strict=True))
    return keys // width, keys % width, signs


def _sort_unique(keys: Ids) -> Ids:
    keys = np.sort(keys)
    return keys[np.flatnonzero(np.diff(keys, prepend=keys[:1] - 1))]
