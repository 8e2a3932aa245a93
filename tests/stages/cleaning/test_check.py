"""Defects: each class planted in a sound mesh is found, named and located, and no other defects are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom import Mesh, UsageError, check, stages, to_open3d_legacy
from scanloom.stages.cleaning.check import CLASSES, PAPER_CORNER_ANGLE, REQUIREMENTS
from scanloom.stages.surface.mesh_files import read_mesh
from tests.made.coloured_meshes import ball, sheet


def add_triangles(mesh: Mesh, vertices: list[list[float]], triangles: list[list[int]]) -> Mesh:
    """Add vertices, numbered after the existing ones, and triangles."""
    return Mesh(
        np.concatenate((mesh.vertices, np.array(vertices, float).reshape(-1, 3))),
        np.concatenate((mesh.triangles, np.array(triangles, np.int32).reshape(-1, 3))),
    )


def count_defects(found: stages.CheckResult) -> dict[str, int]:
    """Count defects by class, without empty classes."""
    return {name: len(places) for name, places in found.defects.items() if len(places)}


def make_soup(seed: int, count: int, size: float) -> Mesh:
    random = np.random.default_rng(seed)
    middles = random.uniform(size=(count, 1, 3))
    corners = (middles + size * random.uniform(-1, 1, size=(count, 3, 3))).reshape(-1, 3)
    return Mesh(corners, np.arange(3 * count, dtype=np.int32).reshape(-1, 3))


# -- sound meshes ----------------------------------------------------------------------------------------


def test_a_sphere_is_watertight_and_has_no_defects() -> None:
    found = check(ball(), min_thickness=0.1)
    assert count_defects(found) == {}
    assert found.is_watertight
    assert found.find_unmet(REQUIREMENTS) == []
    np.testing.assert_allclose(found.thickness, 2 * np.linalg.norm(ball().vertices, axis=1).max(), rtol=0.1)


def test_a_sheet_only_has_border_edges() -> None:
    found = check(sheet(10))
    assert count_defects(found) == {"border_edges": 40}
    assert not found.is_watertight
    assert np.isnan(found.thickness).all()
    (sentence,) = map(str, found.find_unmet(["watertight"]))
    assert "edges with only one triangle: 40" in sentence


# -- each planted class ----------------------------------------------------------------------------------


def test_an_edge_of_three_triangles() -> None:
    mesh = ball()
    a, b, _ = mesh.triangles[0]
    found = check(add_triangles(mesh, [[3, 3, 3]], [[a, b, len(mesh.vertices)]]))
    assert found.defects["nonmanifold_edges"].tolist() == [sorted((int(a), int(b)))]
    assert (
        len(found.find_unmet(["manifold", "closed", "watertight", "outward", "one-piece", "oriented"])) == 4
    )


def test_a_flipped_triangle() -> None:
    mesh = ball()
    turned = mesh.triangles.copy()
    turned[7] = turned[7, ::-1]
    found = check(mesh.with_(triangles=turned))
    assert len(found.defects["inconsistent_edges"]) == 3
    assert str(found.find_unmet(["oriented"])[0]).startswith(
        "it has edges between triangles of opposite orientation: 3"
    )


def test_two_balls_that_share_a_vertex() -> None:
    mesh = ball()
    top = int(mesh.vertices[:, 2].argmax())
    other = mesh.vertices * [1, 1, -1] + [0, 0, 2 * mesh.vertices[top, 2]]
    number = np.arange(len(other)) + len(mesh.vertices)
    number[top] = top
    found = check(add_triangles(mesh, other.tolist(), number[mesh.triangles[:, ::-1]].tolist()))
    assert count_defects(found) == {"singular_vertices": 1}
    assert found.defects["singular_vertices"].tolist() == [top]
    np.testing.assert_array_equal(found.defect_points["singular_vertices"], mesh.vertices[[top]])


def test_triangles_that_share_only_a_vertex() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [-1, 0, 0], [-1, -1, 0.0]])
    found = check((vertices, np.array([[0, 1, 2], [0, 3, 4]])))
    assert count_defects(found) == {
        "border_edges": 6,
        "singular_vertices": 1,
        "focal_vertices": 1,
        "singular_border_triangles": 2,
    }


def test_degenerate_and_duplicate_triangles() -> None:
    mesh, count = ball(), len(ball().triangles)
    first = mesh.triangles[0].tolist()
    found = check(add_triangles(mesh, [], [[first[0], first[0], first[1]], first]))
    assert found.defects["degenerate_triangles"].tolist() == [count]
    assert found.defects["duplicate_triangles"].tolist() == [count + 1]
    assert len(found.defects["intersecting_triangles"]) == 0


def test_caps_and_needles_are_distinguished() -> None:
    cap = np.array([[0, 0, 0], [1, 0, 0], [0.5, 0.001, 0]])
    needle = np.array([[0, 0, 0], [1, 0, 0], [1, 0.001, 0]])
    three = np.array([[0, 1, 2]])
    assert count_defects(check((cap, three))) == {"border_edges": 3, "caps": 1}
    assert count_defects(check((needle, three))) == {"border_edges": 3, "needles": 1}
    # The angle of the paper finds neither.
    assert count_defects(check((cap, three), corner_angle=PAPER_CORNER_ANGLE)) == {"border_edges": 3}


def test_a_fold_and_an_overlapping_neighbour() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, 0.9, 0.0]])
    flat = np.array([[0, 1, 2], [1, 0, 3]])
    found = check((vertices, flat))
    assert found.defects["sharp_edges"].tolist() == [[0, 1]]
    assert found.defects["intersecting_triangles"].tolist() == [0, 1]
    vertices[3, 2] = 0.1
    opened = check((vertices, flat))
    assert opened.defects["sharp_edges"].tolist() == [[0, 1]]
    assert len(opened.defects["intersecting_triangles"]) == 0
    assert count_defects(check((vertices, flat), fold_angle=5)) == {"border_edges": 4}


def test_a_vertex_pulled_out_is_a_spike() -> None:
    mesh = ball()
    pulled = mesh.vertices.copy()
    pulled[5] *= 3
    found = check((pulled, mesh.triangles))
    assert found.defects["spikes"].tolist() == [5]
    assert "spikes" not in count_defects(check((pulled, mesh.triangles), spike_angle=1))


def test_an_inverted_sphere() -> None:
    mesh = ball()
    both = add_triangles(
        mesh, (mesh.vertices + 10).tolist(), (mesh.triangles[:, ::-1] + len(mesh.vertices)).tolist()
    )
    found = check(both)
    assert found.is_watertight
    assert found.inside_out_count == 1
    assert [str(one) for one in found.find_unmet(["outward", "one-piece"])] == [
        "1 of 2 connected components are oriented inwards.",
        "it has 2 connected components.",
    ]


def test_the_thickness_of_a_plate_is_measured() -> None:
    trimesh = pytest.importorskip("trimesh")
    found = check(trimesh.creation.box((1, 1, 0.01)), min_thickness=0.02)
    assert np.sort(found.thickness) == pytest.approx([0.01] * 4 + [1.0] * 8, rel=1e-3)
    assert len(found.defects["thin_triangles"]) == 4
    assert found.to_dict()["thickness_min_m"] == pytest.approx(0.01, rel=1e-3)
    assert "thinner than min_thickness: 4" in str(found.find_unmet(["no-thin-triangles"])[0])


def test_duplicated_seam_vertices_count_as_one() -> None:
    mesh = ball()
    apart = Mesh(mesh.vertices[mesh.triangles].reshape(-1, 3), np.arange(mesh.triangles.size).reshape(-1, 3))
    found = check(apart)
    assert found.is_watertight
    assert count_defects(found) == {}
    assert found.topology.vertices == len(mesh.vertices)


# -- triangles that intersect ----------------------------------------------------------------------------

PLATE = ([0, 0, 0], [4, 0, 0], [0, 4, 0])
TOUCHING = {
    "through it": ([1, 1, -1], [1, 1, 1], [3, 3, 1]),
    "a corner on it": ([1, 1, 0], [1, 2, 1], [2, 1, 1]),
    "a side through its side": ([2, -1, -1], [2, 1, 1], [2, -3, 3]),
    "within it": ([1, 1, 0], [2, 1, 0], [1, 2, 0]),
    "around it": ([-9, -9, 0], [30, -9, 0], [-9, 30, 0]),
    "beside it, along a side": ([1, 0, 0], [3, 0, 0], [2, -2, 0]),
    "crossing it in its plane": ([-1, 1, 0], [6, 1, 0], [-1, 1.5, 0]),
}
APART = {
    # Coincident vertices are one vertex, which both triangles may share.
    "joined at a corner": ([0, 0, 0], [-1, 0, 1], [0, -1, 1]),
    "above": ([1, 1, 1e-300], [1, 2, 1], [2, 1, 1]),
    "beside": ([2, 2 + 1e-15, 0], [5, 2, 0], [2, 5, 0]),
    "through its plane": ([3, 3, -1], [3, 3, 1], [5, 5, 1]),
    "around no corner of it": ([-1, -1, -1], [-1, -1, 1], [-5, 3, 0]),
}


@pytest.mark.parametrize("where", TOUCHING)
@pytest.mark.parametrize("turn", range(3))
def test_touching_triangles_intersect(where: str, turn: int) -> None:
    assert _find_intersections(TOUCHING[where], turn) == [0, 1]


@pytest.mark.parametrize("where", APART)
@pytest.mark.parametrize("turn", range(3))
def test_separate_triangles_do_not_intersect_even_if_close(where: str, turn: int) -> None:
    assert _find_intersections(APART[where], turn) == []


def _find_intersections(other: tuple[list[float], ...], turn: int) -> list[int]:
    vertices = np.roll(np.array([*PLATE, *np.roll(other, turn, axis=0)], float), turn, axis=1)
    found = check((vertices, np.array([[0, 1, 2], [3, 4, 5]])))
    return list(found.defects["intersecting_triangles"])


@given(st.integers(0, 10**6), st.integers(2, 60), st.sampled_from([0.03, 0.1, 0.4]))
@settings(deadline=None, max_examples=60)
def test_intersections_in_soups_agree_with_open3d(seed: int, count: int, size: float) -> None:
    mesh = make_soup(seed, count, size)
    pairs = np.asarray(to_open3d_legacy(mesh).get_self_intersecting_triangles())
    assert check(mesh).defects["intersecting_triangles"].tolist() == sorted(set(pairs.reshape(-1).tolist()))


def test_two_spheres_intersect_along_a_ring() -> None:
    mesh, count = ball(), len(ball().triangles)
    moved = mesh.vertices + np.array([0.7, 0.01, 0.02])
    both = add_triangles(mesh, moved.tolist(), (mesh.triangles + len(mesh.vertices)).tolist())
    found = check(both).defects["intersecting_triangles"]
    assert 0 < np.count_nonzero(found < count) < count / 4
    assert 0 < np.count_nonzero(found >= count) < count / 4


def test_results_do_not_depend_on_the_number_of_threads() -> None:
    mesh = make_soup(3, 3000, 0.05)
    one, three = (check(mesh, threads=threads) for threads in (1, 3))
    for name in CLASSES:
        np.testing.assert_array_equal(one.defects[name], three.defects[name])


# -- metrics and invalid input ---------------------------------------------------------------------------


def test_metrics_list_all_classes_with_their_first_positions() -> None:
    metrics = check(sheet(4)).to_dict()
    assert set(metrics["classes"]) == set(CLASSES)
    border = metrics["classes"]["border_edges"]
    assert (border["count"], border["kind"], border["treatment"]) == (16, "edge", "warning")
    assert len(border["first"]) == 10
    assert set(border["first"][0]) == {"edge", "point_m"}


def test_an_empty_mesh_is_not_closed() -> None:
    found = check((np.empty((0, 3)), np.empty((0, 3), np.int32)))
    assert count_defects(found) == {}
    assert [str(one) for one in found.find_unmet(["closed", "one-piece"])] == [
        "it has no surface.",
        "it has 0 connected components.",
    ]


def test_an_unknown_requirement_is_refused() -> None:
    with pytest.raises(
        UsageError, match="unknown requirement 'waterproof'; valid requirements are watertight, closed"
    ):
        check(ball()).find_unmet(["waterproof"])


def test_the_wall_requirement_needs_a_limit() -> None:
    with pytest.raises(UsageError, match="no-thin-triangles needs min_thickness"):
        check(ball()).find_unmet(["no-thin-triangles"])


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("fandisk.obj", {}),
        ("cow.obj", {"singular_vertices": 1}),
        ("redkitchen_fused_vertexcolor.ply", {"singular_vertices": 28, "border_edges": 9478}),
    ],
)
def test_real_meshes(shared_data: Path, name: str, wanted: dict[str, int]) -> None:
    found = check(read_mesh(shared_data / "meshes" / name))
    topology = stages.topology(read_mesh(shared_data / "meshes" / name))
    assert count_defects(found).items() >= wanted.items()
    assert len(found.defects["border_edges"]) == topology.boundary_edges
    assert len(found.defects["singular_vertices"]) == topology.nonmanifold_vertices
