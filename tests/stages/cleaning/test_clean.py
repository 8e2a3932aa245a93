"""Cleaning turns any mesh into an oriented manifold with colours, and keeps most of its surface."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages.cleaning.clean import clean
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import to_open3d, to_trimesh
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.texture import Image, Material, Texture
from scanloom.stages.surface.topology import topology

MATERIALS = (Material("wood"), Material("stone", Image(given=np.ones((2, 2, 3), np.uint8))))


def make_grid(rows: int = 6, columns: int = 6, *, height: float = 0.0) -> Mesh:
    """Make unit squares in the plane z = height, each cut in two triangles, normals up."""
    y, x = np.mgrid[: rows + 1, : columns + 1]
    vertices = np.stack([x.ravel(), y.ravel(), np.full(x.size, height)], 1).astype(float)
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    triangles = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    colors = np.stack([x.ravel() * 20, y.ravel() * 20, np.full(x.size, 7)], 1).astype(np.uint8)
    return Mesh(vertices, triangles.astype(np.int32), colors)


def make_box(center=(0.0, 0.0, 0.0), size: float = 1.0) -> Mesh:
    corners = (np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3) - 0.5) * size
    triangles = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
                 (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]  # fmt: skip
    return Mesh(corners + center, np.array(triangles, np.int32))


def join_meshes(*meshes: Mesh) -> Mesh:
    offsets = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.triangles + o for m, o in zip(meshes, offsets, strict=False)]).astype(np.int32),
        None if meshes[0].colors is None else np.concatenate([m.colors for m in meshes]),
    )


def weld_vertices(mesh: Mesh) -> Mesh:
    vertices, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
    return Mesh(vertices, index.reshape(-1)[mesh.triangles].astype(np.int32))


def compute_area(mesh: Mesh) -> float:
    a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def compute_volume(mesh: Mesh) -> float:
    a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def assert_clean(mesh: Mesh) -> None:
    found = topology(mesh)
    assert found.is_manifold
    assert found.is_oriented
    assert found.degenerate == found.duplicate == found.unreferenced == 0


def assert_same(a: Mesh, b: Mesh) -> None:
    np.testing.assert_array_equal(a.vertices, b.vertices)
    np.testing.assert_array_equal(a.triangles, b.triangles)
    if a.colors is not None:
        np.testing.assert_array_equal(a.colors, b.colors)


def test_a_clean_mesh_is_unchanged():
    mesh = make_grid()
    result = clean(mesh)
    assert_same(result.mesh, mesh)
    assert result.vertex_source.tolist() == list(range(len(mesh.vertices)))
    assert not any(vars(result.changes).values())


def test_other_classes_are_accepted():
    mesh = make_grid()
    for other in (to_open3d(mesh), to_trimesh(mesh), (mesh.vertices, mesh.triangles)):
        np.testing.assert_array_equal(clean(other).mesh.triangles, mesh.triangles)


def test_islands_are_compared_with_the_largest_component():
    mesh = join_meshes(make_grid(40, 40), make_grid(1, 1, height=3.0), make_grid(2, 1, height=5.0))
    result = clean(mesh)
    assert (result.changes.islands, result.changes.island_triangles) == (1, 2)
    assert result.min_island_area == pytest.approx(1.6)
    assert topology(result.mesh).components == 2
    assert topology(clean(mesh, min_island_area=0.0).mesh).components == 3
    assert topology(clean(mesh, min_island_area=2.1).mesh).components == 1
    assert topology(clean(mesh, min_island_area=0.0, keep_largest=True).mesh).components == 1


def test_provenance_carries_any_attribute():
    mesh = join_meshes(make_grid(), make_grid(1, 1, height=3.0))
    result = clean(mesh, min_island_area=3.0)
    np.testing.assert_array_equal(result.mesh.vertices, mesh.vertices[result.vertex_source])
    np.testing.assert_array_equal(result.mesh.colors, mesh.colors[result.vertex_source])
    np.testing.assert_array_equal(
        result.vertex_source[result.mesh.triangles], mesh.triangles[result.triangle_source]
    )


def test_duplicates_and_unused_vertices_are_removed():
    mesh = make_grid()
    again = mesh.triangles[[3, 5]][:, [1, 2, 0]]
    over = mesh.triangles[[7]][:, ::-1]
    dirty = mesh.with_(
        vertices=np.vstack([mesh.vertices, [[5, 5, 5]]]),
        triangles=np.vstack([mesh.triangles, again, over]),
        colors=np.vstack([mesh.colors, np.array([[1, 2, 3]], np.uint8)]),
    )
    result = clean(dirty)
    assert_same(result.mesh, mesh)
    assert (result.changes.duplicate_triangles, result.changes.unused_vertices) == (3, 1)


def test_flipped_triangles_are_oriented_like_the_majority():
    mesh = make_grid()
    turned = mesh.triangles.copy()
    turned[::5] = turned[::5, ::-1]
    result = clean(mesh.with_(triangles=turned))
    assert_clean(result.mesh)
    assert result.changes.flipped_triangles == len(turned[::5])
    a, b, c = result.mesh.vertices[result.mesh.triangles].transpose(1, 0, 2)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_a_fin_becomes_a_separate_sheet():
    floor = make_grid(4, 4)
    top = floor.vertices[[11, 12, 13]] + np.array([0, 0, 1])
    vertices = np.vstack([floor.vertices, top])
    wall = [(11, 12, 25), (12, 26, 25), (12, 13, 26), (13, 27, 26)]
    result = clean((vertices, np.vstack([floor.triangles, wall])), min_island_area=0.0)
    assert_clean(result.mesh)
    found = topology(result.mesh)
    assert (found.components, found.boundary_loops) == (2, 2)  # the floor has no slit
    assert result.changes.split_vertices == 3
    assert result.changes.nonmanifold_triangles == 0
    assert compute_area(result.mesh) == pytest.approx(16 + 2)


def test_boxes_that_share_an_edge_are_separated():
    both = weld_vertices(join_meshes(make_box(), make_box((1.0, 1.0, 0.0))))
    assert topology(both).nonmanifold_edges == 1
    result = clean(both)
    found = topology(result.mesh)
    assert found.is_manifold
    assert found.is_closed
    assert compute_volume(result.mesh) == pytest.approx(2)


def test_a_bow_tie_is_split():
    mesh = join_meshes(make_box(), make_box((1.0, 1.0, 1.0)))
    result = clean(weld_vertices(mesh))
    assert_clean(result.mesh)
    assert (topology(result.mesh).components, result.changes.split_vertices) == (2, 1)


def make_moebius_strip(columns: int = 30, rows: int = 4) -> Mesh:
    u, v = np.meshgrid(np.arange(columns), np.arange(rows + 1), indexing="ij")
    angle, across = 2 * np.pi * u / columns, v / rows - 0.5
    radius = 2 + across * np.cos(angle / 2)
    vertices = np.stack([radius * np.cos(angle), radius * np.sin(angle), across * np.sin(angle / 2)], -1)
    triangles = []
    for i in range(columns):
        for j in range(rows):
            corners = []
            for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1)):
                column, row = i + di, j + dj
                if column == columns:
                    column, row = 0, rows - row
                corners.append(column * (rows + 1) + row)
            a, b, c, d = corners
            triangles += [(a, b, c), (a, c, d)]
    return Mesh(vertices.reshape(-1, 3), np.array(triangles, np.int32))


def test_a_moebius_strip_is_cut_from_border_to_border():
    mesh = make_moebius_strip()
    result = clean(mesh)
    assert_clean(result.mesh)
    assert (topology(mesh).euler, topology(result.mesh).euler) == (0, 1)
    assert compute_area(result.mesh) == pytest.approx(compute_area(mesh))
    assert result.changes.split_vertices == 5  # one cut from border to border
    scrambled = mesh.triangles.copy()
    scrambled[::3] = scrambled[::3, ::-1]
    again = clean(mesh.with_(triangles=scrambled))
    assert_clean(again.mesh)
    assert again.changes.split_vertices < 10


def test_needles_are_collapsed_without_a_crack():
    # The middle vertex is duplicated with two colours, with two needles between the copies.
    mesh = make_grid(2, 2)
    middle = 4
    triangles = mesh.triangles.copy()
    right = (mesh.vertices[triangles].mean(axis=1)[:, 0] > 1) & (triangles == middle).any(axis=1)
    triangles[right] = np.where(triangles[right] == middle, 9, triangles[right])
    needles = [(1, 9, middle), (7, middle, 9)]
    dirty = Mesh(
        np.vstack([mesh.vertices, mesh.vertices[middle]]),
        np.vstack([triangles, needles]).astype(np.int32),
        np.vstack([mesh.colors, np.array([[255, 0, 0]], np.uint8)]),
    )
    assert topology(dirty).degenerate == 2
    result = clean(dirty)
    assert_same(result.mesh, mesh)
    assert topology(result.mesh).boundary_loops == 1


@pytest.mark.parametrize("turned", [False, True])
def test_a_cap_is_removed_by_splitting_its_neighbour(turned):
    # 0 ── 3 ── 1 is straight: triangle (0, 1, 3) is flat and between (1, 0, 4) and the two above.
    vertices = np.array([[0, 0, 0], [2, 0, 0], [1, 1, 0], [1, 0, 0], [1, -1, 0]], float)
    triangles = np.array([(0, 3, 2), (3, 1, 2), (0, 1, 3), (1, 0, 4)])
    if turned:
        triangles[3] = triangles[3, ::-1]
    uvs = vertices[triangles][..., :2] / 2
    mesh = Mesh(vertices, triangles, texture=Texture(uvs, np.array([0, 0, 0, 1]), MATERIALS))
    result = clean(mesh)
    assert_clean(result.mesh)
    found = topology(result.mesh)
    assert (found.triangles, found.boundary_loops, found.euler) == (4, 1, 1)
    assert compute_area(result.mesh) == pytest.approx(2)
    # Texture coordinates equal plane coordinates, also at new corners.
    np.testing.assert_allclose(
        result.mesh.texture.uvs, result.mesh.vertices[result.mesh.triangles][..., :2] / 2
    )
    assert sorted(result.mesh.texture.material_ids.tolist()) == [0, 0, 1, 1]
    assert sorted(result.triangle_source.tolist()) == [0, 1, 3, 3]


def test_a_soup_of_triangles_is_stitched():
    mesh = make_box()
    soup = Mesh(mesh.vertices[mesh.triangles].reshape(-1, 3), np.arange(36, dtype=np.int32).reshape(-1, 3))
    result = clean(soup)
    assert topology(result.mesh).is_closed
    assert (len(result.mesh.vertices), result.changes.stitched_edges) == (8, 18)
    assert compute_volume(result.mesh) == pytest.approx(1)
    assert len(clean(soup, stitch=False).mesh.vertices) == 36


def test_welding_closes_cracks_from_rounding():
    rng = np.random.default_rng(0)
    mesh = make_box()
    corners = mesh.vertices[mesh.triangles].reshape(-1, 3) + rng.uniform(-1e-5, 1e-5, (36, 3))
    soup = Mesh(corners, np.arange(36, dtype=np.int32).reshape(-1, 3))
    assert topology(clean(soup).mesh).components == 12
    assert topology(clean(soup, weld_distance=1e-4).mesh).is_closed


def add_bumps(mesh: Mesh, seed: int = 0) -> Mesh:
    rng = np.random.default_rng(seed)
    vertices = mesh.vertices.copy()
    vertices[:, 2] += rng.uniform(-0.2, 0.2, len(vertices))
    return mesh.with_(vertices=vertices)


def test_holes_are_filled_up_to_a_length():
    mesh = add_bumps(make_grid(12, 12))
    centers = mesh.vertices[mesh.triangles].mean(axis=1)
    small = np.abs(centers[:, :2] - [3, 3]).max(axis=1) < 1
    large = np.abs(centers[:, :2] - [8, 8]).max(axis=1) < 2
    torn = mesh.with_(triangles=mesh.triangles[~(small | large)])
    assert topology(torn).boundary_loops == 3
    assert clean(torn).changes.filled_holes == 0
    one = clean(torn, fill_holes=12.0)
    assert (one.changes.filled_holes, topology(one.mesh).boundary_loops) == (1, 2)
    # However large the limit is, the outline of the sheet is not a hole.
    both = clean(torn, fill_holes=1e6)
    assert (both.changes.filled_holes, topology(both.mesh).boundary_loops) == (2, 1)
    for result in (one, both):
        assert_clean(result.mesh)
        fill = result.triangle_source < 0
        assert np.count_nonzero(fill) == result.changes.fill_triangles
        a, b, c = result.mesh.vertices[result.mesh.triangles[fill]].transpose(1, 0, 2)
        assert np.cross(b - a, c - a)[:, 2].sum() > 0
        np.testing.assert_array_equal(result.mesh.colors, torn.colors[result.vertex_source])


def test_filling_a_flat_rim_makes_no_flat_triangles():
    mesh = make_grid(6, 6)
    centers = mesh.vertices[mesh.triangles].mean(axis=1)
    torn = mesh.with_(triangles=mesh.triangles[np.abs(centers[:, :2] - [3, 3]).max(axis=1) > 1])
    result = clean(torn, fill_holes=100.0)
    assert_clean(result.mesh)
    assert result.changes.filled_holes == 1
    assert compute_area(result.mesh) == pytest.approx(36)


def test_open_box_is_closed():
    mesh = make_box()
    result = clean(mesh.with_(triangles=mesh.triangles[2:]), fill_holes=4.5)
    assert topology(result.mesh).is_closed
    assert compute_volume(result.mesh) == pytest.approx(1)


def test_a_single_triangle_is_no_hole():
    result = clean((np.eye(3), np.array([[0, 1, 2]])), fill_holes=100.0)
    assert len(result.mesh.triangles) == 1


def test_an_existing_diagonal_is_not_used_again():
    # An open box whose missing side has a triangle on each diagonal of its rim: a cap cannot use either
    # diagonal.
    mesh = make_box()
    ears = np.array([(0, 3, 8), (1, 2, 9)], np.int32)
    vertices = np.vstack([mesh.vertices, [[-1.5, 0.1, 0.0], [-1.5, -0.1, 0.0]]])
    result = clean((vertices, np.vstack([mesh.triangles[2:], ears])), min_island_area=0.0, fill_holes=100.0)
    assert_clean(result.mesh)


def test_normals_and_texture_stay_with_their_corners():
    mesh = join_meshes(make_grid(), make_grid(1, 1, height=3.0))
    rng = np.random.default_rng(0)
    texture = Texture(
        rng.random((len(mesh.triangles), 3, 2)),
        rng.integers(0, 2, len(mesh.triangles)).astype(np.int32),
        MATERIALS,
    )
    normals = np.tile([0.0, 0.0, 1.0], (len(mesh.vertices), 1))
    turned = mesh.triangles.copy()
    turned[4] = turned[4, ::-1]
    result = clean(mesh.with_(triangles=turned, normals=normals, texture=texture), min_island_area=3.0)
    assert result.mesh.normals.shape == result.mesh.vertices.shape
    for row, source in enumerate(result.triangle_source):
        for corner in range(3):
            vertex = result.vertex_source[result.mesh.triangles[row, corner]]
            old = turned[source].tolist().index(vertex)
            np.testing.assert_array_equal(result.mesh.texture.uvs[row, corner], texture.uvs[source, old])
        assert result.mesh.texture.material_ids[row] == texture.material_ids[source]


@pytest.mark.parametrize("triangles", [np.zeros((0, 3), int), np.array([[0, 0, 1]]), np.array([[0, 1, 2]])])
def test_an_empty_result_is_an_error(triangles):
    with pytest.raises(MeshError, match="nothing is left"):
        clean(([[0, 0, 0], [1, 0, 0], [2, 0, 0]], triangles))


def test_wrong_parameters():
    with pytest.raises(UsageError, match="min_island_area"):
        clean(make_grid(), min_island_area=-1.0)
    with pytest.raises(UsageError, match="min_area"):
        clean(make_grid(), min_area=1.0)


def test_an_edge_with_very_many_triangles_is_fast():
    count = 20_000
    ring = np.linspace(0, 2 * np.pi, count, endpoint=False)
    vertices = np.vstack([[[0, 0, 0], [0, 0, 1]], np.stack([np.cos(ring), np.sin(ring), ring], 1)])
    triangles = np.stack([np.zeros(count), np.ones(count), np.arange(2, count + 2)], 1).astype(int)
    result = clean((vertices, triangles), min_island_area=0.0)
    assert_clean(result.mesh)
    assert len(result.mesh.triangles) == count


def test_progress_reaches_its_end():
    calls = []
    clean(make_grid(), progress=lambda done, total: calls.append((done, total)))
    assert calls[0][0] == 0
    assert calls[-1][0] == calls[-1][1]
    assert calls == sorted(calls)


points = st.lists(st.tuples(*[st.integers(0, 2)] * 3), min_size=3, max_size=9)


@st.composite
def soups(draw):
    vertices = np.array(draw(points), float)
    index = st.integers(0, len(vertices) - 1)
    triangles = np.array(draw(st.lists(st.tuples(index, index, index), min_size=1, max_size=24)))
    colors = np.arange(len(vertices) * 3).reshape(-1, 3).astype(np.uint8)
    return Mesh(vertices, triangles, colors)


def clean_or_none(mesh: Mesh, **changes):
    if len(np.unique(mesh.vertices, axis=0)) < 3:
        return None
    try:
        return clean(mesh, min_island_area=0.0, **changes)
    except MeshError:  # every triangle is flat
        return None


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(soups(), st.booleans())
def test_any_soup_becomes_an_oriented_manifold(mesh, stitch):
    result = clean_or_none(mesh, stitch=stitch)
    if result is None:
        return
    assert_clean(result.mesh)
    np.testing.assert_array_equal(result.mesh.vertices, mesh.vertices[result.vertex_source])
    np.testing.assert_array_equal(result.mesh.colors, mesh.colors[result.vertex_source])
    again = clean(result.mesh, min_island_area=0.0, stitch=stitch)
    assert_clean(again.mesh)
    assert_same(again.mesh, result.mesh)


@settings(deadline=None)
@given(soups())
def test_any_soup_can_be_filled(mesh):
    result = clean_or_none(mesh, fill_holes=100.0)
    if result is not None:
        assert_clean(result.mesh)


@settings(deadline=None)
@given(soups())
def test_surface_is_split_rather_than_removed(mesh):
    result = clean_or_none(mesh, stitch=False)
    if result is None or result.changes.degenerate_triangles or result.changes.nonmanifold_triangles:
        return
    once = mesh.with_(triangles=np.unique(np.sort(mesh.triangles, axis=1), axis=0))
    assert compute_area(result.mesh) == pytest.approx(compute_area(once))


@settings(deadline=None)
@given(soups())
def test_the_same_input_gives_the_same_bytes(mesh):
    one, two = clean_or_none(mesh), clean_or_none(mesh)
    assert (one is None) == (two is None)
    if one is not None and two is not None:
        assert one.mesh.vertices.tobytes() == two.mesh.vertices.tobytes()
        assert one.mesh.triangles.tobytes() == two.mesh.triangles.tobytes()


REAL = ["cow.obj", "stanford-bunny.obj", "camelhead.off", "pirate.obj", "CesiumMilkTruck.glb",
        "redkitchen_fused_vertexcolor.ply", "spot/spot_triangulated.obj", "colored_airplane.ply"]  # fmt: skip


@pytest.mark.parametrize("name", REAL)
def test_real_meshes(shared_data, name):
    import trimesh

    mesh = read_mesh(shared_data / "meshes" / name)
    result = clean(mesh, min_island_area=0.0)
    assert_clean(result.mesh)
    theirs = trimesh.Trimesh(result.mesh.vertices, result.mesh.triangles, process=False)
    assert theirs.is_winding_consistent
    assert theirs.euler_number == topology(result.mesh).euler
    assert compute_area(result.mesh) == pytest.approx(compute_area(mesh), rel=1e-9)
    assert_same(clean(result.mesh, min_island_area=0.0).mesh, result.mesh)
    if mesh.colors is not None:
        np.testing.assert_array_equal(result.mesh.colors, mesh.colors[result.vertex_source])


def test_a_real_scan_loses_only_its_islands(shared_data):
    mesh = read_mesh(shared_data / "meshes" / "redkitchen_fused_vertexcolor.ply")
    result = clean(mesh)
    assert topology(result.mesh).components < 20
    assert compute_area(result.mesh) > 0.99 * compute_area(mesh)
