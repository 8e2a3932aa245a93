"""Marked regions are refined to the input; weights of the paper's rule match a direct calculation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from scanloom.stages import Box, Mesh, Sphere, lod
from scanloom.stages.lod import Hierarchy, View

Built = tuple[Mesh, Hierarchy]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Points:
    """Region that consists of given points."""

    points: frozenset[tuple[float, ...]]

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        return np.array([tuple(point) in self.points for point in points.tolist()], bool)


def make_view(hierarchy: Hierarchy, *, away: bool, distance: float = 3.0) -> View:
    """Make a view of the model from its front, or from the same position in the opposite direction."""
    middle, radius = hierarchy.spheres[0][0], hierarchy.spheres[1][0]
    eye = middle - np.array((0.0, distance * radius, 0.0))
    return View(tuple(eye), tuple(2 * eye - middle if away else middle), (0.0, 0.0, 1.0), 200, 200)


def list_marked_triangles(mesh: Mesh, inside: NDArray[np.bool_]) -> set[tuple[tuple[float, ...], ...]]:
    """List the triangles at marked vertices by their corner positions."""
    rows = mesh.triangles[inside[mesh.triangles].any(axis=1)]
    return {tuple(sorted(map(tuple, corners))) for corners in mesh.vertices[rows].tolist()}


@pytest.mark.parametrize("size", [1, 10, 100, 1000])
def test_a_marked_region_of_any_size_is_refined_to_the_input(built: Built, size: int) -> None:
    _, hierarchy = built
    exact = hierarchy.cut(max_shape=0.0).mesh
    random = np.random.default_rng(size)
    for away in (False, True, False, True):
        center = exact.vertices[random.integers(len(exact.vertices))]
        distances = np.linalg.norm(exact.vertices - center, axis=1)
        radius = float(np.sort(distances)[size - 1]) * (1 + 1e-12) + 1e-12
        scattered = random.choice(exact.vertices, size, replace=False)
        for region in (Sphere(tuple(center), radius, lock=True), Points(frozenset(map(tuple, scattered)))):
            weights = lod.evaluate(hierarchy, make_view(hierarchy, away=away), region)
            cut = lod.adjust(hierarchy.front(), weights, math.inf).cut().mesh
            marked = region.contains(exact.vertices)
            assert marked.sum() >= size
            assert list_marked_triangles(cut, region.contains(cut.vertices)) == list_marked_triangles(
                exact, marked
            )


def test_marked_nodes_have_priority_within_a_limit(hierarchy: Hierarchy) -> None:
    exact = hierarchy.cut(max_shape=0.0).mesh
    region = Sphere(tuple(exact.vertices[0]), 1e-6, lock=True)
    away, near = make_view(hierarchy, away=True), make_view(hierarchy, away=False, distance=1.1)
    needed = lod.adjust(hierarchy.front(), lod.evaluate(hierarchy, away, region), math.inf).triangles
    cut = lod.adjust(hierarchy.front(), lod.evaluate(hierarchy, near, region), needed).cut().mesh
    assert len(cut.triangles) <= needed
    assert tuple(exact.vertices[0]) in set(map(tuple, cut.vertices.tolist()))
    assert list_marked_triangles(cut, region.contains(cut.vertices)) == list_marked_triangles(
        exact, region.contains(exact.vertices)
    )


def test_constraints_refine_nodes_that_are_mostly_inside(hierarchy: Hierarchy) -> None:
    view = make_view(hierarchy, away=True)
    middle = hierarchy.spheres[0][0]
    half = Box(tuple(middle - 9.0), (float(middle[0]), 9.0, 9.0), lock=True)
    weights = lod.evaluate(hierarchy, view, constraints=half)
    points = hierarchy.vertices
    for node in range(hierarchy.nodes):
        below = list_finest_vertices(hierarchy, node)
        assert weights.marked[node] == pytest.approx(half.contains(points[below]).mean())
    front = lod.adjust(hierarchy.front(), weights, math.inf)
    refined = [n for n in front.nodes if front.state[n]]
    assert refined
    assert all(weights.marked[n] > 0.5 for n in refined)


def test_without_the_silhouette_only_errors_and_marks_count(hierarchy: Hierarchy) -> None:
    view = make_view(hierarchy, away=False, distance=400.0)
    assert lod.evaluate(hierarchy, view).local.max() > 0
    assert lod.evaluate(hierarchy, view, silhouette=False).local.max() == 0


def list_finest_vertices(hierarchy: Hierarchy, node: int) -> NDArray[np.uint32]:
    """List the distinct vertices of the finest level below a node."""
    found, todo = [], [node]
    while todo:
        one = todo.pop()
        todo += hierarchy.children[one].tolist()
        if not len(hierarchy.children[one]):
            rows = slice(hierarchy.first_triangle[one], hierarchy.first_triangle[one + 1])
            found.append(hierarchy.triangles[rows].reshape(-1))
    return np.unique(np.concatenate(found))


def test_weights_of_the_papers_rule_follow_its_formulas(built: Built) -> None:
    _, hierarchy = built
    middle, radius = hierarchy.spheres
    # A narrow view of a part of the model, from the side.
    eye = middle[0] - np.array((0.0, 1.5 * radius[0], 0.0))
    view = View(tuple(eye), tuple(middle[-1]), (0.0, 0.0, 1.0), 64, 64, 25.0)
    points = hierarchy.vertices
    handle = Sphere(tuple(points[-1]), 0.3 * float(radius[0]), lock=True)
    constraints = Sphere(tuple(points[-1]), 0.8 * float(radius[0]), lock=True)
    weights = lod.evaluate(hierarchy, view, handle, constraints=constraints, rule="paper")

    normals, offsets = view.compute_planes()
    everything = constraints.contains(points[list_finest_vertices(hierarchy, 0)]).sum()
    partial = 0
    for node in range(hierarchy.nodes):
        below = points[list_finest_vertices(hierarchy, node)]
        is_inside = bool((normals[:4] @ middle[node] - offsets[:4] < -radius[node]).all())
        ratio = 1.0 if is_inside else (below @ normals.T <= offsets).all(axis=1).mean()
        partial += 0 < ratio < 1
        participation = handle.contains(below).any() * constraints.contains(below).sum() / everything
        is_urgent = weights.error_px[node] > 0.82 or participation > 0.5
        assert weights.frustum[node] == pytest.approx(ratio)
        assert weights.marked[node] == pytest.approx(participation)
        assert weights.local[node] == pytest.approx(
            1.0 if is_urgent else max(ratio * weights.silhouette[node], participation)
        )
    assert partial
    alone = lod.evaluate(hierarchy, view, handle, rule="paper")
    np.testing.assert_array_equal(
        alone.marked, lod.evaluate(hierarchy, view, handle, constraints=handle, rule="paper").marked
    )
