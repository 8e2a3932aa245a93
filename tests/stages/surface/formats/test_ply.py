"""PLY files: lossless round trips, and early refusal of false headers."""

import resource
import struct
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.pipeline.evaluation import stored_deviations
from scanloom.pipeline.steps import coverage as covering
from scanloom.stages.diagnostics.errors import InputError, MeshError, StageError
from scanloom.stages.surface.formats.ply import read_ply, read_vertex_values, write_ply, write_ply_cloud
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import Image, Material, Texture

XYZ = "property float x\nproperty float y\nproperty float z\n"
FACE = "property list uchar int vertex_indices\n"


def make_random_mesh(count: int = 20, *, dtype: type = np.float64) -> Mesh:
    rng = np.random.default_rng(3)
    vertices = rng.normal(size=(count, 3)).astype(dtype).astype(np.float64)
    normals = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    return Mesh(
        vertices,
        rng.integers(0, count, (2 * count, 3)).astype(np.int32),
        rng.integers(0, 256, (count, 3)).astype(np.uint8),
        normals,
    )


def assert_same_mesh(actual: Mesh, expected: Mesh) -> None:
    for name in ("vertices", "triangles", "colors", "normals"):
        a, b = getattr(actual, name), getattr(expected, name)
        assert (a is None) == (b is None), name
        if b is not None:
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b, err_msg=name)


@pytest.fixture
def make(tmp_path):
    def write(header: str, body: bytes = b"", encoding: str = "ascii"):
        path = tmp_path / "made.ply"
        path.write_bytes(f"ply\nformat {encoding} 1.0\n{header}end_header\n".encode() + body)
        return path

    return write


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_round_trip_is_exact(tmp_path, dtype):
    mesh = make_random_mesh(dtype=dtype)
    path = tmp_path / "mesh.ply"
    write_ply(path, mesh)
    assert_same_mesh(read_ply(path), mesh)
    kind = b"float" if dtype is np.float32 else b"double"
    assert b"property " + kind + b" x\n" in path.read_bytes()
    assert [p.name for p in tmp_path.iterdir()] == ["mesh.ply"]


@settings(deadline=None)
@given(st.lists(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 3), min_size=0, max_size=30))
def test_any_finite_position_is_kept(tmp_path_factory, rows):
    path = tmp_path_factory.getbasetemp() / "any.ply"
    vertices = np.array(rows, np.float64).reshape(-1, 3)
    write_ply(path, Mesh(vertices, np.zeros((0, 3), np.int32)))
    back = read_ply(path).vertices
    assert back.tobytes() == vertices.tobytes()  # bytes, to compare the sign of zero


def test_a_texture_survives_a_round_trip(tmp_path):
    mesh = make_random_mesh()
    rng = np.random.default_rng(0)
    images = tuple(rng.integers(0, 256, (4, 6, channels)).astype(np.uint8) for channels in (3, 4))
    materials = tuple(Material(image=Image(given=image)) for image in images)
    texture = Texture(rng.random((40, 3, 2)), rng.integers(-1, 2, 40).astype(np.int32), materials)
    write_ply(tmp_path / "mesh.ply", mesh.with_(texture=texture))
    back = read_ply(tmp_path / "mesh.ply")
    assert_same_mesh(back, mesh)
    np.testing.assert_array_equal(back.texture.uvs, texture.uvs)
    np.testing.assert_array_equal(back.texture.material_ids, texture.material_ids)
    for a, b in zip(back.texture.images, images, strict=True):
        np.testing.assert_array_equal(a.pixels, b)
    (tmp_path / "mesh_1.png").unlink()
    back = read_ply(tmp_path / "mesh.ply")
    np.testing.assert_array_equal(back.texture.uvs, texture.uvs)
    assert len(back.texture.images) == 1
    assert "mesh_1.png" in back.diagnostics[0].message


def test_other_programs_read_written_files(tmp_path):
    import trimesh

    from scanloom.stages._open3d import import_open3d

    mesh = make_random_mesh()
    path = tmp_path / "mesh.ply"
    write_ply(path, mesh)
    theirs = trimesh.load(path, process=False)
    np.testing.assert_array_equal(theirs.vertices, mesh.vertices)
    np.testing.assert_array_equal(theirs.faces, mesh.triangles)
    np.testing.assert_array_equal(theirs.visual.vertex_colors[:, :3], mesh.colors)
    theirs = import_open3d().t.io.read_triangle_mesh(str(path))
    np.testing.assert_allclose(
        theirs.vertex.positions.numpy(), mesh.vertices, rtol=1e-6
    )  # Open3D reads float32
    np.testing.assert_array_equal(theirs.triangle.indices.numpy(), mesh.triangles)
    np.testing.assert_allclose(theirs.vertex.colors.numpy() * 255, mesh.colors, atol=1e-3)


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_all_encodings_with_mixed_polygons_and_unknown_columns_are_read(tmp_path, encoding, newline):
    header = [
        "ply", f"format {encoding} 1.0", "comment by hand", "obj_info nothing",
        "element marker 1", "property list uchar short ids", "property double weight",
        "element vertex 5", "property double x", "property float y", "property float z",
        "property uchar red", "property uchar green", "property uchar blue", "property float quality",
        "element face 4", "property uchar flags", "property list uint ushort vertex_index",
        "property list uchar float junk", "property char tail",
        "element edge 1", "property int a", "end_header", "",
    ]  # fmt: skip
    marker = ([7, -8, 9], 0.5)
    vertices = [(0.1, 0, 0, 10, 20, 30, 1), (1, 0, 0, 11, 0, 0, 1), (1, 1, 0, 12, 0, 0, 1),
                (0, 1, 0, 13, 0, 0, 1), (10, 10, 10, 14, 0, 0, 1)]  # fmt: skip
    faces = [
        (1, [0, 1, 2, 3], [1.5], -1),
        (2, [4, 3, 2], [], 3),
        (3, [0, 1], [2, 3], 4),
        (4, [0, 1, 2, 3, 4], [], 5),
    ]
    data = newline.join(header).encode()
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[encoding]
    if encoding == "ascii":
        rows = [f"{len(marker[0])} {' '.join(map(str, marker[0]))} {marker[1]}"]
        rows += [" ".join(map(str, v)) for v in vertices]
        rows += [
            f"{flags} {len(c)} {' '.join(map(str, c))} {len(j)} {' '.join(map(str, j))} {tail}"
            for flags, c, j, tail in faces
        ]
        data += newline.join([*rows, "0", ""]).encode()
    else:
        data += struct.pack(f"{order}B3hd", 3, *marker[0], marker[1])
        for v in vertices:
            data += struct.pack(f"{order}dffBBBf", *v)
        for flags, c, j, tail in faces:
            data += struct.pack(f"{order}BI{len(c)}HB{len(j)}fb", flags, len(c), *c, len(j), *j, tail)
        data += struct.pack(f"{order}i", 0)
    path = tmp_path / "made.ply"
    path.write_bytes(data)
    mesh = read_ply(path)
    assert mesh.vertices[0].tolist() == [0.1, 0, 0]
    assert mesh.colors[:, 0].tolist() == [10, 11, 12, 13, 14]
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 2, 3], [4, 3, 2], [0, 1, 2], [0, 2, 3], [0, 3, 4]]
    assert tuple(one.message for one in mesh.diagnostics) == (
        "2 polygons were split into triangles",
        "1 polygons intersect themselves or have no area: they are split as if convex",
        "1 faces of fewer than three corners are left out",
        "the element 'marker' is left out",
        "properties of its vertices are left out: quality",
        "properties of its faces are left out: flags, junk, tail",
        "the element 'edge' is left out",
    )


def test_strips_alternate_the_orientation_of_triangles(make):
    strip = np.array([0, 1, 2, 3, -1, 3, 2, 1, 1, 0], "<i4")
    body = np.zeros(12, "<f4").tobytes() + struct.pack("<i", len(strip)) + strip.tobytes()
    path = make(
        f"element vertex 4\n{XYZ}element tristrips 1\nproperty list int int vertex_indices\n",
        body,
        "binary_little_endian",
    )
    # In the second strip, only the first triangle has three different vertices.
    assert read_ply(path).triangles.tolist() == [[0, 1, 2], [2, 1, 3], [3, 2, 1]]


def test_real_strips_give_the_same_surface_as_faces(shared_data):
    strips = read_ply(shared_data / "broken" / "igea_tristrips.ply")
    faces = read_ply(shared_data / "meshes" / "igea.ply")
    assert_same_mesh(strips, faces)


@pytest.mark.parametrize(
    ("kind", "written", "read"),
    [
        ("float", (0.0, 0.5, 1.0), (0, 128, 255)),
        ("float", (0.0, 128.0, 255.0), (0, 128, 255)),
        ("uchar", (0, 1, 255), (0, 1, 255)),
        ("ushort", (0, 32896, 65535), (0, 128, 255)),
        ("float", ("nan", 0.5, 1.0), (0, 128, 255)),
    ],
)
def test_colors_of_all_types_are_read(make, kind, written, read):
    header = f"element vertex 1\n{XYZ}" + "".join(f"property {kind} {c}\n" for c in ("red", "green", "blue"))
    mesh = read_ply(make(header, f"0 0 0 {' '.join(map(str, written))}\n".encode()))
    assert mesh.colors.tolist() == [list(read)]
    assert bool(mesh.diagnostics) == ("nan" in written)


def test_texture_coordinates_of_vertices_are_read(make):
    header = f"element vertex 3\n{XYZ}property float s\nproperty float t\nelement face 1\n{FACE}"
    mesh = read_ply(make(header, b"0 0 0 0 0.5  1 0 0 1 0.25  0 1 0 0 1\n3 2 0 1\n"))
    assert mesh.texture.uvs.tolist() == [[[0, 1], [0, 0.5], [1, 0.25]]]
    assert mesh.texture.material_ids.tolist() == [-1]


def test_face_colours_and_invalid_normals_are_reported(make):
    normals = "property float nx\nproperty float ny\nproperty float nz\n"
    header = f"element vertex 3\n{XYZ}{normals}element face 1\n{FACE}property uchar red\n"
    mesh = read_ply(make(header, b"0 0 0 nan 0 1 1 0 0 0 0 1 0 1 0 0 0 1 3 0 1 2 9"))
    assert mesh.normals is None
    assert any("normals" in one.message for one in mesh.diagnostics)
    assert any("face colours" in one.message for one in mesh.diagnostics)


FOUR_BILLION = 4_294_967_296
SQUARE = b"0 0 0 1 0 0 1 1 0 0 1 0 "


@pytest.mark.parametrize(
    ("header", "body", "sentence"),
    [
        (f"element vertex {FOUR_BILLION}\n{XYZ}", b"0 0 0\n", "promises 4,294,967,296 × vertex"),
        (f"element vertex 4\n{XYZ}element face {FOUR_BILLION}\n{FACE}", SQUARE, "4,294,967,296 × face"),
        ("element vertex " + "9" * 5000 + f"\n{XYZ}", b"", "no usable count"),
        (f"element vertex -1\n{XYZ}", b"", "no usable count"),
        (f"element vertex 1e3\n{XYZ}", b"", "no usable count"),
        (f"element vertex\n{XYZ}", b"", "not understood"),
        (XYZ, b"", "not understood"),
        ("element vertex 1\nproperty quad x\n", b"0", "not understood"),
        ("element vertex 1\nproperty list float\n", b"0", "not understood"),
        ("element vertex 1\nproperty float x\nproperty float y\n", b"0 0\n", "no element `vertex` with x, y"),
        ("element face 1\n" + FACE, b"3 0 1 2\n", "no element `vertex`"),
        (f"element vertex 4\n{XYZ}", b"0 0 0 0 0 0\n", "cut short"),
        (f"element vertex 4\n{XYZ}", b"0.25 0.25 0.25 0.25 0.25 0.25 0.25\n", "ends after 2 of 4"),
        (f"element vertex 1\n{XYZ}", b"0 0 zero\n", "'zero' is not a number"),
        (f"element vertex 1\n{XYZ}", b"", "cut short"),
        (f"element vertex 4\n{XYZ}element face 1\n{FACE}", SQUARE + b"4 0 1", "ends within face 0"),
        (f"element vertex 4\n{XYZ}element face 1\n{FACE}", SQUARE + b"-3 0 1 2", "list of length -3"),
        (f"element vertex 4\n{XYZ}element face 1\n{FACE}", SQUARE + b"2.5 0 1 2", "list of length 2.5"),
        (f"element vertex 4\n{XYZ}element face 1\n{FACE}", SQUARE + b"nan 0 1 2", "list of length nan"),
        (f"element vertex 4\n{XYZ}element face 1\n{FACE}", SQUARE + b"1e30 0 1 2", "ends within face"),
        (f"element vertex 4\n{XYZ}element face 1\n{FACE}", SQUARE + b"3 0 1 2.5", "vertex_indices of a face"),
        (f"element vertex 4\n{XYZ}element face 1\n{FACE}", SQUARE + b"3 0 1 4", "triangle 0 uses vertices"),
        (f"element vertex 4\n{XYZ}element face 1\n{FACE}", SQUARE + b"3 0 1 -1", "triangle 0 uses vertices"),
        (f"element vertex 1\n{XYZ}", b"0 0 nan\n", "not finite"),
        (f"element vertex 1\n{XYZ}", b"0 0 1e999\n", "not finite"),
    ],
)
def test_malicious_text_files_are_one_error(make, header, body, sentence):
    with pytest.raises(InputError, match=sentence) as caught:
        read_ply(make(header, body))
    assert "made.ply" in str(caught.value)


def test_a_damaged_file_has_values_and_a_remedy(make):
    with pytest.raises(InputError) as caught:
        read_ply(make(f"element vertex 4\n{XYZ}", b"0.25 0.25 0.25 0.25 0.25 0.25 0.25\n"))
    found = caught.value.diagnostic
    assert found.remedy == "get a whole copy of it."
    assert (found.values["element"], found.values["row_count"], found.values["promised_count"]) == (
        "vertex",
        2,
        4,
    )
    with pytest.raises(InputError) as caught:
        read_ply(make("element vertex {x}\n" + XYZ, b""))
    assert caught.value.diagnostic.values["line"] == "element vertex {x}"
    with pytest.raises(InputError) as caught:
        read_ply(make(f"element vertex 4\n{XYZ}element face 1\n{FACE}", SQUARE + b"nan 0 1 2"))
    # JSON has no NaN.
    assert caught.value.diagnostic.values["length"] == "nan"


def pack_little_endian(fmt: str, *values: float) -> bytes:
    return struct.pack("<" + fmt, *values)


@pytest.mark.parametrize(
    ("list_type", "body", "sentence"),
    [
        ("uint", pack_little_endian("I3i", 0xFFFFFFFF, 0, 1, 2), "ends within face 0"),
        ("int", pack_little_endian("i3i", -1, 0, 1, 2), "list of length -1"),
        ("float", pack_little_endian("f3i", float("inf"), 0, 1, 2), "list of length inf"),
        ("uchar", pack_little_endian("B3iB3i", 3, 0, 1, 2, 255, 0, 1, 2), "ends within face 1"),
        ("uchar", pack_little_endian("B4iB2i", 4, 0, 1, 2, 3, 3, 0, 1), "ends within face 1"),
        ("uchar", pack_little_endian("B3iB3i", 3, 0, 1, 2, 3, 0, 1, 2**31 - 1), "triangle 1 uses vertices"),
    ],
)
def test_malicious_binary_lists_are_one_error(make, list_type, body, sentence):
    header = f"element vertex 4\n{XYZ}element face 2\nproperty list {list_type} int vertex_indices\n"
    with pytest.raises(InputError, match=sentence):
        read_ply(make(header, bytes(48) + body, "binary_little_endian"))


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"", "not a PLY file"),
        (b"plywood\n", "not a PLY file"),
        (b"ply\n", "no line `end_header`"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\n" + XYZ.encode() + b"0 0 0\n", "no line `end_header`"),
        (b"ply\nformat ascii 1.0\n" + b"comment x\n" * 200_000 + b"end_header\n", "no line `end_header`"),
        (b"ply\nformat binary_middle_endian 1.0\nend_header\n", "binary_middle_endian"),
        (b"ply\nelement vertex 0\nend_header\n", "its format is ''"),
        (b"ply\nformat ascii 1.0\nnonsense\nend_header\n", "'nonsense', which is not understood"),
    ],
)
def test_malicious_headers_are_one_error(tmp_path, data, sentence):
    path = tmp_path / "made.ply"
    path.write_bytes(data)
    with pytest.raises(InputError, match=sentence):
        read_ply(path)


def test_a_false_count_costs_neither_time_nor_memory(make):
    path = make(f"element vertex {10**15}\n{XYZ}", bytes(120), "binary_little_endian")
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    with pytest.raises(InputError):
        read_ply(path)
    assert time.process_time() - start < 0.1
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 10_000  # kB


def test_every_truncation_of_a_file_is_refused(tmp_path):
    whole = tmp_path / "whole.ply"
    write_ply(whole, make_random_mesh(5))
    data = whole.read_bytes()
    path = tmp_path / "cut.ply"
    for size in range(len(data)):
        path.write_bytes(data[:size])
        with pytest.raises(InputError):
            read_ply(path)


@settings(deadline=None)
@given(st.data())
def test_damaged_bytes_never_crash(tmp_path_factory, data):
    folder = tmp_path_factory.getbasetemp()
    write_ply(folder / "sound.ply", make_random_mesh(4))
    content = bytearray((folder / "sound.ply").read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    (folder / "damaged.ply").write_bytes(content)
    try:
        mesh = read_ply(folder / "damaged.ply")
    except InputError:
        return
    assert np.isfinite(mesh.vertices).all()
    assert mesh.triangles.size == 0 or (
        mesh.triangles.min() >= 0 and mesh.triangles.max() < len(mesh.vertices)
    )


def test_a_missing_file_or_a_folder_is_reported(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_ply(tmp_path / "none.ply")
    with pytest.raises(InputError, match="cannot be read"):
        read_ply(tmp_path)


def test_a_point_cloud_survives_a_round_trip(tmp_path):
    rng = np.random.default_rng(0)
    points, colors = rng.normal(size=(50, 3)), rng.integers(0, 256, (50, 3)).astype(np.uint8)
    write_ply_cloud(tmp_path / "cloud.ply", points, colors)
    back = read_ply(tmp_path / "cloud.ply")
    np.testing.assert_array_equal(back.vertices, points)
    np.testing.assert_array_equal(back.colors, colors)
    assert b"element face" not in (tmp_path / "cloud.ply").read_bytes()
    with pytest.raises(MeshError, match="not finite"):
        write_ply_cloud(tmp_path / "bad.ply", [[0, 0, np.nan]])
    assert not (tmp_path / "bad.ply").exists()


def test_a_failed_write_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "mesh.ply"
    write_ply(path, make_random_mesh(5))
    before = path.read_bytes()

    def raise_disk_full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", raise_disk_full)
    with pytest.raises(StageError, match="No space left"):
        write_ply(path, make_random_mesh(6))
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["mesh.ply"]


def test_writing_into_a_missing_folder_is_one_error(tmp_path):
    with pytest.raises(StageError, match="cannot be written"):
        write_ply(tmp_path / "none" / "mesh.ply", make_random_mesh(5))


def test_extra_vertex_and_face_values_are_written_and_ignored_by_the_reader(tmp_path):
    path = tmp_path / "mesh.ply"
    square = Mesh(np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    confidence = np.array([0.1, 0.5, 1 / 3, 1e-300])
    write_ply(path, square, {"bound": np.array([0.25, 0.5])}, {"confidence": confidence})
    np.testing.assert_array_equal(read_vertex_values(path, "confidence"), confidence)
    assert read_vertex_values(path, "bound") is None
    assert read_vertex_values(path, "other") is None
    np.testing.assert_array_equal(read_ply(path).vertices, square.vertices)


def test_materials_parts_and_corner_normals_survive_a_round_trip(tmp_path):
    mesh = make_random_mesh()
    rng = np.random.default_rng(0)
    image = Image("my wall.png", Image(given=rng.integers(0, 256, (4, 6, 3)).astype(np.uint8)).file_bytes)
    materials = (
        Material("painted wall", image, (1.0, 0.5, 0.1, 1.0), ("mirror", "clamp")),
        Material('"glass"\n', None, (0.1, 0.2, 0.3, 0.5)),
        Material("same wall", image),
    )
    mesh = mesh.with_(
        texture=Texture(rng.random((40, 3, 2)) * 9, rng.integers(-1, 3, 40).astype(np.int32), materials),
        corner_normals=rng.normal(size=(40, 3, 3)),
        part_ids=rng.integers(-1, 2, 40).astype(np.int32),
        part_names=("floor 1", "ä\nb"),
    )
    write_ply(tmp_path / "a mesh.ply", mesh)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a mesh.ply", "my wall.png"]
    assert (tmp_path / "my wall.png").read_bytes() == image.encoded
    back = read_ply(tmp_path / "a mesh.ply")
    assert_same_mesh(back, mesh)
    assert back.part_names == mesh.part_names
    np.testing.assert_array_equal(back.part_ids, mesh.part_ids)
    np.testing.assert_array_equal(back.corner_normals, mesh.corner_normals)
    np.testing.assert_array_equal(back.texture.uvs, mesh.texture.uvs)
    np.testing.assert_array_equal(back.texture.material_ids, mesh.texture.material_ids)
    for a, b in zip(back.texture.materials, materials, strict=True):
        assert (a.name, a.base_color, a.wrap) == (b.name, b.base_color, b.wrap)
    wall, glass, same = back.texture.materials
    assert wall.image is same.image
    assert (wall.image.name, glass.image) == ("my wall.png", None)


TEXTURED = """ply
format ascii 1.0
comment TextureFile my wall.png
element vertex 4
property float x
property float y
property float z
{vertex}element face 2
property list uchar int vertex_indices
{face}end_header
"""


@pytest.mark.parametrize("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v")])
def test_texture_coordinates_of_vertices_with_a_missing_image_are_read(tmp_path, names):
    header = TEXTURED.format(vertex="".join(f"property double {name}\n" for name in names), face="")
    rows = "0 0 0 0 0\n1 0 0 -3.5 0.1\n1 1 0 1 1\n0 1 0 nan 0\n3 0 1 2\n3 0 2 3\n"
    (tmp_path / "a.ply").write_text(header + rows)
    mesh = read_ply(tmp_path / "a.ply")
    assert mesh.texture.uvs[0].tolist() == [[0, 0], [-3.5, 0.1], [1, 1]]
    assert mesh.texture.has_uvs().tolist() == [True, False]
    assert [(m.name, m.image) for m in mesh.texture.materials] == [("my wall.png", None)]
    assert tuple(one.message for one in mesh.diagnostics) == (
        "1 triangles lose their texture: their texture coordinates are not finite",
        "the texture image my wall.png is missing or cannot be read",
    )


def test_faces_without_texture_coordinates_get_zeros(tmp_path):
    header = TEXTURED.format(vertex="", face="property list uchar float texcoord\n")
    rows = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 0\n3 0 2 3 6 0 0 1 0 2 5\n"
    (tmp_path / "a.ply").write_text(header + rows)
    uvs = read_ply(tmp_path / "a.ply").texture.uvs
    assert uvs.tolist() == [[[0, 0]] * 3, [[0, 0], [1, 0], [2, 5]]]


@pytest.mark.parametrize("text", ["{", "[]", '{"image": 7}', '{"base_color": [1, 2]}', '{"wrap": 5}', "7"])
def test_malformed_material_comments_are_ignored(tmp_path, text):
    header = TEXTURED.format(vertex="", face="property int material_index\n")
    header = header.replace("comment", f"comment Material {text}\ncomment", 1)
    (tmp_path / "a.ply").write_text(header + "0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 0\n3 0 2 3 5\n")
    mesh = read_ply(tmp_path / "a.ply")
    assert mesh.texture.material_ids.tolist() == [0, -1]
    assert mesh.texture.materials[0].image is None


def test_values_measured_by_scanloom_are_ignored_silently(tmp_path):
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32))
    names = (*covering.VERTEX_VALUES, stored_deviations.VERTEX_PROPERTY)
    faces = {name: np.zeros(1) for name in ("shape_bound", "color_bound", "patch")}
    write_ply(tmp_path / "measured.ply", mesh, faces, {name: np.zeros(3) for name in names})
    assert read_ply(tmp_path / "measured.ply").diagnostics == ()
