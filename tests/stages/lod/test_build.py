"""Levels of detail: exact leaves, no cracks, and bounds that no sampled point exceeds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from scanloom.stages import Image, InputError, Material, Mesh, Texture, UsageError, lod, read_mesh, topology
from scanloom.stages._open3d import import_open3d
from scanloom.stages.lod import Hierarchy
from tests.made.coloured_meshes import assert_same_topology, ball, sheet

Built = tuple[Mesh, Hierarchy]


def list_leaves(hierarchy: Hierarchy, node: int) -> list[int]:
    below = [int(child) for child in hierarchy.children[node]]
    return [leaf for child in below for leaf in list_leaves(hierarchy, child)] if below else [node]


def get_base_mesh(hierarchy: Hierarchy, node: int) -> Mesh:
    """Get the part of the input mesh that a node covers."""
    leaves = list_leaves(hierarchy, node)
    return hierarchy.mesh(leaves, hierarchy.splits[leaves])


def sort_triangle_corners(mesh: Mesh) -> NDArray[np.float64]:
    """Get the sorted corners (m, 9) of a mesh; each triangle starts with its lowest corner."""
    corners = mesh.vertices[mesh.triangles]
    rows = []
    for triangle in corners:
        first = min(range(3), key=lambda i: tuple(triangle[i]))
        rows.append(np.roll(triangle, -first, axis=0).reshape(-1))
    return np.array(sorted(map(tuple, rows)))


def sample_surface(mesh: Mesh, count: int, seed: int) -> NDArray[np.float64]:
    """Sample points on a surface, plus its vertices and triangle centres."""
    random = np.random.default_rng(seed)
    corners = mesh.vertices[mesh.triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = random.choice(len(corners), count, p=areas / areas.sum())
    weights = random.dirichlet(np.ones(3), count)
    inside = np.einsum("ij,ijk->ik", weights, corners[chosen])
    return np.concatenate([mesh.vertices, corners.mean(axis=1), inside])


def measure_max_distance(points: NDArray[np.float64], mesh: Mesh) -> float:
    """Measure the maximum distance of points to a surface with Open3D, minus its rounding error."""
    scene = import_open3d().t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
    found = scene.compute_distance(points.astype(np.float32)).numpy()
    return max(float(found.max()) - 1e-6 * float(np.abs(mesh.vertices).max()), 0.0)


def sample_colors(mesh: Mesh, count: int, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sample points on a surface, and its colours there."""
    assert mesh.colors is not None
    random = np.random.default_rng(seed)
    chosen, weights = random.integers(len(mesh.triangles), size=count), random.dirichlet(np.ones(3), count)
    of_corners = mesh.triangles[chosen]
    inside, shown = (
        np.einsum("ij,ijk->ik", weights, np.asarray(a, np.float64)[of_corners])
        for a in (mesh.vertices, mesh.colors)
    )
    return np.concatenate([mesh.vertices, inside]), np.concatenate([mesh.colors, shown])


def measure_max_color_difference(
    points: NDArray[np.float64], colors: NDArray[np.float64], mesh: Mesh
) -> float:
    """Measure the maximum difference of colours to the nearest points of a surface, levels."""
    assert mesh.colors is not None
    scene = import_open3d().t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
    found = scene.compute_closest_points(points.astype(np.float32))
    of_corners = mesh.triangles[found["primitive_ids"].numpy().astype(np.int64)]
    weights = trimesh.triangles.points_to_barycentric(mesh.vertices[of_corners], found["points"].numpy())
    there = np.einsum("ij,ijk->ik", weights.clip(0, 1), mesh.colors[of_corners].astype(np.float64))
    return float(np.linalg.norm(colors - there, axis=1).max())


def choose_random_front(hierarchy: Hierarchy, random: np.random.Generator) -> tuple[list[int], list[int]]:
    nodes, open_nodes, depth = [], [0], random.random()
    while open_nodes:
        node = open_nodes.pop()
        if len(hierarchy.children[node]) and random.random() < depth:
            open_nodes += [int(child) for child in hierarchy.children[node]]
        else:
            nodes.append(node)
    return nodes, [int(random.integers(hierarchy.splits[n] + 1)) for n in nodes]


# -- the tree --------------------------------------------------------------------------------------------


def test_the_leaves_equal_the_input_exactly(built: Built) -> None:
    mesh, hierarchy = built
    leaves = list_leaves(hierarchy, 0)
    assert len(leaves) > 4
    whole = hierarchy.mesh(leaves, hierarchy.splits[leaves])
    np.testing.assert_array_equal(sort_triangle_corners(whole), sort_triangle_corners(mesh))
    assert len(whole.vertices) == len(mesh.vertices)
    assert whole.colors is not None
    assert mesh.colors is not None
    by_place = {tuple(v): tuple(c) for v, c in zip(mesh.vertices, mesh.colors, strict=True)}
    assert all(by_place[tuple(v)] == tuple(c) for v, c in zip(whole.vertices, whole.colors, strict=True))


def test_a_fully_split_node_equals_its_children(built: Built) -> None:
    _, hierarchy = built
    for node in range(hierarchy.nodes):
        children = hierarchy.children[node]
        if len(children):
            full = hierarchy.mesh([node], [hierarchy.splits[node]])
            parts = hierarchy.mesh(children, np.zeros(len(children), int))
            np.testing.assert_array_equal(sort_triangle_corners(full), sort_triangle_corners(parts))


def test_cells_have_the_requested_size_and_coarser_levels_fewer_triangles(built: Built) -> None:
    mesh, hierarchy = built
    assert (hierarchy.full <= 600).all()
    assert (hierarchy.coarse < hierarchy.full).all()
    # Leaves are at least about half full on average, because clusters grow evenly.
    leaves = list_leaves(hierarchy, 0)
    assert hierarchy.full[leaves].sum() == len(mesh.triangles)
    assert hierarchy.full[leaves].mean() > 200


def test_bounds_grow_towards_the_root(built: Built) -> None:
    _, hierarchy = built
    inner = hierarchy.parent[1:]
    assert (hierarchy.shape_bound[inner] >= hierarchy.shape_bound[1:]).all()
    assert (hierarchy.color_bound[inner] >= hierarchy.color_bound[1:]).all()
    assert (hierarchy.shape_bound > 0).all()


# -- no cracks -------------------------------------------------------------------------------------------


def test_random_fronts_have_no_new_boundary_and_no_edge_with_three_triangles(built: Built) -> None:
    mesh, hierarchy = built
    random = np.random.default_rng(7)
    for _ in range(150):
        assert_same_topology(hierarchy.mesh(*choose_random_front(hierarchy, random)), mesh)


# -- bounds ----------------------------------------------------------------------------------------------


def test_no_sampled_point_exceeds_a_shape_bound_and_bounds_are_tight(built: Built) -> None:
    _, hierarchy = built
    shares = []
    for node in range(hierarchy.nodes):
        coarse, base = hierarchy.mesh([node], [0]), get_base_mesh(hierarchy, node)
        there = measure_max_distance(sample_surface(coarse, 2000, node), base)
        back = measure_max_distance(sample_surface(base, 2000, node), coarse)
        attack = max(there, back)
        assert attack <= hierarchy.shape_bound[node] * (1 + 1e-9)
        shares.append(attack / hierarchy.shape_bound[node])
    assert np.quantile(shares, 0.1) >= 0.8, shares


def test_no_sampled_point_exceeds_a_colour_bound(built: Built) -> None:
    _, hierarchy = built
    shares = []
    for node in range(hierarchy.nodes):
        coarse, base = hierarchy.mesh([node], [0]), get_base_mesh(hierarchy, node)
        attack = max(
            measure_max_color_difference(*sample_colors(coarse, 2000, node), base),
            measure_max_color_difference(*sample_colors(base, 2000, node), coarse),
        )
        assert attack <= hierarchy.color_bound[node]
        shares.append(attack / hierarchy.color_bound[node])
    assert np.quantile(shares, 0.1) >= 0.6, shares


def test_the_coarser_bound_holds_between_two_levels(built: Built) -> None:
    _, hierarchy = built
    random = np.random.default_rng(3)
    for _ in range(12):
        node = int(random.integers(hierarchy.nodes))
        splits = int(random.integers(hierarchy.splits[node] + 1))
        mesh, base = hierarchy.mesh([node], [splits]), get_base_mesh(hierarchy, node)
        attack = max(
            measure_max_distance(sample_surface(mesh, 1000, node), base),
            measure_max_distance(sample_surface(base, 1000, node), mesh),
        )
        assert attack <= hierarchy.shape_bound[node]


def test_with_a_base_error_bounds_are_relative_to_the_input() -> None:
    mesh = sheet(40)
    hierarchy = lod.build(mesh, base_error=0.002, cell_triangles=400, root_triangles=100)
    base = hierarchy.cut(max_shape=0.0)
    assert 0 < base.shape_bound_m <= 0.002
    assert len(base.mesh.triangles) < len(mesh.triangles) / 2
    assert hierarchy.to_dict()["stored_per_input"] < 0.9
    for node in range(hierarchy.nodes):
        coarse = hierarchy.mesh([node], [0])
        assert measure_max_distance(sample_surface(coarse, 500, node), mesh) <= hierarchy.shape_bound[node]
    root = hierarchy.mesh([0], [0])
    assert measure_max_distance(sample_surface(mesh, 3000, 0), root) <= hierarchy.shape_bound[0]


# -- any number of threads, any mesh ---------------------------------------------------------------------


def test_the_file_does_not_depend_on_the_thread_count(tmp_path: Path) -> None:
    files = []
    for threads in (1, 2, 3):
        files.append(tmp_path / f"{threads}.slod")
        lod.write_slod(
            files[-1], lod.build(sheet(30), cell_triangles=300, root_triangles=60, threads=threads)
        )
    assert files[0].read_bytes() == files[1].read_bytes() == files[2].read_bytes()


def test_small_components_are_kept_and_share_cells() -> None:
    part = trimesh.creation.icosphere(subdivisions=2)
    random = np.random.default_rng(0)
    parts = [(part.vertices * 0.05 + random.uniform(size=3), np.asarray(part.faces)) for _ in range(30)]
    offsets = np.cumsum([0] + [len(v) for v, _ in parts[:-1]])
    mesh = Mesh(
        np.concatenate([v for v, _ in parts]),
        np.concatenate([f + o for (_, f), o in zip(parts, offsets, strict=True)]).astype(np.int32),
    )
    hierarchy = lod.build(mesh, cell_triangles=1500, root_triangles=50)
    assert len(list_leaves(hierarchy, 0)) < 15
    assert topology(hierarchy.cut(triangles=1).mesh).components == 30


def test_pinched_surfaces_are_accepted_with_a_diagnostic() -> None:
    mesh = ball()
    # A second ball on the highest vertex of the first.
    top = int(np.argmax(mesh.vertices[:, 2]))
    other = mesh.vertices + np.array([0, 0, 2 * mesh.vertices[top, 2]])
    bottom = int(np.argmin(other[:, 2]))
    number = np.arange(len(other)) + len(mesh.vertices)
    number[bottom] = top
    pinched = Mesh(
        np.concatenate([mesh.vertices, other]),
        np.concatenate([mesh.triangles, number[mesh.triangles].astype(np.int32)]),
    )
    hierarchy = lod.build(pinched, cell_triangles=2000, root_triangles=200)
    assert any("not a manifold" in str(one) for one in hierarchy.diagnostics)
    whole = hierarchy.cut(max_shape=0.0).mesh
    np.testing.assert_array_equal(sort_triangle_corners(whole), sort_triangle_corners(pinched))


def make_textured_sheet() -> Mesh:
    """Make a sheet with an image of two columns, dark and light."""
    mesh = sheet(10).with_(colors=None)
    image = np.zeros((2, 2, 3), np.uint8)
    image[:, 1] = 200
    uvs = mesh.vertices[mesh.triangles][:, :, :2].copy()
    material = np.zeros(len(mesh.triangles), np.int32)
    return mesh.with_(texture=Texture(uvs, material, (Material(image=Image(given=image)),)))


def test_a_texture_becomes_colours_and_the_textured_mesh_is_stored(tmp_path: Path) -> None:
    mesh = make_textured_sheet()
    hierarchy = lod.build(mesh, cell_triangles=64, root_triangles=10)
    assert hierarchy.colors is not None
    assert hierarchy.colors.max() > 150
    assert hierarchy.diagnostics == ()
    lod.write_slod(tmp_path / "m.slod", hierarchy)
    model = lod.read_slod(tmp_path / "m.slod").model
    assert model is not None
    assert model.texture is not None
    assert mesh.texture is not None
    # Corners are stored in single precision.
    np.testing.assert_allclose(
        sort_triangle_corners(model), sort_triangle_corners(mesh), rtol=1e-6, atol=1e-7
    )
    np.testing.assert_array_equal(model.texture.images[0].pixels, mesh.texture.images[0].pixels)
    assert lod.build(sheet(10), cell_triangles=64).model is None


def test_a_model_at_a_damaged_file_end_is_dropped_with_a_diagnostic(tmp_path: Path) -> None:
    path = tmp_path / "m.slod"
    lod.write_slod(path, lod.build(make_textured_sheet(), cell_triangles=64, root_triangles=10))
    whole = path.read_bytes()
    for damaged in (whole[:-5], whole[:-50] + b"x" + whole[-49:]):
        path.write_bytes(damaged)
        hierarchy = lod.read_slod(path)
        assert hierarchy.model is None
        (diagnostic,) = hierarchy.diagnostics
        assert str(diagnostic) == (
            f"{path}: the textured mesh at the end of the file is damaged or truncated; vertex colours are "
            "used."
        )
        assert len(hierarchy.cut(max_shape=0.0).mesh.triangles) == hierarchy.input_triangles


def test_dropped_islands_are_not_in_the_stored_model() -> None:
    mesh = make_textured_sheet()
    assert mesh.texture is not None
    speck = np.array([(0, 0, 1), (0.001, 0, 1), (0, 0.001, 1)])
    triangles = np.concatenate([mesh.triangles, np.arange(3)[None] + len(mesh.vertices)]).astype(np.int32)
    texture = mesh.texture.select_triangles(np.append(np.arange(len(mesh.triangles)), 0))
    more = Mesh(np.concatenate([mesh.vertices, speck]), triangles, texture=texture)
    model = lod.build(more, cell_triangles=64, root_triangles=10, drop_islands=0.01).model
    assert model is not None
    assert len(model.triangles) == len(mesh.triangles)


def test_invalid_meshes_and_parameters_are_one_error() -> None:
    with pytest.raises(InputError, match="no triangles"):
        lod.build(Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)))
    with pytest.raises(UsageError, match="ratio"):
        lod.build(ball(), ratio=1.0)
    with pytest.raises(UsageError, match="first_error"):
        lod.build(ball(), first_error=0.0)


def test_a_single_triangle_is_a_hierarchy() -> None:
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32))
    hierarchy = lod.build(mesh)
    assert len(hierarchy.cut(triangles=1).mesh.triangles) == 1
    assert hierarchy.shape_bound[0] >= 0


def test_bounds_and_topology_hold_for_a_real_scan(shared_data: Path) -> None:
    mesh = read_mesh(shared_data / "meshes" / "stanford-bunny.obj")
    hierarchy = lod.build(mesh)
    random = np.random.default_rng(1)
    given = topology(mesh)
    for _ in range(20):
        assert (
            topology(hierarchy.mesh(*choose_random_front(hierarchy, random))).components == given.components
        )
    for node in random.choice(hierarchy.nodes, 5, replace=False):
        coarse, base = hierarchy.mesh([node], [0]), get_base_mesh(hierarchy, int(node))
        attack = max(
            measure_max_distance(sample_surface(coarse, 1000, 0), base),
            measure_max_distance(sample_surface(base, 1000, 0), coarse),
        )
        assert attack <= hierarchy.shape_bound[node] * (1 + 1e-9)
