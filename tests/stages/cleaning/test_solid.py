"""Solids: closed, manifold, outward and free of self-intersections, checked by trimesh and manifold3d."""

import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from scanloom import certify, check, clean, read_mesh, write_mesh
from scanloom.stages.cleaning.solid import make_solid
from scanloom.stages.cleaning.solids.booleans import trim_by_plane
from scanloom.stages.cleaning.solids.border_closing import BasePlane
from scanloom.stages.cleaning.solids.self_intersections import _rebuild, find_unsound
from scanloom.stages.cleaning.solids.shell import Shell
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import as_mesh
from scanloom.stages.surface.texture import Image, Material, Texture

manifold3d = pytest.importorskip("manifold3d")


def require_solid(mesh: Mesh, folder: Path) -> float:
    """Write a mesh, read it with other programs, and return its volume."""
    found = check(mesh)
    assert found.find_unmet(["watertight", "outward", "no-intersecting-triangles"]) == []
    write_mesh(folder / "solid.stl", mesh)
    read = trimesh.load(folder / "solid.stl")
    assert read.is_watertight
    assert read.is_volume
    library = manifold3d.Manifold(manifold3d.Mesh(np.float32(read.vertices), np.uint32(read.faces)))
    assert library.status() == manifold3d.Error.NoError
    assert library.volume() == pytest.approx(read.volume, rel=1e-4)
    return float(read.volume)


def cut_holes(mesh: Mesh, centers: np.ndarray, radius: float) -> Mesh:
    """Remove the triangles near some points."""
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    distances = np.linalg.norm(middle[:, None] - centers, axis=2).min(axis=1)
    return mesh.with_triangles(mesh.triangles[distances > radius], distances > radius)


def make_ball(radius: float = 1.0) -> Mesh:
    return as_mesh(trimesh.creation.icosphere(3, radius))


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**31), count=st.integers(1, 3), hole_count=st.integers(0, 3))
def test_unions_of_boxes_and_balls_with_holes_become_solid(tmp_path_factory, seed, count, hole_count):
    rng = np.random.default_rng(seed)
    parts, exact = [], []
    for _ in range(count):
        part = (
            trimesh.creation.icosphere(3, rng.uniform(0.5, 1))
            if rng.random() < 0.5
            else trimesh.creation.box(rng.uniform(0.6, 1.5, 3)).subdivide().subdivide().subdivide()
        )
        part.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
        part.apply_translation(rng.uniform(-0.5, 0.5, 3))
        parts.append(part)
        exact.append(manifold3d.Manifold(manifold3d.Mesh(np.float32(part.vertices), np.uint32(part.faces))))
    mesh = as_mesh(trimesh.util.concatenate(parts))
    holes = mesh.vertices[rng.integers(len(mesh.vertices), size=hole_count)]
    if hole_count:
        mesh = cut_holes(mesh, holes, 0.2)
        # Holes next to each other can leave a scrap between them, which is no object and is refused.
        assume(
            len(trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).split(only_watertight=False))
            <= count
        )
    solid = clean(mesh, solid=True, min_island_area=0)
    assert solid.diagnostics == ()
    volume = require_solid(solid.mesh, tmp_path_factory.mktemp("solid"))
    truth = manifold3d.Manifold.batch_boolean(exact, manifold3d.OpType.Add).volume()
    # A hole of radius 0.2 across an edge or corner of a box loses at most a few times r³.
    assert truth * 1.02 + 0.01 * hole_count > volume > truth * 0.98 - 0.03 * hole_count
    kept = solid.triangle_source >= 0
    result = solid.solid_result
    assert result.bound_m <= result.max_shape_m
    corners = solid.mesh.vertices[solid.mesh.triangles[kept]].reshape(-1, 3)
    loose = Mesh(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))
    bounds = certify(mesh, loose, max_shape=result.max_shape_m).original_shape_bound
    assert bounds.max() <= result.max_shape_m * 1.05


def test_an_object_is_closed_by_the_plane_on_which_it_stood(tmp_path):
    ball = make_ball()
    bowl = cut_holes(ball, np.array([[0, 0, -1.0]]), 0.7)
    solid = clean(bowl, solid=True)
    assert solid.solid_result.closing.base_borders == 1
    new = solid.vertex_source < 0
    assert np.ptp(solid.mesh.vertices[new, 2]) < 1e-9
    np.testing.assert_array_equal(solid.mesh.vertices[~new], bowl.vertices[solid.vertex_source[~new]])
    assert solid.solid_result.bound_m == 0
    assert require_solid(solid.mesh, tmp_path) == pytest.approx(solid.solid_result.volume_m3, rel=1e-5)


def test_the_base_has_the_thickness_of_walls(tmp_path):
    bowl = cut_holes(make_ball(), np.array([[0, 0, -1.0]]), 0.7)
    low = bowl.vertices[np.unique(bowl.triangles), 2].min()
    solid = clean(bowl, solid=True, wall=0.1)
    assert solid.mesh.vertices[:, 2].min() == pytest.approx(low - 0.1)
    require_solid(solid.mesh, tmp_path)


def test_a_hole_is_continued_smoothly(tmp_path):
    open_at_two = cut_holes(make_ball(), np.array([[0, 0, -1.0], [1.0, 0, 0]]), 0.3)
    solid = clean(open_at_two, solid=True)
    lengths = np.linalg.norm(solid.mesh.vertices, axis=1)
    assert solid.solid_result.closing.capped_borders >= 1
    assert lengths.max() < 1.05
    require_solid(solid.mesh, tmp_path)


def test_a_small_sheet_can_be_removed(tmp_path):
    ball = trimesh.creation.icosphere(3)
    cylinder = trimesh.creation.cylinder(
        0.1, 0.2, transform=trimesh.transformations.translation_matrix([3, 0, 0])
    )
    is_side = np.abs(cylinder.face_normals[:, 2]) < 0.5
    tube = trimesh.Trimesh(cylinder.vertices, cylinder.faces[is_side][:, ::-1])
    both = as_mesh(trimesh.util.concatenate([ball, tube]))
    with pytest.raises(MeshError, match=r"are 1\.0% of .*min_island_area to more than 0\.125 m²"):
        clean(both, solid=True, min_island_area=0.0)
    solid = clean(both, solid=True, min_island_area=0.126)
    assert require_solid(solid.mesh, tmp_path) == pytest.approx(4.15, rel=0.02)


def test_an_open_surface_needs_a_wall(tmp_path):
    grid = trimesh.creation.box((2, 2, 0.5)).subdivide().subdivide().subdivide()
    room = as_mesh(grid)
    # The inside of a box without lid.
    chosen = room.vertices[room.triangles].mean(axis=1)[:, 2] < 0.2499
    room = room.with_triangles(room.triangles[chosen][:, ::-1].copy(), chosen)
    with pytest.raises(MeshError, match=r"are 100\.0% of the surface.*set (clean\.)?wall"):
        clean(room, solid=True)
    solid = clean(room, solid=True, wall=0.1)
    assert solid.solid_result.closing.thickened_sheets == 1
    volume = require_solid(solid.mesh, tmp_path)
    assert volume == pytest.approx(2.2 * 2.2 * 0.6 - 2 * 2 * 0.5, rel=0.05)
    assert (solid.triangle_source >= 0).sum() == len(room.triangles)
    np.testing.assert_allclose(np.ptp(solid.mesh.vertices[:, 0]), 2.2, rtol=0.02)


def test_components_turn_outwards_except_cavities():
    outer, inner = make_ball(), make_ball(0.5)
    cavity = inner.with_(triangles=inner.triangles[:, ::-1].copy())
    aside = cavity.with_(vertices=inner.vertices + np.array([3.0, 0, 0]))
    count = len(inner.vertices)
    mesh = Mesh(
        np.concatenate([outer.vertices, cavity.vertices, aside.vertices]),
        np.concatenate(
            [
                outer.triangles,
                cavity.triangles + len(outer.vertices),
                aside.triangles + len(outer.vertices) + count,
            ]
        ),
    )
    solid = clean(mesh, solid=True)
    ball = trimesh.creation.icosphere(3).volume
    assert solid.solid_result.volume_m3 == pytest.approx(ball, rel=1e-6)


def test_colours_are_kept_and_continued():
    ball = make_ball()
    colors = np.where(ball.vertices[:, :1] < 0, (200, 30, 10), (10, 40, 220)).astype(np.uint8)
    bowl = cut_holes(ball.with_(colors=colors), np.array([[0, 0, -1.0]]), 0.7)
    solid = clean(bowl, solid=True)
    old = solid.vertex_source >= 0
    np.testing.assert_array_equal(solid.mesh.colors[old], bowl.colors[solid.vertex_source[old]])
    new = solid.mesh.vertices[~old, 0]
    red = solid.mesh.colors[~old, 0].astype(int)
    assert red[new < -0.4].min() > 150
    assert red[new > 0.4].max() < 60


def test_a_texture_is_kept_and_added_surface_gets_an_image():
    ball = make_ball()
    uvs = ball.vertices[ball.triangles][:, :, :2] / 4 + 0.5
    image = Image(given=np.full((64, 64, 3), (120, 60, 200), np.uint8))
    ids = np.zeros(len(ball.triangles), np.int32)
    bowl = cut_holes(
        ball.with_(texture=Texture(uvs, ids, (Material("skin", image),))), np.array([[0, 0, -1.0]]), 0.7
    )
    solid = clean(bowl, solid=True)
    texture, old = solid.mesh.texture, solid.triangle_source >= 0
    np.testing.assert_allclose(texture.uvs[old], bowl.texture.uvs[solid.triangle_source[old]], atol=1e-12)
    assert texture.materials[0].image is image
    assert (texture.material_ids[~old] == 1).all()
    pixels = texture.materials[1].image.pixels.reshape(-1, 3)
    assert {tuple(one) for one in pixels.tolist()} <= {(120, 60, 200), (0, 0, 0)}


def test_a_tangled_surface_is_rebuilt(tmp_path):
    ball = make_ball()
    rng = np.random.default_rng(3)
    tangled = ball.vertices + rng.normal(0, 0.05, ball.vertices.shape)
    shell = Shell(tangled, ball.triangles, np.arange(len(ball.triangles)))
    assert find_unsound(shell).any()
    rebuilt = _rebuild(shell, 0.05)
    assert not find_unsound(rebuilt).any()
    assert require_solid(rebuilt.mesh, tmp_path) == pytest.approx(
        trimesh.creation.icosphere(3).volume, rel=0.05
    )


def test_the_result_does_not_depend_on_the_run():
    boxes = trimesh.util.concatenate(
        [trimesh.creation.box(), trimesh.creation.box(transform=np.eye(4) + np.eye(4, k=3) * 0.3)]
    )
    one, other = (clean(as_mesh(boxes), solid=True).mesh for _ in range(2))
    np.testing.assert_array_equal(one.vertices, other.vertices)
    np.testing.assert_array_equal(one.triangles, other.triangles)
    assert one.vertices[:, 0].max() == pytest.approx(0.8)


def test_a_missing_library_is_one_message(monkeypatch):
    monkeypatch.setitem(sys.modules, "manifold3d", None)
    with pytest.raises(UsageError, match=r"requires manifold3d; install scanloom\[solid\]"):
        clean(make_ball(), solid=True)


def test_a_wall_without_solid_is_refused():
    with pytest.raises(UsageError, match="solid"):
        clean(make_ball(), wall=0.1)


@pytest.mark.parametrize(
    ("file", "wall"),
    [
        ("stanford-bunny.obj", 0),
        ("camelhead.off", 0),
        ("face.obj", 0),
        ("pirate.obj", 0.03),
        ("CesiumMilkTruck.glb", 0),
        ("sceaux_mvs_scene_mesh.ply", 0.2),
        ("textured_scans/can.glb", 2e-4),
        ("textured_scans/foot_polycam.glb", 0),
    ],
)
def test_real_meshes_become_solid(shared_data, tmp_path, file, wall):
    mesh = read_mesh(shared_data / "meshes" / file)
    solid = clean(mesh, solid=True, wall=wall)
    assert solid.diagnostics == ()
    assert require_solid(solid.mesh, tmp_path) > 0
    assert solid.solid_result.bound_m <= solid.solid_result.max_shape_m
    old = solid.vertex_source >= 0
    np.testing.assert_array_equal(solid.mesh.vertices[old], mesh.vertices[solid.vertex_source[old]])
    assert old.mean() > 0.4 or solid.solid_result.intersections == "rebuilt"


def test_a_trimmed_solid_ends_at_the_plane():
    ball = make_ball()
    normal = np.array([0.6, 0.0, 0.8])
    shell = Shell(ball.vertices, ball.triangles, np.arange(len(ball.triangles)))
    trimmed = trim_by_plane(shell, normal, 0.25)
    assert (trimmed.vertices @ normal).min() == pytest.approx(0.25)
    closed = trimesh.Trimesh(trimmed.vertices, trimmed.triangles, process=False)
    assert closed.is_watertight
    # A cap of a unit ball with the height 0.75.
    assert closed.volume == pytest.approx(np.pi * 0.75**2 * (3 - 0.75) / 3, rel=0.02)
    # Triangles know their source; the cut is added.
    heights = trimmed.vertices[trimmed.triangles] @ normal
    assert ((trimmed.source < 0) == (heights.max(axis=1) < 0.25 + 1e-9)).all()
    assert trim_by_plane(shell, normal, -1.5) is shell


def test_nothing_above_the_plane_is_one_message():
    with pytest.raises(MeshError, match="no volume"):
        make_solid(make_ball(), 0.0, None, BasePlane(np.array([0.0, 0.0, 1.0]), 5.0, 0.1))
