"""Thickening of thin walls: printable afterwards, close to the solid, with its colours."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom import check, clean, read_mesh, write_mesh
from scanloom.stages.cleaning.solids.thickening import _MAX_SAMPLES, _RADIUS_RATIO
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import as_mesh
from scanloom.stages.surface.texture import Image, Material, Texture

manifold3d = pytest.importorskip("manifold3d")


def make_box(size, divisions: int = 3) -> trimesh.Trimesh:
    box = trimesh.creation.box(size)
    for _ in range(divisions):
        box = box.subdivide()
    return box


def to_manifold(mesh: Mesh):
    return manifold3d.Manifold(
        manifold3d.Mesh64(np.ascontiguousarray(mesh.vertices), mesh.triangles.astype(np.uint64))
    )


def require_thick(mesh: Mesh, limit: float, folder) -> trimesh.Trimesh:
    """Check a mesh, also after writing it in single precision, and return what trimesh reads."""
    write_mesh(folder / "thick.stl", mesh)
    for one in (mesh, read_mesh(folder / "thick.stl")):
        assert check(one, min_thickness=limit).find_unmet(["printable"]) == []
    read = trimesh.load(folder / "thick.stl")
    assert read.is_volume
    return read


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_thin_parts_of_random_solids_become_thick(tmp_path_factory, seed):
    rng = np.random.default_rng(seed)
    limit = rng.uniform(0.1, 0.2)
    parts = [trimesh.creation.icosphere(3, 0.4)]
    for _ in range(rng.integers(1, 4)):
        # Plates, rods and needles, down to a tenth of the limit.
        size = rng.uniform(0.1, 1.5, 3) * np.where(rng.random(3) < 0.5, limit, 1)
        parts.append(make_box(size, 2))
        parts[-1].apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
        parts[-1].apply_translation(rng.uniform(-0.5, 0.5, 3))
    mesh = as_mesh(trimesh.util.concatenate(parts))
    thin = clean(mesh, solid=True, min_island_area=0)
    thick = clean(mesh, solid=True, min_island_area=0, min_thickness=limit)
    assert thick.diagnostics == ()
    require_thick(thick.mesh, limit, tmp_path_factory.mktemp("thick"))
    # Material is only added, except where holes are refilled.
    missing = to_manifold(thin.mesh) - to_manifold(thick.mesh)
    assert missing.volume() <= 1e-3 * thin.solid_result.volume_m3
    result = thick.solid_result
    assert result.bound_m <= result.max_shape_m
    assert result.thickened_max_m <= limit


def test_a_plate_gets_the_thickness_on_both_sides(tmp_path):
    plate = as_mesh(make_box((1, 0.6, 0.02)))
    solid = clean(plate, solid=True, min_thickness=0.1)
    assert solid.diagnostics == ()
    found = require_thick(solid.mesh, 0.1, tmp_path)
    np.testing.assert_allclose(found.extents[2], 0.1 * _RADIUS_RATIO, rtol=0.01)
    np.testing.assert_allclose(found.bounds.mean(axis=0), 0, atol=0.005)
    # Its rim is rounded, and extends by less than half the thickness.
    assert (found.extents[:2] - (1, 0.6) < 0.1).all()
    assert 0.04 * 0.9 < solid.solid_result.thickened_max_m < 0.055


def test_a_sharp_edge_is_rounded(tmp_path):
    wedge = trimesh.creation.extrude_triangulation(
        np.array([[0, 0], [1, -0.15], [1, 0.15]]), np.array([[0, 1, 2]]), 0.5
    )
    for _ in range(4):
        wedge = wedge.subdivide()
    solid = clean(as_mesh(wedge), solid=True, min_thickness=0.1)
    assert solid.diagnostics == ()
    assert require_thick(solid.mesh, 0.1, tmp_path).volume > wedge.volume
    assert solid.solid_result.thickened_max_m < 0.06


def test_the_rest_of_the_surface_stays_exactly():
    ball, fin = trimesh.creation.icosphere(3, 0.5), make_box((1.6, 0.4, 0.02))
    mesh = as_mesh(trimesh.util.concatenate([ball, fin]))
    solid = clean(mesh, solid=True, min_thickness=0.06)
    assert solid.diagnostics == ()
    far = np.flatnonzero(np.abs(ball.vertices[:, 2]) > 0.2)
    kept = np.unique(solid.vertex_source[solid.vertex_source >= 0])
    assert np.isin(far, kept).all()
    old = solid.vertex_source >= 0
    np.testing.assert_array_equal(solid.mesh.vertices[old], mesh.vertices[solid.vertex_source[old]])
    # Refilled holes reach one ring of triangles farther than the fin.
    added = solid.mesh.vertices[solid.mesh.triangles[solid.triangle_source < 0]].reshape(-1, 3)
    assert np.abs(added[:, 2]).max() < 0.2
    assert solid.solid_result.thickened_max_m < 0.06


def test_a_thick_solid_does_not_change():
    ball = as_mesh(trimesh.creation.icosphere(3))
    one, other = clean(ball, solid=True), clean(ball, solid=True, min_thickness=0.5)
    np.testing.assert_array_equal(one.mesh.vertices, other.mesh.vertices)
    np.testing.assert_array_equal(one.mesh.triangles, other.mesh.triangles)
    assert other.solid_result.thickened_area_m2 == other.solid_result.thickened_max_m == 0


def test_added_surface_has_the_colours_of_its_side():
    plate = as_mesh(make_box((1, 0.6, 0.02)))
    colors = np.where(plate.vertices[:, 2:] < 0, (200, 30, 10), (10, 40, 220)).astype(np.uint8)
    solid = clean(plate.with_(colors=colors), solid=True, min_thickness=0.1)
    height = solid.mesh.vertices[:, 2]
    assert (solid.mesh.colors[height > 0.04] == (10, 40, 220)).all()
    assert (solid.mesh.colors[height < -0.04] == (200, 30, 10)).all()


def test_added_surface_of_a_textured_solid_is_marked():
    plate = as_mesh(make_box((1, 0.6, 0.02)))
    uvs = plate.vertices[plate.triangles][:, :, :2] / 4 + 0.5
    image = Image(given=np.full((64, 64, 3), (120, 60, 200), np.uint8))
    ids = np.zeros(len(plate.triangles), np.int32)
    textured = plate.with_(texture=Texture(uvs, ids, (Material("skin", image),)))
    solid = clean(textured, solid=True, min_thickness=0.1)
    added = solid.triangle_source < 0
    texture = solid.mesh.texture
    assert added.any()
    assert {texture.materials[row].name for row in texture.material_ids[added]} == {"added"}
    pixels = texture.materials[-1].image.pixels.reshape(-1, 3)
    assert {tuple(one) for one in pixels.tolist()} <= {(120, 60, 200), (0, 0, 0)}


def test_the_result_does_not_depend_on_the_run():
    mesh = as_mesh(trimesh.util.concatenate([trimesh.creation.icosphere(2, 0.3), make_box((1, 1, 0.03))]))
    one, other = (clean(mesh, solid=True, min_thickness=0.1).mesh for _ in range(2))
    np.testing.assert_array_equal(one.vertices, other.vertices)
    np.testing.assert_array_equal(one.triangles, other.triangles)


def test_walls_too_large_for_their_thickness_are_one_message():
    plate = as_mesh(make_box((1, 1, 0.0001)))
    assert _MAX_SAMPLES * 0.0002**2 / 200 < 1
    solid = clean(plate, solid=True, min_thickness=0.0002)
    assert [one.code for one in solid.diagnostics] == ["clean.solid-thin"]
    np.testing.assert_allclose(np.ptp(solid.mesh.vertices, axis=0), (1, 1, 0.0001))


def test_a_minimum_thickness_without_solid_is_refused():
    with pytest.raises(UsageError, match="solid"):
        clean(as_mesh(make_box((1, 1, 1))), min_thickness=0.1)


@pytest.mark.parametrize(
    ("file", "wall", "limit"),
    [("ycb_banana/textured_simple_reoriented.obj", 0, 0.005), ("camelhead.off", 0, 0.01)],
)
def test_real_meshes_become_thick(shared_data, tmp_path, file, wall, limit):
    mesh = read_mesh(shared_data / "meshes" / file)
    assert check(clean(mesh, solid=True, wall=wall).mesh, min_thickness=limit).find_unmet(["printable"])
    solid = clean(mesh, solid=True, wall=wall, min_thickness=limit)
    assert solid.diagnostics == ()
    require_thick(solid.mesh, limit, tmp_path)
    assert solid.solid_result.thickened_max_m < limit
    old = solid.vertex_source >= 0
    np.testing.assert_array_equal(solid.mesh.vertices[old], mesh.vertices[solid.vertex_source[old]])
