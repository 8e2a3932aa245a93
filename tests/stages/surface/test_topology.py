"""Topology counts of known shapes, and agreement with trimesh on real meshes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages.diagnostics.errors import InputError, MeshError
from scanloom.stages.surface.edges import build_edges, label_components
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.topology import Topology, is_degenerate, require_manifold, topology

TETRAHEDRON = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3))


def compute_topology(triangles, vertices=None) -> Topology:
    triangles = np.array(triangles, np.int32).reshape(-1, 3)
    if vertices is None:
        vertices = np.random.default_rng(0).normal(size=(triangles.max(initial=-1) + 1, 3))
    return topology((vertices, triangles))


def make_torus(rows: int = 6, columns: int = 8) -> np.ndarray:
    index = np.arange(rows * columns).reshape(rows, columns)
    right, down = np.roll(index, -1, 1), np.roll(index, -1, 0)
    across = np.roll(down, -1, 1)
    return np.concatenate(
        [
            np.stack([index, right, across], -1).reshape(-1, 3),
            np.stack([index, across, down], -1).reshape(-1, 3),
        ]
    )


def make_moebius_strip(columns: int = 9) -> np.ndarray:
    """Make a strip of squares between 2 i and 2 i + 1 whose end is joined to its start upside down."""
    triangles = []
    for i in range(columns):
        a, b, c, d = 2 * i, 2 * i + 1, 2 * i + 2, 2 * i + 3
        if i == columns - 1:
            c, d = 1, 0
        triangles += [(a, c, b), (b, c, d)]
    return np.array(triangles)


def test_closed_surfaces():
    sphere = compute_topology(TETRAHEDRON)
    assert (sphere.euler, sphere.edges, sphere.components, sphere.boundary_loops) == (2, 6, 1, 0)
    assert sphere.is_manifold
    assert sphere.is_oriented
    assert sphere.is_closed
    ring = compute_topology(make_torus())
    assert (ring.euler, ring.boundary_edges) == (0, 0)
    assert ring.is_manifold
    assert ring.is_closed


def test_borders():
    open_ring = compute_topology(make_torus()[1:])
    assert (open_ring.euler, open_ring.boundary_edges, open_ring.boundary_loops) == (-1, 3, 1)
    assert open_ring.is_manifold
    assert not open_ring.is_closed
    # Two holes that touch in a vertex form a single loop, which passes that vertex twice.
    pinched = compute_topology([t for t in make_torus(8, 8).tolist() if t not in ([0, 1, 9], [63, 56, 0])])
    assert (pinched.boundary_edges, pinched.boundary_loops, pinched.nonmanifold_vertices) == (6, 1, 1)


def test_moebius_strip_is_manifold_but_not_oriented():
    strip = compute_topology(make_moebius_strip())
    assert (strip.euler, strip.boundary_loops) == (0, 1)
    assert strip.is_manifold
    assert not strip.is_oriented


def test_nonmanifold_parts():
    book = compute_topology([(0, 1, 2), (1, 0, 3), (0, 1, 4)])
    assert (book.nonmanifold_edges, book.nonmanifold_vertices) == (1, 0)
    bow_tie = compute_topology([(0, 1, 2), (0, 3, 4)])
    assert (bow_tie.nonmanifold_edges, bow_tie.nonmanifold_vertices, bow_tie.components) == (0, 1, 1)
    assert bow_tie.boundary_loops == 2
    turned = compute_topology([(0, 1, 2), (0, 1, 3)])
    assert turned.inconsistent_edges == 1
    assert turned.is_manifold
    assert not turned.is_oriented


def test_degenerate_duplicate_and_unreferenced():
    vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [9, 9, 9], [0, 0, 0]]
    found = compute_topology([(0, 1, 2), (1, 2, 0), (2, 1, 0), (0, 1, 3), (0, 0, 1), (0, 5, 2)], vertices)
    assert (found.duplicate, found.degenerate, found.repeating, found.unreferenced) == (2, 3, 1, 1)
    assert not found.is_manifold


@pytest.mark.parametrize("scale", [1e-6, 1, 1e6])
@pytest.mark.parametrize(("height", "flat"), [(0, True), (1e-12, True), (1e-6, False)])
def test_degeneracy_does_not_depend_on_scale(scale, height, flat):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.5, height, 0]]) * scale
    assert is_degenerate(vertices, np.array([[0, 1, 2]], np.int32)).tolist() == [flat]


def test_empty():
    empty = topology((np.zeros((0, 3)), np.zeros((0, 3), int)))
    assert empty.euler == empty.components == empty.boundary_loops == 0
    assert not empty.is_closed
    assert topology((np.zeros((2, 3)), np.zeros((0, 3), int))).unreferenced == 2


def test_metrics_are_plain_numbers():
    import json

    metrics = json.loads(json.dumps(compute_topology(TETRAHEDRON).to_dict()))
    assert metrics["euler"] == 2
    assert metrics["is_closed"] is True


@pytest.mark.parametrize(
    ("triangles", "sentence"),
    [
        ([(0, 1, 2), (1, 0, 3), (0, 1, 4)], r"1 edges with more than two triangles \(0–1\)"),
        ([(0, 1, 2), (0, 3, 4)], r"1 pinched vertices.*\(0\)"),
        ([(0, 1, 2), (0, 1, 3)], r"inconsistently oriented edges \(0–1\)"),
        ([(0, 1, 2), (3, 4, 4)], r"repeat a vertex \(1\)"),
    ],
)
def test_require_manifold_names_the_offenders(triangles, sentence):
    vertices = np.random.default_rng(0).normal(size=(5, 3))
    with pytest.raises(MeshError, match=sentence):
        require_manifold((vertices, np.array(triangles)), "that.ply")


def test_require_manifold_returns_the_mesh():
    assert len(require_manifold((np.eye(4, 3), np.array(TETRAHEDRON))).triangles) == 4


def test_component_labels_come_in_order_of_first_node():
    # Vertex splitting relies on this order: the fan of the first corner keeps the old vertex.
    _, labels = label_components(6, np.array([5, 1]), np.array([0, 3]))
    assert labels.tolist() == [0, 1, 2, 1, 3, 0]


@settings(deadline=None)
@given(
    st.lists(st.tuples(*[st.integers(0, 6)] * 3).filter(lambda t: len(set(t)) == 3), min_size=1, max_size=20)
)
def test_edges_agree_with_a_dictionary(rows):
    triangles = np.array(rows, np.int32)
    expected: dict[tuple[int, int], list[bool]] = {}
    for a, b, c in rows:
        for tail, head in ((a, b), (b, c), (c, a)):
            expected.setdefault((min(tail, head), max(tail, head)), []).append(tail < head)
    edges = build_edges(triangles, 7)
    assert [tuple(e) for e in edges.ends.tolist()] == sorted(expected)
    assert edges.triangle_count.tolist() == [len(expected[e]) for e in sorted(expected)]
    assert edges.forward_count.tolist() == [sum(expected[e]) for e in sorted(expected)]


def assert_agrees_with_trimesh(vertices, triangles) -> None:
    import trimesh

    ours = topology((vertices, triangles))
    theirs = trimesh.Trimesh(vertices, triangles, process=False)
    assert ours.euler == theirs.euler_number
    assert ours.components == theirs.body_count - ours.unreferenced
    assert ours.is_closed == theirs.is_watertight
    if ours.nonmanifold_edges == 0:
        assert ours.is_oriented == theirs.is_winding_consistent


@settings(deadline=None)
@given(
    st.lists(st.tuples(*[st.integers(0, 7)] * 3).filter(lambda t: len(set(t)) == 3), min_size=1, max_size=12)
)
def test_random_triangles_agree_with_trimesh(rows):
    triangles = np.unique(np.sort(rows, axis=1), axis=0)
    assert_agrees_with_trimesh(np.random.default_rng(0).normal(size=(8, 3)), triangles)


@pytest.mark.parametrize(
    "name",
    ["cow.obj", "stanford-bunny.obj", "fandisk.obj", "camelhead.off", "colored_airplane.ply", "pirate.obj",
     "Duck.glb", "CesiumMilkTruck.glb", "redkitchen_fused_vertexcolor.ply", "sceaux_mvs_scene_mesh.ply"],
)  # fmt: skip
def test_real_meshes_agree_with_trimesh(shared_data, name):
    mesh = read_mesh(shared_data / "meshes" / name)
    assert_agrees_with_trimesh(mesh.vertices, mesh.triangles)


def test_topology_of_a_real_kitchen(shared_data):
    kitchen = topology(read_mesh(shared_data / "meshes" / "redkitchen_fused_vertexcolor.ply"))
    assert (kitchen.boundary_edges, kitchen.components) == (9478, 190)
    assert topology(read_mesh(shared_data / "meshes" / "stanford-bunny.obj")).boundary_edges == 223


def test_a_path_is_not_a_mesh():
    with pytest.raises(InputError):
        topology("mesh.ply")
