"""Conversions to and from Open3D and trimesh keep everything that the classes can represent."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from random_meshes import varied_meshes

from scanloom.stages.diagnostics.collector import DiagnosticWarning, collecting
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.surface import mesh_conversion
from scanloom.stages.surface.codes import MESH_CONVERSION_LOSS
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.surface_color import compute_surface_colors
from scanloom.stages.surface.texture import Image, Material, Texture


def random_mesh(seed: int = 0, *, normals: bool = True) -> Mesh:
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(300, 3))
    return Mesh(
        vertices=rng.normal(size=(300, 3)) * 1e3,
        triangles=rng.integers(0, 300, (500, 3)).astype(np.int32),
        colors=np.arange(900).reshape(300, 3).astype(np.uint8),
        normals=directions / np.linalg.norm(directions, axis=1, keepdims=True) if normals else None,
    )


def add_texture(mesh: Mesh, images: int = 1) -> Mesh:
    rng = np.random.default_rng(1)
    count = len(mesh.triangles)
    texture = Texture(
        uvs=rng.random((count, 3, 2)),
        material_ids=rng.integers(0, images, count).astype(np.int32),
        materials=tuple(
            Material(image=Image(given=rng.integers(0, 256, (5, 7, 3)).astype(np.uint8)))
            for _ in range(images)
        ),
    )
    return mesh.with_(texture=texture)


def assert_same(actual: Mesh, expected: Mesh) -> None:
    for name in ("vertices", "triangles", "colors", "normals"):
        a, b = getattr(actual, name), getattr(expected, name)
        if b is None:
            assert a is None
            continue
        assert a.dtype == b.dtype, name
        np.testing.assert_array_equal(a, b, err_msg=name)
    if expected.texture is None:
        assert actual.texture is None
    else:
        assert actual.texture is not None
        np.testing.assert_array_equal(actual.texture.uvs, expected.texture.uvs)
        np.testing.assert_array_equal(actual.texture.material_ids, expected.texture.material_ids)
        for a, b in zip(actual.texture.images, expected.texture.images, strict=True):
            np.testing.assert_array_equal(a.pixels, b.pixels)


WAYS = (mesh_conversion.to_open3d, mesh_conversion.to_open3d_legacy, mesh_conversion.to_trimesh)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("normals", [True, False])
def test_round_trip_is_exact(way, normals):
    mesh = random_mesh(normals=normals)
    assert_same(mesh_conversion.as_mesh(way(mesh)), mesh)
    bare = Mesh(mesh.vertices, mesh.triangles)
    assert_same(mesh_conversion.as_mesh(way(bare)), bare)


@pytest.mark.parametrize("way", WAYS)
def test_a_mesh_without_triangles_survives(way):
    cloud = Mesh(np.eye(3), np.zeros((0, 3), np.int32))
    assert_same(mesh_conversion.as_mesh(way(cloud)), cloud)


def test_texture_survives_open3d():
    one = add_texture(random_mesh())
    assert_same(mesh_conversion.as_mesh(mesh_conversion.to_open3d(one)), one)
    three = add_texture(random_mesh(), images=3)
    assert_same(mesh_conversion.as_mesh(mesh_conversion.to_open3d_legacy(three)), three)


def test_trimesh_keeps_each_corner_of_a_texture():
    mesh = add_texture(random_mesh()).with_(colors=None)
    back = mesh_conversion.as_mesh(mesh_conversion.to_trimesh(mesh))
    np.testing.assert_array_equal(back.vertices[back.triangles], mesh.vertices[mesh.triangles])
    np.testing.assert_array_equal(back.normals[back.triangles], mesh.normals[mesh.triangles])
    np.testing.assert_array_equal(back.texture.uvs, mesh.texture.uvs)
    np.testing.assert_array_equal(back.texture.images[0].pixels, mesh.texture.images[0].pixels)


def test_texture_rows_agree_with_the_open3d_reader(shared_data):
    from scanloom.stages._open3d import import_open3d
    from scanloom.stages.surface.formats.texture_files import read_texture

    folder = shared_data / "meshes" / "fuze"
    image = read_texture(folder / "fuze.obj", "fuze uv.jpg").pixels
    read = import_open3d().io.read_triangle_mesh(str(folder / "fuze.obj"), True)
    np.testing.assert_array_equal(mesh_conversion.as_mesh(read).texture.images[0].pixels, image)
    # Before 0.20, Open3D's tensor reader ignores textures of OBJ files.
    if tuple(map(int, import_open3d().__version__.split(".")[:2])) < (0, 20):
        return
    read = import_open3d().t.io.read_triangle_mesh(str(folder / "fuze.obj"))
    np.testing.assert_array_equal(mesh_conversion.as_mesh(read).texture.images[0].pixels, image)


def test_conversion_copies():
    mesh = random_mesh()
    other = mesh_conversion.to_open3d(mesh)
    other.vertex.positions[:] = 0
    assert mesh.vertices.any()
    legacy = mesh_conversion.to_open3d_legacy(mesh)
    back = mesh_conversion.as_mesh(legacy)
    legacy.clear()
    assert_same(back, mesh)


def test_pairs_of_arrays():
    mesh = mesh_conversion.as_mesh(([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
    assert mesh.vertices.dtype == np.float64
    assert mesh.triangles.dtype == np.int32


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        ("mesh.ply", "is a str"),
        (None, "is a NoneType"),
        ((np.zeros((3, 2)), np.zeros((1, 3), int)), "n × 3"),
        ((np.zeros((3, 3)), np.array([[0, 1, 3]])), "triangle 0 uses vertices"),
        ((np.full((3, 3), np.nan), np.array([[0, 1, 2]])), "not finite"),
        (
            Mesh(np.eye(3), np.array([[0, 1, 2]]), texture=Texture(np.zeros((2, 3, 2)), np.zeros(2), ())),
            "2 × 3",
        ),
        (
            Mesh(np.eye(3), np.array([[0, 1, 2]]), texture=Texture(np.zeros((1, 3, 2)), np.zeros(1), ())),
            "0 texture",
        ),
    ],
)
def test_objects_that_are_not_meshes_are_refused(data, sentence):
    with pytest.raises(MeshError, match=sentence):
        mesh_conversion.as_mesh(data)


def test_nothing_heavy_is_imported_for_a_mesh():
    code = (
        "import sys, numpy as np; from scanloom.stages.surface.mesh_conversion import as_mesh;"
        "as_mesh((np.eye(3), np.array([[0, 1, 2]])));"
        "assert not {'open3d', 'trimesh', 'cv2', 'scipy'} & set(sys.modules), 'heavy'"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_vertex_colors_from_texture_read_pixel_centres():
    image = np.array([[[10, 0, 0], [20, 0, 0]], [[30, 0, 0], [40, 0, 0]]], np.uint8)
    # Centres of the upper left, upper right and lower left pixel, then the centre of the image.
    uvs = np.array([[[0.25, 0.75], [0.75, 0.75], [0.25, 0.25]], [[0.5, 0.5], [0.5, 0.5], [1.25, -0.25]]])
    mesh = Mesh(
        np.eye(7)[:, :3],
        np.array([[0, 1, 2], [3, 4, 5]], np.int32),
        texture=Texture(uvs, np.zeros(2, np.int32), (Material(image=Image(given=image)),)),
    )
    colored = mesh_conversion.bake_vertex_colors(mesh)
    assert colored.texture is None
    assert colored.colors[:, 0].tolist() == [10, 20, 30, 25, 25, 10, 128]


def test_vertices_without_texture_keep_their_colours():
    mesh = add_texture(random_mesh())
    texture = Texture(mesh.texture.uvs, np.full(len(mesh.triangles), -1, np.int32), mesh.texture.materials)
    np.testing.assert_array_equal(
        mesh_conversion.bake_vertex_colors(mesh.with_(texture=texture)).colors, mesh.colors
    )
    plain = random_mesh()
    assert mesh_conversion.bake_vertex_colors(plain) is plain


def test_face_colours_are_reported():
    import trimesh

    mesh = trimesh.creation.box()
    mesh.visual.face_colors = [255, 0, 0, 255]
    converted = mesh_conversion.as_mesh(mesh)
    assert converted.colors is None
    assert str(converted.diagnostics[0]).startswith("mesh: face colours are left out")


def convert_and_back(way, mesh: Mesh) -> tuple[Mesh, str]:
    """Convert a mesh and back; return the text of the warning about losses as well."""
    with collecting() as found:
        back = mesh_conversion.as_mesh(way(mesh))
    losses = [str(one) for one in found if one.code == MESH_CONVERSION_LOSS.name]
    assert len(losses) <= 1
    return back, "".join(losses)


def test_a_loss_that_nobody_collects_is_a_python_warning():
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32), up=(0.0, 0.0, 1.0))
    with pytest.warns(
        DiagnosticWarning, match="cannot hold the up direction of this mesh: left out. Pass the Mesh"
    ):
        mesh_conversion.to_open3d_legacy(mesh)


def assert_same_texture(back: Texture | None, given: Texture | None, *, exact: bool) -> None:
    """Check that each triangle has its coordinates, image and colour; with `exact` also tints."""
    if given is None:
        assert back is None
        return
    assert back is not None
    np.testing.assert_array_equal(back.uvs, given.uvs)
    no_material = Material()
    for row, (was, now) in enumerate(zip(given.material_ids, back.material_ids, strict=True)):
        before = given.materials[was] if was >= 0 else no_material
        after = back.materials[now] if now >= 0 else no_material
        assert (before.image is None) == (after.image is None), row
        if before.image is not None and (exact or before.base_color is None):
            np.testing.assert_array_equal(after.image.pixels, before.image.pixels)
        if exact or before.image is None:
            assert (before.base_color is None) == (after.base_color is None), row
            if before.base_color is not None:
                np.testing.assert_allclose(after.base_color, before.base_color, atol=1e-7)


@given(varied_meshes())
@settings(max_examples=150, deadline=None)
def test_trimesh_keeps_all_attributes(mesh):
    back, loss = convert_and_back(mesh_conversion.to_trimesh, mesh)
    assert loss == ""
    for name in ("vertices", "triangles", "colors", "normals", "corner_normals", "part_ids"):
        np.testing.assert_array_equal(getattr(back, name), getattr(mesh, name), err_msg=name)
    assert back.part_names == mesh.part_names
    assert back.up == mesh.up
    assert_same_texture(back.texture, mesh.texture, exact=True)
    if mesh.texture is not None:
        held = [image.encoded for image in mesh.texture.images]
        assert [image.encoded for image in back.texture.images] == held


@given(varied_meshes())
@settings(max_examples=100, deadline=None)
def test_open3d_keeps_all_except_names_and_up_direction(mesh):
    back, loss = convert_and_back(mesh_conversion.to_open3d, mesh)
    assert_same(back.with_(texture=None), mesh.with_(texture=None))
    np.testing.assert_array_equal(back.corner_normals, mesh.corner_normals)
    np.testing.assert_array_equal(back.part_ids, mesh.part_ids)
    assert ("part names" in loss) == bool(mesh.part_names)
    assert ("the up direction" in loss) == (mesh.up is not None)
    assert_same_texture(back.texture, mesh.texture, exact=True)


@given(varied_meshes())
@settings(max_examples=100, deadline=None)
def test_open3d_legacy_keeps_shape_colours_and_images(mesh):
    back, loss = convert_and_back(mesh_conversion.to_open3d_legacy, mesh)
    assert_same(back.with_(texture=None), mesh.with_(texture=None))
    assert ("corner normals" in loss) == (mesh.corner_normals is not None)
    assert ("parts" in loss) == (mesh.part_ids is not None)
    assert ("the up direction" in loss) == (mesh.up is not None)
    assert_same_texture(back.texture, mesh.texture, exact=False)


@pytest.mark.parametrize("way", WAYS)
def test_visible_colours_of_materials_are_kept(way):
    # An image times a base colour, a base colour alone, and an untextured part, like in any viewer.
    rng = np.random.default_rng(3)
    mesh = add_texture(random_mesh(normals=False), images=2)
    image = mesh.texture.images[0]
    materials = (
        Material(image=image, base_color=(0.2, 0.6, 1.0, 1.0)),
        Material(base_color=(1.0, 0.4, 0.2, 1.0)),
    )
    ids = rng.integers(-1, 2, len(mesh.triangles)).astype(np.int32)
    mesh = mesh.with_(colors=None, texture=Texture(mesh.texture.uvs, ids, materials))
    triangles = np.arange(len(mesh.triangles))
    weights = rng.dirichlet((1, 1, 1), len(triangles))
    back, _ = convert_and_back(way, mesh)
    # The legacy class multiplies before interpolating between pixels.
    tolerance = 6.0 if way is mesh_conversion.to_open3d_legacy else 0.01
    expected = compute_surface_colors(mesh, triangles, weights)
    np.testing.assert_allclose(compute_surface_colors(back, triangles, weights), expected, atol=tolerance)


@pytest.mark.parametrize(
    ("way", "lost"),
    [
        (mesh_conversion.to_open3d, ("material names", "wrap modes", "shading properties")),
        (mesh_conversion.to_open3d_legacy, ("material names", "wrap modes", "shading properties")),
        (mesh_conversion.to_trimesh, ()),
    ],
)
def test_other_material_properties_are_kept_or_reported(way, lost):
    mesh = add_texture(random_mesh())
    image = mesh.texture.images[0]
    told = Material("wood", image, wrap=("clamp", "mirror"), kept={"metallic": 0.5})
    mesh = mesh.with_(texture=Texture(mesh.texture.uvs, mesh.texture.material_ids, (told,)))
    back, loss = convert_and_back(way, mesh)
    assert all(name in loss for name in lost)
    if not lost:
        assert loss == ""
        (material,) = back.texture.materials
        assert (material.name, material.wrap, material.kept) == (told.name, told.wrap, told.kept)


def test_legacy_images_keep_their_material_behind_an_empty_one():
    # Open3D's OBJ reader gives an empty image to a material without one.
    mesh = add_texture(random_mesh(), images=2)
    bare = (Material(), mesh.texture.materials[1])
    mesh = mesh.with_(texture=Texture(mesh.texture.uvs, mesh.texture.material_ids, bare))
    back = mesh_conversion.as_mesh(mesh_conversion.to_open3d_legacy(mesh))
    is_second = mesh.texture.material_ids == 1
    assert is_second.any()
    assert {
        back.texture.materials[index].image is None for index in back.texture.material_ids[is_second]
    } == {False}
    assert all(back.texture.materials[index].image is None for index in back.texture.material_ids[~is_second])


def test_trimesh_seams_stay_open_where_a_copy_was_moved():
    mesh = add_texture(random_mesh(normals=False)).with_(colors=None)
    other = mesh_conversion.to_trimesh(mesh)
    moved = np.array(other.vertices)
    moved[0] += 1
    other.vertices = moved
    back = mesh_conversion.as_mesh(other)
    np.testing.assert_array_equal(back.vertices, moved)


def test_foreign_trimesh_attributes_are_not_parts():
    import trimesh

    box = trimesh.creation.box()
    box.face_attributes["part_index"] = np.arange(12)
    box.metadata["up"] = "y"
    back = mesh_conversion.as_mesh(box)
    assert back.part_ids is None
    assert back.up is None


def test_colours_and_materials_read_by_trimesh_are_converted(tmp_path):
    import trimesh

    # A GLB file written by trimesh: vertex colours together with a texture, and a material without image.
    mesh = add_texture(random_mesh(normals=False))
    mesh_conversion.to_trimesh(mesh).export(tmp_path / "both.glb")
    (read,) = trimesh.load_scene(tmp_path / "both.glb", process=False).geometry.values()
    assert mesh_conversion.as_mesh(read).colors is not None
    flat = trimesh.creation.box()
    flat.visual = trimesh.visual.TextureVisuals(
        material=trimesh.visual.material.PBRMaterial(baseColorFactor=[255, 0, 0, 255])
    )
    texture = mesh_conversion.as_mesh(flat).texture
    assert texture.materials[0].base_color == (1.0, 0.0, 0.0, 1.0)
    assert (texture.material_ids == 0).all()


def test_additional_trimesh_images_are_reported():
    import trimesh
    from PIL.Image import fromarray

    image = fromarray(np.full((4, 4, 3), 9, np.uint8))
    box = trimesh.creation.box()
    box.visual = trimesh.visual.TextureVisuals(
        uv=np.random.default_rng(0).random((len(box.vertices), 2)),
        material=trimesh.visual.material.PBRMaterial(baseColorTexture=image, normalTexture=image),
    )
    assert any("normalTexture" in one.message for one in mesh_conversion.as_mesh(box).diagnostics)


def test_transparent_vertex_colours_are_reported():
    import trimesh

    box = trimesh.creation.box()
    box.visual.vertex_colors = np.full((len(box.vertices), 4), 100, np.uint8)
    assert any("transparency" in one.message for one in mesh_conversion.as_mesh(box).diagnostics)
