"""Edges and connected components."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from scanloom.stages.surface.edges import build_edges, label_components, step_to_next_corner


@pytest.mark.parametrize("dtypes", [(np.int32, np.int32), (np.int64, np.int32), (np.int64, np.int64)])
@pytest.mark.parametrize("pair_count", [0, 300, 900])
def test_components_agree_with_scipy(pair_count: int, dtypes: tuple[type, type]) -> None:
    a, b = np.random.default_rng(pair_count).integers(0, 1000, (2, pair_count))
    graph = csr_matrix((np.ones(pair_count, np.int8), (a, b)), shape=(1000, 1000))
    count, labels = connected_components(graph, directed=False)
    found_count, found = label_components(
        1000, *(x.astype(kind) for x, kind in zip((a, b), dtypes, strict=True))
    )
    assert found_count == count
    assert np.array_equal(found, labels)
    assert found.dtype == labels.dtype


def test_nodes_that_do_not_exist_are_refused() -> None:
    for wrong in (-1, 3):
        with pytest.raises(ValueError, match=f"node {wrong} does not exist; there are 3"):
            label_components(3, np.array([0, wrong]), np.array([1, 2]))
    with pytest.raises(ValueError, match="1 and 2 nodes cannot be paired"):
        label_components(3, np.array([0]), np.array([1, 2]))


def test_edges_of_any_triangles() -> None:
    triangles = np.random.default_rng(2).permuted(np.tile(np.arange(12), (40, 1)), axis=1)[:, :3]
    edges = build_edges(triangles.astype(np.int32), 12)
    corners = triangles.reshape(-1)
    halfedges: dict[tuple[int, int], list[int]] = {}
    for h, (tail, head) in enumerate(zip(corners, corners[step_to_next_corner(np.arange(120))], strict=True)):
        halfedges.setdefault((min(tail, head), max(tail, head)), []).append(h)
    assert [tuple(ends) for ends in edges.ends.tolist()] == sorted(halfedges)
    for edge, ends in enumerate(sorted(halfedges)):
        own = edges.halfedges[edges.start[edge] :][: edges.triangle_count[edge]].tolist()
        assert own == halfedges[ends]
        assert (edges.of_halfedge[own] == edge).all()
        assert edges.forward_count[edge] == sum(corners[h] == ends[0] for h in own)
