"""Fronts: split, merge, rebuild and restore in any order, and refinement for views."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages import Mesh, Sphere, UsageError, lod
from scanloom.stages.lod import Front, Hierarchy, View, refinement_measures
from tests.made.coloured_meshes import assert_same_topology
from tests.stages.lod.conftest import build_cached

Built = tuple[Mesh, Hierarchy]


def covers_all_leaves(front: Front) -> bool:
    """Check that each leaf has exactly one front node among itself and its ancestors."""
    hierarchy, nodes = front.hierarchy, set(front.nodes)
    for leaf in range(hierarchy.nodes):
        if len(hierarchy.children[leaf]):
            continue
        above, node = 0, leaf
        while node >= 0:
            above += node in nodes
            node = int(hierarchy.parent[node])
        if above != 1:
            return False
    return True


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.sampled_from(["ring", "sheet"]), st.randoms(use_true_random=False))
def test_operations_in_any_order_give_a_valid_mesh(name: str, random: st.randoms) -> None:  # type: ignore[valid-type]
    """Run 50 operations in each of 200 sequences."""
    mesh, hierarchy = build_cached(name)
    front = hierarchy.front()
    kept = [front.state]
    for step in range(50):
        what = random.choice(("split", "split", "split", "merge", "rebuild", "keep", "back"))  # type: ignore[attr-defined]
        node = random.choice(front.nodes)  # type: ignore[attr-defined]
        count = random.choice((1, 7, 10**6))  # type: ignore[attr-defined]
        before = front.triangles
        if what == "split":
            assert front.split(node, count).triangles >= before
        elif what == "merge":
            front.merge(node, count)
        elif what == "rebuild":
            wanted = random.randrange(1, 2 * len(mesh.triangles))  # type: ignore[attr-defined]
            assert front.rebuild(wanted).triangles <= max(wanted, hierarchy.coarse[0])
        elif what == "keep":
            kept.append(front.state)
        else:
            state = random.choice(kept)  # type: ignore[attr-defined]
            assert front.restore(state).state == state
        assert covers_all_leaves(front)
        if step % 25 == 24:
            found = front.cut()
            assert len(found.mesh.triangles) == front.triangles
            assert_same_topology(found.mesh, mesh)


def test_merge_inverts_split(hierarchy: Hierarchy) -> None:
    front = hierarchy.front().rebuild(1500)
    before = front.cut()
    node = front.nodes[-1]
    half = int(hierarchy.splits[node]) // 2
    after = front.split(node, half).merge(node, half).cut()
    np.testing.assert_array_equal(before.mesh.triangles, after.mesh.triangles)
    np.testing.assert_array_equal(before.mesh.vertices, after.mesh.vertices)


def test_a_split_adds_one_or_two_triangles(hierarchy: Hierarchy) -> None:
    front = hierarchy.front()
    for _ in range(20):
        before = front.triangles
        assert 1 <= front.split(0).triangles - before <= 2


def test_more_triangles_never_increase_the_error(built: Built) -> None:
    _, hierarchy = built
    errors = [hierarchy.cut(triangles=count).shape_bound_m for count in range(100, 6000, 250)]
    assert errors == sorted(errors, reverse=True)
    assert hierarchy.cut(triangles=10**9).shape_bound_m == 0


def test_a_triangle_count_is_reached_within_one(built: Built) -> None:
    _, hierarchy = built
    for count in (300, 777, 2000):
        if count >= hierarchy.coarse[0]:
            assert count - 1 <= len(hierarchy.cut(triangles=count).mesh.triangles) <= count


def test_an_error_in_metres_is_kept_and_proven(built: Built) -> None:
    _, hierarchy = built
    for error in np.geomspace(hierarchy.shape_bound.min(), hierarchy.shape_bound.max(), 7):
        found = hierarchy.cut(max_shape=float(error))
        assert found.shape_bound_m <= error
        assert found.is_proven.all()


def make_view(distance: float, look: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> View:
    return View((0.0, -distance, 0.3), look, (0.0, 0.0, 1.0), 800, 600)


def test_distant_views_have_fewer_triangles(hierarchy: Hierarchy) -> None:
    counts = [len(hierarchy.cut(make_view(d), error_px=1.0).mesh.triangles) for d in (3, 10, 30, 100, 1000)]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > 2 * counts[-1]
    assert counts[-1] == hierarchy.coarse[0]


def test_errors_in_pixels_hold_for_visible_nodes(hierarchy: Hierarchy) -> None:
    view = make_view(4.0)
    found = hierarchy.cut(view, error_px=0.5)
    middle, radius = hierarchy.spheres
    for node, bound in zip(found.nodes, found.shape_bound, strict=True):
        if view.intersects(middle[[node]], radius[[node]])[0]:
            nearest = max(np.linalg.norm(middle[node] - view.eye) - radius[node], view.near)
            assert bound * view.focal_px / nearest <= 0.5


def test_nodes_outside_the_view_stay_coarse(hierarchy: Hierarchy) -> None:
    away = View((0.0, -4.0, 0.0), (0.0, -8.0, 0.0), (0.0, 0.0, 1.0))
    assert len(hierarchy.cut(away, error_px=0.01).mesh.triangles) == hierarchy.coarse[0]


def test_only_a_given_region_is_refined(hierarchy: Hierarchy) -> None:
    place = Sphere((1.4, 0.0, 0.0), 0.2, lock=True)
    found = hierarchy.cut(region=place)
    exact = {tuple(v) for v in hierarchy.cut(max_shape=0.0).mesh.vertices}
    inside = place.contains(found.mesh.vertices)
    assert inside.any()
    assert all(tuple(v) in exact for v in found.mesh.vertices[inside])
    assert len(found.mesh.triangles) < 0.6 * hierarchy.to_dict()["base_triangles"]


def test_with_hysteresis_a_small_step_back_changes_nothing(hierarchy: Hierarchy) -> None:
    front = hierarchy.front().refine(make_view(5.0), error_px=1.0)
    near = front.state
    assert front.refine(make_view(5.5), error_px=1.0, keep=2.0).state == near
    assert len(front.refine(make_view(50.0), error_px=1.0, keep=2.0).nodes) < len(near)


def test_invalid_targets_and_views_are_refused(hierarchy: Hierarchy) -> None:
    front = hierarchy.front()
    with pytest.raises(UsageError, match="pixels of a view"):
        front.refine(error_px=1.0)
    with pytest.raises(UsageError, match="no target"):
        front.refine(make_view(3.0))
    with pytest.raises(UsageError, match="triangles must be 1"):
        front.refine(triangles=0)
    with pytest.raises(UsageError, match="not in the front"):
        front.split(hierarchy.nodes - 1)
    with pytest.raises(UsageError, match="field"):
        View((0, 0, 0), (0, 0, 1), field=180.0)
    with pytest.raises(UsageError, match="same point"):
        View((0, 0, 1), (0, 0, 1))
    with pytest.raises(UsageError, match="finite"):
        View((0, 0, math.nan), (0, 0, 1))


def test_a_view_straight_down_is_valid() -> None:
    view = View((0, 0, 5), (0, 0, 0), (0, 0, 1))
    normals, _ = view.compute_planes()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    assert view.intersects(np.zeros((1, 3)), np.zeros(1))[0]
    assert not view.intersects(np.array([[0.0, 0.0, 9.0]]), np.ones(1))[0]


# -- the paper's rule ------------------------------------------------------------------------------------


def test_closer_views_have_more_triangles_up_to_the_global_limit(hierarchy: Hierarchy) -> None:
    mesh = hierarchy.cut(max_shape=0.0).mesh
    counts = []
    for distance in (2.0, 5.0, 8.0, 11.0):
        limit = refinement_measures.compute_global_limit(
            len(mesh.triangles), 200, distance, near=2.0, far=11.0
        )
        front = lod.adjust(hierarchy.front(), lod.evaluate(hierarchy, make_view(distance)), limit)
        assert front.triangles <= limit
        assert_same_topology(front.cut().mesh, mesh)
        counts.append(front.triangles)
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > 2 * counts[-1]


def test_the_back_of_the_model_is_not_refined() -> None:
    _, hierarchy = build_cached("ball")
    above = View((0.0, 0.0, 50.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 800, 600, 5.0)
    front = lod.adjust(hierarchy.front(), lod.evaluate(hierarchy, above), math.inf)
    height = front.cut().mesh.vertices[:, 2]
    assert (height > 0.3).sum() > 1.2 * (height < -0.3).sum()


def test_a_marked_region_is_refined_for_any_view(hierarchy: Hierarchy) -> None:
    place = Sphere((1.0, 0.0, 0.0), 1.0, lock=True)
    away = View((0.0, -400.0, 0.0), (0.0, -800.0, 0.0), (0.0, 0.0, 1.0))
    front = lod.adjust(hierarchy.front(), lod.evaluate(hierarchy, away, place), math.inf)
    assert front.triangles > hierarchy.coarse[0]
