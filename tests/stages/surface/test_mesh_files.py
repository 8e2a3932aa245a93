"""Meshes of all formats, and one-sentence errors for unusable files."""

import json
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages.diagnostics.errors import InputError, MeshError, UsageError
from scanloom.stages.surface.formats.obj import read_obj
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import MESH_EXTENSIONS, list_unsupported_data, read_mesh, write_mesh
from scanloom.stages.surface.texture import Image, Material, Texture
from scanloom.stages.surface.topology import topology

WRITABLE = (".ply", ".obj", ".off", ".stl", ".glb", ".gltf")


def make_cube() -> Mesh:
    corners = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3) + 0.125
    triangles = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
                 (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]  # fmt: skip
    rng = np.random.default_rng(0)
    return Mesh(corners, np.array(triangles, np.int32), rng.integers(0, 256, (8, 3)).astype(np.uint8))


def add_texture(mesh: Mesh, images: int = 1) -> Mesh:
    rng = np.random.default_rng(1)
    count = len(mesh.triangles)
    pictures = [rng.integers(0, 256, (8, 16, 3)).astype(np.uint8) for _ in range(images)]
    materials = tuple(Material(image=Image(given=pixels)) for pixels in pictures)
    ids = np.sort(rng.integers(0, images, count)).astype(np.int32)
    return mesh.with_(texture=Texture(rng.random((count, 3, 2)), ids, materials))


@pytest.mark.parametrize("extension", WRITABLE)
def test_shape_and_colours_are_read_back(tmp_path, extension):
    mesh = make_cube()
    path = tmp_path / f"a b{extension}"
    write_mesh(path, mesh)
    back = read_mesh(path)
    corners = mesh.vertices[mesh.triangles]
    np.testing.assert_array_equal(back.vertices[back.triangles], corners)
    assert len(back.vertices) == 8
    if extension in (".ply", ".obj", ".glb", ".gltf"):
        np.testing.assert_array_equal(back.colors[back.triangles], mesh.colors[mesh.triangles])
    beside = ["a b.bin"] if extension == ".gltf" else []
    assert sorted(p.name for p in tmp_path.iterdir()) == [*beside, path.name]


def test_upper_case_extensions(tmp_path):
    write_mesh(tmp_path / "MESH.PLY", make_cube())
    assert len(read_mesh(tmp_path / "MESH.PLY").triangles) == 12


@pytest.mark.parametrize("images", [1, 3])
@pytest.mark.parametrize("normals", [True, False])
def test_obj_keeps_everything(tmp_path, images, normals):
    mesh = add_texture(make_cube(), images)
    rng = np.random.default_rng(2)
    mesh = mesh.with_(vertices=rng.normal(size=(8, 3)), normals=rng.normal(size=(8, 3)) if normals else None)
    write_mesh(tmp_path / "mesh.obj", mesh)
    back = read_mesh(tmp_path / "mesh.obj")
    np.testing.assert_array_equal(back.vertices, mesh.vertices)
    np.testing.assert_array_equal(back.triangles, mesh.triangles)
    np.testing.assert_array_equal(back.colors, mesh.colors)
    np.testing.assert_array_equal(back.texture.uvs, mesh.texture.uvs)
    np.testing.assert_array_equal(back.texture.material_ids, mesh.texture.material_ids)
    for a, b in zip(back.texture.images, mesh.texture.images, strict=True):
        np.testing.assert_array_equal(a.pixels, b.pixels)
    if normals:
        np.testing.assert_array_equal(back.normals, mesh.normals)


def test_trimesh_reads_our_obj(tmp_path):
    import trimesh

    write_mesh(tmp_path / "mesh.obj", add_texture(make_cube().with_(colors=None)))
    theirs = trimesh.load(tmp_path / "mesh.obj", process=False)
    assert theirs.volume == pytest.approx(1)
    assert theirs.visual.material.image.size == (16, 8)


def test_glb_keeps_one_texture(tmp_path):
    mesh = add_texture(make_cube().with_(colors=None))
    write_mesh(tmp_path / "mesh.glb", mesh)
    back = read_mesh(tmp_path / "mesh.glb")
    np.testing.assert_allclose(back.texture.uvs, mesh.texture.uvs, atol=1e-6)
    np.testing.assert_array_equal(back.texture.images[0].pixels, mesh.texture.images[0].pixels)
    assert len(back.vertices) == 8  # seams are not cut open


def test_writing_other_formats_is_a_usage_error(tmp_path):
    with pytest.raises(UsageError, match=r"\.xyz"):
        write_mesh(tmp_path / "mesh.xyz", make_cube())


def test_scene_instances_are_joined_in_their_poses(tmp_path):
    import trimesh

    scene = trimesh.Scene()
    mesh = trimesh.creation.box()
    scene.add_geometry(mesh, node_name="a", geom_name="box")
    scene.add_geometry(
        mesh, node_name="b", geom_name="box", transform=trimesh.transformations.translation_matrix([5, 0, 0])
    )
    scene.export(tmp_path / "two.glb")
    joined = read_mesh(tmp_path / "two.glb")
    found = topology(joined)
    assert (found.components, found.is_closed) == (2, True)
    assert joined.vertices[:, 0].max() == pytest.approx(5.5)


def test_obj_statements(tmp_path):
    path = tmp_path / "made.obj"
    path.write_bytes(
        b"# by hand\r\nmtllib none.mtl\nv 0 0 0\nv 1 0 0 \\\n\nv\t1 1 0 # corner\n"
        b"f 1 2 -1\nv 0 1 0\nvt 0 0\nl 1 2\ng group\nf -4/1 -2/1/ 4\nf 1//1 2 3//\n"
    )
    mesh = read_obj(path)
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]
    assert mesh.texture is None


def test_real_seams_stay_closed(shared_data):
    # 2930 positions, 3225 of them with texture coordinates: the surface has no border.
    assert topology(read_mesh(shared_data / "meshes" / "spot" / "spot_triangulated.obj")).is_closed
    banana = read_mesh(shared_data / "meshes" / "ycb_banana" / "textured_simple_reoriented.obj")
    assert topology(banana).is_closed
    assert banana.texture.images[0].pixels.shape == (4096, 4096, 3)
    duck = read_mesh(shared_data / "meshes" / "Duck.glb")
    assert topology(duck).is_closed
    assert (duck.texture.material_ids == 0).all()


def test_all_real_meshes_can_be_read(shared_data):
    files = [p for p in sorted((shared_data / "meshes").rglob("*")) if p.suffix in MESH_EXTENSIONS]
    assert len(files) > 15
    for path in files:
        mesh = read_mesh(path)
        assert len(mesh.triangles) > 0


def write_file(tmp_path, name: str, data: bytes):
    (tmp_path / name).write_bytes(data)
    return tmp_path / name


@pytest.mark.parametrize(
    ("name", "data", "sentence"),
    [
        ("a.xyz", b"0 0 0", "unknown format '.xyz'"),
        ("mesh", b"", "unknown format ''"),
        ("a.obj", b"", "holds no vertices"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\n", "2 vertices but no triangles"),
        ("a.obj", b"v 0 0\n", "fewer than 3 numbers"),
        ("a.obj", b"v 0 0 zero\n", "'zero' is not a number"),
        ("a.obj", b"v 0 0 nan\nf 1 1 1\n", "not finite"),
        ("a.obj", b"v 0 0 0\nf 1 1 2\n", "triangle 0 uses vertices"),
        ("a.obj", b"v 0 0 0\nf 0 1 1\n", "triangle 0 uses vertices"),
        ("a.obj", b"v 0 0 0\nf -2 1 1\n", "triangle 0 uses vertices"),
        ("a.obj", b"v 0 0 0\nf 1 1 4294967297\n", "triangle 0 uses vertices"),
        ("a.obj", b"v 0 0 0\nf 1 1 1e300\n", "not of the form"),
        ("a.obj", b"v 0 0 0\nf 1/2/3/4 1 1\n", "not of the form"),
        ("a.obj", b"v 0 0 0\nf 1.5 1 1\n", "not of the form"),
        ("a.obj", b"v 0 0 0\nf one two three\n", "'one' is not a number"),
        ("a.off", b"", "damaged or cut short"),
        ("a.off", b"OFF\n99999999999 1 0\n0 0 0\n", "damaged or cut short"),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", "a.off: "),
        ("a.stl", bytes(84), "holds no vertices"),
        (
            "a.stl",
            bytes(80) + struct.pack("<I", 0xFFFFFFFF) + bytes(50),
            "4,294,967,295 triangles but holds 1",
        ),
        ("a.glb", b"", "not a valid glTF"),
        ("a.glb", b"glTF" + bytes(40), "not a valid glTF"),
        ("a.gltf", b"[]", "not a valid glTF"),
        ("a.gltf", b"{" * 5000, "not a valid glTF"),
    ],
)
def test_files_that_are_not_meshes(tmp_path, name, data, sentence):
    path = write_file(tmp_path, name, data)
    with pytest.raises(InputError, match=sentence) as caught:
        read_mesh(path)
    assert str(path) in str(caught.value)


def test_missing_files(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        read_mesh(tmp_path / "none.obj")
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(InputError, match="not a file"):
        read_mesh(tmp_path / "folder.obj")


@pytest.mark.parametrize("accessor", [{"count": 10**12}, {"count": -1}, {"count": "many"}, {}])
def test_gltf_with_excessive_counts(tmp_path, accessor):
    tree = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64," + "A" * 48}],
        "accessors": [{"componentType": 5126, "type": "VEC3", **accessor}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    path = write_file(tmp_path, "made.gltf", json.dumps(tree).encode())
    with pytest.raises(InputError, match=r"made\.gltf"):
        read_mesh(path)


def test_index_out_of_range_is_a_mesh_error(shared_data):
    with pytest.raises(MeshError, match="triangle 0 uses vertices"):
        read_mesh(shared_data / "broken" / "IndexOutOfRange.gltf")


@pytest.mark.parametrize("extension", WRITABLE)
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_damaged_bytes_give_a_mesh_or_an_error(tmp_path_factory, extension, data):
    folder = tmp_path_factory.getbasetemp()
    sound = folder / f"sound{extension}"
    if not sound.exists():
        write_mesh(sound, add_texture(make_cube().with_(colors=None)))
    content = bytearray(sound.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at : at + data.draw(st.integers(0, 8))] = data.draw(st.binary(max_size=8))
        content = content or bytearray(1)
    path = write_file(folder, f"damaged{extension}", bytes(content))
    try:
        mesh = read_mesh(path)
    except InputError:
        return
    assert np.isfinite(mesh.vertices).all()
    assert mesh.triangles.max() < len(mesh.vertices)


def test_libraries_are_quiet(tmp_path, caplog):
    # trimesh logs a traceback for a normal that it cannot parse, then continues without it.
    corners = b"outer loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n"
    path = write_file(tmp_path, "a.stl", b"solid a\nfacet normal 0 0 x\n" + corners)
    assert len(read_mesh(path).triangles) == 1
    assert not caplog.records


def test_a_material_file_whose_name_has_a_zero_byte_counts_as_missing(tmp_path):
    path = tmp_path / "mesh.obj"
    path.write_bytes(b"mtllib \0.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\n")
    assert len(read_mesh(path).triangles) == 1


@pytest.mark.parametrize("extension", [".ply", ".obj", ".off", ".stl", ".glb"])
def test_an_empty_mesh_is_written_in_every_format(tmp_path, extension):
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), normals=np.zeros((0, 3)))
    write_mesh(tmp_path / f"nothing{extension}", nothing)
    with pytest.raises(InputError, match="holds no"):
        read_mesh(tmp_path / f"nothing{extension}")


def _read_messages(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    mesh = read_mesh(path)
    assert all(str(one) == f"{path}: {one.message}" for one in mesh.diagnostics)
    return tuple(one.message for one in mesh.diagnostics)


def test_ignored_content_is_reported(tmp_path):
    triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    assert _read_messages(tmp_path, "a.obj", triangle) == ()
    assert _read_messages(tmp_path, "b.obj", triangle + "l 1 2\np 3\n") == ("lines and points are left out",)
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    more = "property float quality\nproperty float confidence\nelement face 1\n"
    faces = "property list uchar int vertex_indices\nproperty int label\nelement edge 1\nproperty int a\n"
    rows = "end_header\n0 0 0 1 1\n1 0 0 1 1\n0 1 0 1 1\n3 0 1 2 7\n5\n"
    assert _read_messages(tmp_path, "a.ply", head + more + faces + rows) == (
        "the vertex confidence is left out: only remesh uses it",
        "properties of its vertices are left out: quality",
        "properties of its faces are left out: label",
        "the element 'edge' is left out",
    )
    rows = "vertex {0} 0 0\nvertex {1} 0 0\nvertex 0 {1} 0\n"
    facet = f"facet normal 0 0 1\nouter loop\n{rows}endloop\nendfacet\n"
    solids = "".join(f"solid s{i}\n{facet.format(i, i + 1)}endsolid s{i}\n" for i in range(2))
    assert _read_messages(tmp_path, "a.stl", solids) == (
        "the names of its 2 solids are left out: they become one mesh",
    )


def test_extra_numbers_in_an_off_file_are_reported(tmp_path):
    plain = "OFF # one\n\n3 1 0\n0 0 0\n1 0 0 # b\n0 1 0\n3 0 1 2\n"
    assert _read_messages(tmp_path, "a.off", plain) == ()
    assert _read_messages(tmp_path, "b.off", plain.replace("1 2\n", "1 2 255 0 0\n")) == (
        "additional numbers of its faces, such as colours, are left out",
    )
    assert _read_messages(tmp_path, "c.off", "C" + plain.replace("0 1 0\n", "0 1 0 9 9 9 255\n")) == (
        "additional numbers of its vertices, such as colours, are left out",
    )


def test_binary_off_is_not_reported_as_damaged(tmp_path):
    (tmp_path / "a.off").write_bytes(b"OFF BINARY\n" + struct.pack(">3i", 0, 0, 0))
    with pytest.raises(InputError, match=r"a\.off: is binary OFF, which is not supported"):
        read_mesh(tmp_path / "a.off")


def test_attributes_of_a_binary_stl_are_reported(tmp_path):
    write_mesh(tmp_path / "plain.stl", make_cube())
    data = bytearray((tmp_path / "plain.stl").read_bytes())
    assert read_mesh(tmp_path / "plain.stl").diagnostics == ()
    data[84 + 48 : 84 + 50] = (31).to_bytes(2, "little")
    (tmp_path / "red.stl").write_bytes(bytes(data))
    assert [one.message for one in read_mesh(tmp_path / "red.stl").diagnostics] == [
        "attribute numbers of triangles, which some programs use for colours, are left out",
    ]


def test_losses_of_shape_only_formats():
    mesh = make_cube()
    rest = mesh.with_(part_ids=np.zeros(12, np.int32), part_names=("cube",))
    normals = np.broadcast_to((0.0, 0.0, 1.0), (12, 3, 3))
    assert list_unsupported_data(".ply", rest) == ""
    assert list_unsupported_data(".stl", mesh.with_(colors=None)) == ""
    assert list_unsupported_data(".stl", mesh) == "colours"
    assert list_unsupported_data(".off", rest) == "colours and parts"
    assert (
        list_unsupported_data(".off", rest.with_(corner_normals=normals))
        == "colours and parts and corner normals"
    )


@pytest.mark.parametrize(
    "text",
    [
        "# made of OFF\nOFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
        "# OFF\n# 1 2\nOFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
        "COFF\n3 1 0\n0 0 0 255 0 0\n1 0 0 255 0 0\n0 1 0 255 0 0\n3 0 1 2\n",
    ],
)
def test_comments_of_an_off_file_may_hold_its_keyword(tmp_path, text):
    (tmp_path / "a.off").write_text(text)
    mesh = read_mesh(tmp_path / "a.off")
    assert mesh.triangles.tolist() == [[0, 1, 2]]
    assert bool(mesh.diagnostics) == text.startswith("COFF")
