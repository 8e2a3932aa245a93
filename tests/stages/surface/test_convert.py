"""Conversions to and from Open3D and trimesh lose nothing the classes can hold."""

import subprocess
import sys

import numpy as np
import pytest

from stages.errors import MeshError
from stages.surface import convert
from stages.surface.mesh import Mesh
from stages.surface.texture import Image, Material, Texture


def random_mesh(seed: int = 0, *, normals: bool = True) -> Mesh:
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(300, 3))
    return Mesh(
        vertices=rng.normal(size=(300, 3)) * 1e3,
        triangles=rng.integers(0, 300, (500, 3)).astype(np.int32),
        colors=np.arange(900).reshape(300, 3).astype(np.uint8),
        normals=directions / np.linalg.norm(directions, axis=1, keepdims=True) if normals else None,
    )


def textured(mesh: Mesh, images: int = 1) -> Mesh:
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


WAYS = (convert.to_open3d, convert.to_open3d_legacy, convert.to_trimesh)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("normals", [True, False])
def test_round_trip_is_exact(way, normals):
    mesh = random_mesh(normals=normals)
    assert_same(convert.as_mesh(way(mesh)), mesh)
    bare = Mesh(mesh.vertices, mesh.triangles)
    assert_same(convert.as_mesh(way(bare)), bare)


@pytest.mark.parametrize("way", WAYS)
def test_a_mesh_without_triangles_survives(way):
    cloud = Mesh(np.eye(3), np.zeros((0, 3), np.int32))
    assert_same(convert.as_mesh(way(cloud)), cloud)


def test_texture_survives_open3d():
    one = textured(random_mesh())
    assert_same(convert.as_mesh(convert.to_open3d(one)), one)
    three = textured(random_mesh(), images=3)
    assert_same(convert.as_mesh(convert.to_open3d_legacy(three)), three)


def test_trimesh_keeps_each_corner_of_a_texture():
    mesh = textured(random_mesh()).with_(colors=None)
    back = convert.as_mesh(convert.to_trimesh(mesh))
    np.testing.assert_array_equal(back.vertices[back.triangles], mesh.vertices[mesh.triangles])
    np.testing.assert_array_equal(back.normals[back.triangles], mesh.normals[mesh.triangles])
    np.testing.assert_array_equal(back.texture.uvs, mesh.texture.uvs)
    np.testing.assert_array_equal(back.texture.images[0].pixels, mesh.texture.images[0].pixels)


def test_open3d_finds_texture_rows_where_its_own_reader_puts_them(shared_data):
    from stages._open3d import open3d
    from stages.surface.formats.textures import read_texture

    folder = shared_data / "meshes" / "fuze"
    image = read_texture(folder, "fuze uv.jpg", []).pixels
    read = open3d().io.read_triangle_mesh(str(folder / "fuze.obj"), True)
    np.testing.assert_array_equal(convert.as_mesh(read).texture.images[0].pixels, image)
    # Before 0.20 its tensor reader leaves textures of OBJ files out.
    if tuple(map(int, open3d().__version__.split(".")[:2])) < (0, 20):
        return
    read = open3d().t.io.read_triangle_mesh(str(folder / "fuze.obj"))
    np.testing.assert_array_equal(convert.as_mesh(read).texture.images[0].pixels, image)


def test_conversion_copies():
    mesh = random_mesh()
    other = convert.to_open3d(mesh)
    other.vertex.positions[:] = 0
    assert mesh.vertices.any()
    legacy = convert.to_open3d_legacy(mesh)
    back = convert.as_mesh(legacy)
    legacy.clear()
    assert_same(back, mesh)


def test_pairs_of_arrays():
    mesh = convert.as_mesh(([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
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
def test_what_is_no_mesh_is_refused(data, sentence):
    with pytest.raises(MeshError, match=sentence):
        convert.as_mesh(data)


def test_nothing_heavy_is_imported_for_a_mesh():
    code = (
        "import sys, numpy as np; from stages.surface.convert import as_mesh;"
        "as_mesh((np.eye(3), np.array([[0, 1, 2]])));"
        "assert not {'open3d', 'trimesh', 'cv2', 'scipy'} & set(sys.modules), 'heavy'"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_vertex_colors_from_texture_read_pixel_centres():
    image = np.array([[[10, 0, 0], [20, 0, 0]], [[30, 0, 0], [40, 0, 0]]], np.uint8)
    # Centres of the upper left, upper right and lower left pixel, then the middle of the image.
    uvs = np.array([[[0.25, 0.75], [0.75, 0.75], [0.25, 0.25]], [[0.5, 0.5], [0.5, 0.5], [1.25, -0.25]]])
    mesh = Mesh(
        np.eye(7)[:, :3],
        np.array([[0, 1, 2], [3, 4, 5]], np.int32),
        texture=Texture(uvs, np.zeros(2, np.int32), (Material(image=Image(given=image)),)),
    )
    colored = convert.with_vertex_colors(mesh)
    assert colored.texture is None
    assert colored.colors[:, 0].tolist() == [10, 20, 30, 25, 25, 10, 128]


def test_vertex_colors_keep_what_has_no_texture():
    mesh = textured(random_mesh())
    texture = Texture(mesh.texture.uvs, np.full(len(mesh.triangles), -1, np.int32), mesh.texture.materials)
    np.testing.assert_array_equal(convert.with_vertex_colors(mesh.with_(texture=texture)).colors, mesh.colors)
    plain = random_mesh()
    assert convert.with_vertex_colors(plain) is plain


def test_colors_of_faces_are_told():
    import trimesh

    mesh = trimesh.creation.box()
    mesh.visual.face_colors = [255, 0, 0, 255]
    converted = convert.as_mesh(mesh)
    assert converted.colors is None
    assert "faces" in converted.notes[0]
