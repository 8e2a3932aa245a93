"""glTF files: handmade files with known content, round trips, and rules of the specification."""

import base64
import json
import struct

import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError, MeshError
from scanloom.stages.files.image_bytes import encode_png
from scanloom.stages.surface.formats.gltf import read_gltf
from scanloom.stages.surface.formats.gltf_writer import write_gltf
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import Image, Material, Texture

RED = encode_png(np.full((2, 2, 3), (200, 10, 20), np.uint8))
BLUE = encode_png(np.full((4, 2, 3), (10, 20, 200), np.uint8))
CODES = {"u1": 5121, "i1": 5120, "u2": 5123, "i2": 5122, "u4": 5125, "f4": 5126}
COLUMNS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


class GltfBuilder:
    """Builder of a glTF file: arrays in one buffer, with unaligned padding between them."""

    def __init__(self) -> None:
        self.tree = {
            "asset": {"version": "2.0"},
            "accessors": [],
            "bufferViews": [],
            "meshes": [],
            "nodes": [],
        }
        self.data = b""

    def view(self, data: bytes, **details) -> int:
        self.data += bytes(-len(self.data) % 4 + 4)
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **details}
        self.tree["bufferViews"].append(view)
        self.data += data
        return len(self.tree["bufferViews"]) - 1

    def array(self, values, kind: str, **details) -> int:
        array = np.array(values, kind)
        array = array.reshape(len(array), -1)
        accessor = {
            "bufferView": self.view(array.tobytes()), "componentType": CODES[kind], "count": len(array),
            "type": COLUMNS[array.shape[1]], **details,
        }  # fmt: skip
        self.tree["accessors"].append(accessor)
        return len(self.tree["accessors"]) - 1

    def mesh(self, *primitives, **node) -> None:
        self.tree["nodes"].append({"mesh": len(self.tree["meshes"]), **node})
        self.tree["meshes"].append({"primitives": list(primitives)})

    def read(self, tmp_path, **tree) -> Mesh:
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        whole = {**self.tree, "buffers": [{"byteLength": len(self.data), "uri": uri}], **tree}
        (tmp_path / "made.gltf").write_text(json.dumps(whole))
        return read_gltf(tmp_path / "made.gltf")


TRIANGLE = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
SQUARE = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)]


@pytest.mark.parametrize(
    ("mode", "kind", "indices", "triangles"),
    [
        (4, "u1", [0, 1, 2, 2, 1, 3], [[0, 1, 2], [2, 1, 3]]),
        (4, "u4", [0, 1, 2, 2, 1, 3, 0], [[0, 1, 2], [2, 1, 3]]),
        (5, "u2", [0, 1, 2, 3], [[0, 1, 2], [1, 3, 2]]),
        (5, "u2", [0, 1, 2, 2, 2, 3, 1], [[0, 1, 2], [2, 3, 1]]),
        (6, "u2", [0, 1, 3, 2], [[1, 3, 0], [3, 2, 0]]),
        (5, None, None, [[0, 1, 2], [1, 3, 2]]),
    ],
)
def test_indices_strips_and_fans_are_read(tmp_path, mode, kind, indices, triangles):
    make = GltfBuilder()
    primitive = {"attributes": {"POSITION": make.array(SQUARE, "f4")}, "mode": mode}
    if kind is not None:
        primitive["indices"] = make.array(indices, kind)
    make.mesh(primitive)
    assert make.read(tmp_path).triangles.tolist() == triangles


def test_transforms_of_parent_nodes_and_mirrored_nodes_are_applied(tmp_path):
    make = GltfBuilder()
    primitive = {
        "attributes": {
            "POSITION": make.array(TRIANGLE, "f4"),
            "NORMAL": make.array([(0, 0.6, 0.8)] * 3, "f4"),
        }
    }
    make.mesh(primitive, name="mirrored", scale=[-2, 1, 1])
    make.tree["nodes"].append({"mesh": 0, "name": "turned", "rotation": [0, 0, 0.5**0.5, 0.5**0.5]})
    make.tree["nodes"].append(
        {"children": [0, 1], "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 4, 0, 5, 6, 7, 1]}
    )
    mesh = make.read(tmp_path, scene=0, scenes=[{"nodes": [2]}])
    assert mesh.part_names == ("mirrored", "turned")
    assert mesh.part_ids.tolist() == [0, 1]
    np.testing.assert_allclose(
        mesh.vertices,
        [(5, 6, 7), (3, 6, 7), (5, 7, 7), (5, 6, 7), (5, 7, 7), (4, 6, 7)],
        atol=1e-6,
    )
    assert mesh.triangles.tolist() == [[0, 2, 1], [3, 4, 5]]
    # Normals are transformed by the inverse transpose: z shrinks where positions grow.
    wanted = np.array([(0, 0.6, 0.2), (-0.6, 0, 0.2)]) / np.hypot(0.6, 0.2)
    np.testing.assert_allclose(mesh.normals[[0, 3]], wanted, atol=1e-6)


def test_nodes_with_two_parents_or_a_cycle_are_refused(tmp_path):
    for nodes in ([{"children": [1]}, {"children": [0]}], [{"children": [2]}, {"children": [2]}, {}]):
        with pytest.raises(InputError, match="damaged"):
            GltfBuilder().read(tmp_path, nodes=nodes, scenes=[{"nodes": [0, 1]}])


def test_sparse_and_normalized_accessors_are_read(tmp_path):
    make = GltfBuilder()
    rows, values = make.view(bytes([2])), make.view(struct.pack("<3f", 5, 6, 7))
    sparse = {
        "count": 1,
        "indices": {"bufferView": rows, "componentType": 5121},
        "values": {"bufferView": values},
    }
    positions = make.array(TRIANGLE, "f4", sparse=sparse)
    coordinates = make.array([(0, 0), (255, 0), (51, 255)], "u1", normalized=True)
    make.mesh({"attributes": {"POSITION": positions, "TEXCOORD_0": coordinates}})
    mesh = make.read(tmp_path)
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [5, 6, 7]]
    assert mesh.texture.uvs.tolist() == [[[0, 1], [1, 1], [0.2, 0]]]


@pytest.mark.parametrize(("kind", "unit"), [("f4", 1), ("u1", 255), ("u2", 65535)])
@pytest.mark.parametrize("generator", ["Blender", "https://github.com/mikedh/trimesh"])
def test_colors_are_linear_except_from_programs_that_write_srgb(tmp_path, kind, unit, generator):
    make = GltfBuilder()
    light = np.array([(0, 0, 0, 1), (1, 1, 1, 1), (0.2140411, 0.2140411, 0.2140411, 1)]) * unit
    colors = make.array(light if kind == "f4" else np.rint(light), kind, normalized=kind != "f4")
    make.mesh({"attributes": {"POSITION": make.array(TRIANGLE, "f4"), "COLOR_0": colors}})
    mesh = make.read(tmp_path, asset={"version": "2.0", "generator": generator})
    grey = 55 if generator.startswith("http") else 128  # linear 0.214 is 0.5 in sRGB
    assert abs(mesh.colors[:, 0].astype(int) - [0, 255, grey]).max() <= 1


def test_materials_and_textures_survive_a_round_trip(tmp_path):
    make = GltfBuilder()
    uvs = make.array([(0, 0), (1, 0), (0, 1)], "f4")
    positions = make.array(TRIANGLE, "f4")
    (tmp_path / "a wall.png").write_bytes(BLUE)
    images = [
        {"bufferView": make.view(RED), "mimeType": "image/png", "name": "paint"},
        {"uri": "a%20wall.png"},
        {"uri": "gone.png"},
    ]
    samplers = [{"wrapS": 33071, "wrapT": 33648, "magFilter": 9728}]
    turned = {"KHR_texture_transform": {"offset": [0.5, 0], "scale": [2, 3], "rotation": np.pi / 2}}
    materials = [
        {
            "name": "lack 1",
            "pbrMetallicRoughness": {
                "baseColorFactor": [1, 0.5, 0, 0.25],
                "baseColorTexture": {"index": 0, "extensions": turned},
                "metallicRoughnessTexture": {"index": 1, "extensions": turned},
            },
            "normalTexture": {"index": 1, "scale": 0.5, "texCoord": 1},
            "alphaMode": "BLEND",
            "extensions": {
                "KHR_materials_clearcoat": {"clearcoatTexture": {"index": 2, "extensions": turned}}
            },
        },
        {"pbrMetallicRoughness": {"baseColorFactor": [0, 0, 1, 1]}, "doubleSided": True},
    ]
    attributes = {"POSITION": positions, "TEXCOORD_0": uvs, "TEXCOORD_1": uvs}
    make.mesh(
        {"attributes": attributes, "material": 0},
        {"attributes": {"POSITION": positions}, "material": 1},
        {"attributes": {"POSITION": positions}},
    )
    textures = [{"source": 0, "sampler": 0}, {"source": 1}, {"source": 2}]
    mesh = make.read(tmp_path, materials=materials, textures=textures, images=images, samplers=samplers)
    assert len(mesh.vertices) == 3
    paint, blue = mesh.texture.materials
    assert mesh.texture.material_ids.tolist() == [0, 1, -1]
    assert (paint.name, paint.wrap, paint.image.name) == ("lack 1", ("clamp", "mirror"), "paint")
    assert paint.image.encoded == RED
    assert paint.base_color == pytest.approx((1, 0.7354, 0, 0.25), abs=1e-4)  # linear 0.5
    assert blue.base_color == (0, 0, 1, 1)
    # Scaled by (2, 3), rotated counter-clockwise in an image with v down, and moved; then converted to v up.
    np.testing.assert_allclose(mesh.texture.uvs[0], [(0.5, 1), (0.5, 3), (3.5, 1)], atol=1e-12)
    messages = " ".join(one.message for one in mesh.diagnostics)
    for word in ("gone.png", "normalTexture", "clearcoatTexture", "TEXCOORD_1"):
        assert word in messages

    for name in ("again.glb", "a gain.gltf"):
        (tmp_path / "out").mkdir(exist_ok=True)
        write_gltf(tmp_path / "out" / name, mesh)
        back = read_gltf(tmp_path / "out" / name)
        assert back.diagnostics == ()
        assert_same_mesh(back, mesh)
        tree = read_tree(tmp_path / "out" / name)
        written = tree["materials"][0]
        assert written["alphaMode"] == "BLEND"
        assert written["pbrMetallicRoughness"]["baseColorFactor"] == [1, 0.5, 0, 0.25]
        assert tree["samplers"] == samplers
        other = written["pbrMetallicRoughness"]["metallicRoughnessTexture"]["index"]
        assert tree["images"][tree["textures"][other]["source"]].get("name", "a wall.png") == "a wall.png"
        assert tree["materials"][1]["doubleSided"]
    assert (tmp_path / "out" / "a wall.png").read_bytes() == BLUE
    assert (tmp_path / "out" / "paint.png").read_bytes() == RED


def read_tree(path) -> dict:
    data = path.read_bytes()
    return json.loads(
        data if path.suffix == ".gltf" else data[20 : 20 + int.from_bytes(data[12:16], "little")]
    )


def assert_same_mesh(back: Mesh, mesh: Mesh) -> None:
    assert len(back.vertices) == len(mesh.vertices)
    np.testing.assert_allclose(
        back.vertices[back.triangles], mesh.vertices[mesh.triangles], rtol=1e-6, atol=1e-6
    )
    np.testing.assert_array_equal(back.part_ids, mesh.part_ids)
    assert back.part_names == mesh.part_names
    if mesh.corner_normals is not None:
        np.testing.assert_allclose(back.corner_normals, mesh.corner_normals, atol=1e-6)
    np.testing.assert_allclose(back.texture.uvs, mesh.texture.uvs, atol=1e-6)
    np.testing.assert_array_equal(back.texture.material_ids, mesh.texture.material_ids)
    for a, b in zip(back.texture.materials, mesh.texture.materials, strict=True):
        assert (a.name, a.base_color, a.wrap) == (b.name, b.base_color, b.wrap)
        assert (a.image is None) == (b.image is None)
        assert b.image is None or a.image.file_bytes == b.image.file_bytes


def make_two_tetrahedra() -> Mesh:
    """Make two distant tetrahedra: two parts, three materials, sharp edges."""
    rng = np.random.default_rng(0)
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], float)
    faces = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])
    vertices, triangles = np.vstack((corners, corners + 3)), np.vstack((faces, faces + 4)).astype(np.int32)
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    uvs = np.float32(rng.random((8, 3, 2)) * 3 - 1).astype(float)
    uvs[4:6] = 0
    materials = (
        Material("red", Image("red.png", RED), (1.0, 1.0, 1.0, 1.0), ("clamp", "repeat")),
        Material("computed", Image(given=rng.integers(0, 256, (2, 3, 4)).astype(np.uint8))),
        Material("plain", None, (0.0, 1.0, 0.0, 0.5)),
    )
    return Mesh(
        vertices,
        triangles,
        texture=Texture(uvs, np.array([0, 0, 1, 1, 2, 2, 0, 0], np.int32), materials),
        corner_normals=np.repeat(normal[:, None], 3, axis=1),
        part_ids=np.repeat([0, 1], 4).astype(np.int32),
        part_names=("one of two", "two"),
    )


def list_violations(path) -> list[str]:
    """Check accessors, views and chunks of a file against the specification."""
    data, tree = path.read_bytes(), read_tree(path)
    size, length = struct.unpack("<8xI I", data[:16])
    body = data[20 + length + 8 :]
    broken = []
    if size != len(data) or length % 4 or len(body) % 4 or tree["buffers"][0]["byteLength"] > len(body):
        broken.append("lengths of chunks")
    indices = {p["indices"] for mesh in tree["meshes"] for p in mesh["primitives"]}
    positions = {p["attributes"]["POSITION"] for mesh in tree["meshes"] for p in mesh["primitives"]}
    directions = {p["attributes"].get("NORMAL") for mesh in tree["meshes"] for p in mesh["primitives"]}
    for number, accessor in enumerate(tree["accessors"]):
        view = tree["bufferViews"][accessor["bufferView"]]
        kind = {code: kind for kind, code in CODES.items()}[accessor["componentType"]]
        columns = {name: n for n, name in COLUMNS.items()}[accessor["type"]]
        values = np.frombuffer(body, kind, accessor["count"] * columns, view["byteOffset"]).reshape(
            -1, columns
        )
        if view["byteOffset"] % 4 or ((values.dtype.itemsize * columns) % 4 and number not in indices):
            broken.append(f"alignment of accessor {number}")
        if view["target"] != (34963 if number in indices else 34962):
            broken.append(f"target of accessor {number}")
        if number in positions and [accessor["min"], accessor["max"]] != [
            values.min(0).tolist(), values.max(0).tolist(),
        ]:  # fmt: skip
            broken.append("bounds")
        if number in indices and values.max() == np.iinfo(kind).max:
            broken.append("restart value")
        if number in directions and abs(np.linalg.norm(values, axis=1) - 1).max() > 1e-3:
            broken.append("length of normals")
    for image in tree.get("images", []):
        view = tree["bufferViews"][image["bufferView"]]
        content = body[view["byteOffset"] :][: view["byteLength"]]
        if image["mimeType"] != "image/png" or not content.startswith(b"\x89PNG") or "target" in view:
            broken.append("image")
    return broken


def test_a_written_file_reads_back_and_follows_the_specification(tmp_path):
    mesh = make_two_tetrahedra()
    write_gltf(tmp_path / "boxes.glb", mesh)
    assert list_violations(tmp_path / "boxes.glb") == []
    assert [node["name"] for node in read_tree(tmp_path / "boxes.glb")["nodes"]] == ["one of two", "two"]
    assert_same_mesh(read_gltf(tmp_path / "boxes.glb"), mesh)


def test_triangles_without_coordinates_get_them_if_their_material_has_an_image(tmp_path):
    corners = np.zeros((2, 3, 2))
    corners[0] = [(0, 0), (1, 0), (0, 1)]
    material = Material("a", Image("a.png", RED))
    texture = Texture(corners, np.zeros(2, np.int32), (material,))
    mesh = Mesh(np.array(SQUARE, float), np.array([[0, 1, 2], [2, 1, 3]], np.int32), texture=texture)
    write_gltf(tmp_path / "a.glb", mesh)
    primitives = read_tree(tmp_path / "a.glb")["meshes"][0]["primitives"]
    assert all("TEXCOORD_0" in primitive["attributes"] for primitive in primitives)
    back = read_gltf(tmp_path / "a.glb").texture
    assert back.has_uvs().tolist() == [True, False]
    np.testing.assert_array_equal(back.uvs, corners)


def test_unknown_properties_of_a_material_are_dropped(tmp_path):
    make = GltfBuilder()
    make.mesh({"attributes": {"POSITION": make.array(TRIANGLE, "f4")}, "material": 0})
    strange = {"normalTexture": {"scale": "not a number"}, "someday": {"index": 3}}
    kept = {"name": "a", "doubleSided": True, "extras": {"own": 1}}
    mesh = make.read(tmp_path, materials=[{**strange, **kept}])
    assert any("normalTexture of material 'a' is left out" in one.message for one in mesh.diagnostics)
    write_gltf(tmp_path / "a.glb", mesh)
    (material,) = read_tree(tmp_path / "a.glb")["materials"]
    assert {name: material.pop(name) for name in kept} == kept
    assert set(material) <= {"pbrMetallicRoughness"}


def test_triangles_are_grouped_by_material(tmp_path):
    order = np.array([2, 0, 3, 1, 6, 4, 7, 5])
    mesh = make_two_tetrahedra()
    write_gltf(tmp_path / "boxes.glb", mesh.with_triangles(mesh.triangles[order], order))
    together = np.array([2, 3, 0, 1, 6, 7, 4, 5])
    back = read_gltf(tmp_path / "boxes.glb")
    np.testing.assert_array_equal(back.vertices[back.triangles], mesh.vertices[mesh.triangles[together]])
    assert [back.texture.materials[k].name for k in back.texture.material_ids[::2]] == [
        "computed", "red", "red", "plain",
    ]  # fmt: skip


def test_parts_that_share_vertices_stay_connected(tmp_path):
    mesh = make_two_tetrahedra().with_(part_ids=np.array([0, 0, 1, -1, 1, 1, 1, 1], np.int32))
    write_gltf(tmp_path / "boxes.glb", mesh)
    back = read_gltf(tmp_path / "boxes.glb")
    assert len(back.vertices) == 8
    assert sorted(back.part_names) == sorted(mesh.part_names)
    assert np.bincount(back.part_ids + 1).tolist() == [1, 2, 5]


def test_colors_are_exact_and_do_not_darken_images(tmp_path):
    rng = np.random.default_rng(0)
    mesh = make_two_tetrahedra().with_(colors=rng.integers(0, 256, (8, 3)).astype(np.uint8))
    write_gltf(tmp_path / "boxes.glb", mesh)
    back = read_gltf(tmp_path / "boxes.glb")
    np.testing.assert_array_equal(back.colors[back.triangles], mesh.colors[mesh.triangles])
    assert list_violations(tmp_path / "boxes.glb") == []
    tree = read_tree(tmp_path / "boxes.glb")
    for primitive in (p for mesh in tree["meshes"] for p in mesh["primitives"]):
        surface = tree["materials"][primitive["material"]]["pbrMetallicRoughness"]
        assert ("COLOR_0" in primitive["attributes"]) != ("baseColorTexture" in surface)
    every = Mesh(np.arange(768.0).reshape(-1, 3), np.arange(255).reshape(-1, 3).astype(np.int32))
    every = every.with_(colors=np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1))
    write_gltf(tmp_path / "every.glb", every)
    np.testing.assert_array_equal(read_gltf(tmp_path / "every.glb").colors, every.colors)


def test_precision_is_kept_far_from_the_origin(tmp_path):
    mesh = make_two_tetrahedra().with_(
        vertices=make_two_tetrahedra().vertices * 0.1 + (500_000, 5_400_000, 300)
    )
    write_gltf(tmp_path / "far.glb", mesh)
    back = read_gltf(tmp_path / "far.glb")
    moved = back.vertices[back.triangles] - mesh.vertices[mesh.triangles]
    assert abs(moved).max() < 1e-6


def test_positions_beyond_single_precision_are_refused(tmp_path):
    mesh = make_two_tetrahedra().with_(vertices=make_two_tetrahedra().vertices * 1e39)
    with pytest.raises(MeshError, match=r"beyond single precision .* PLY"):
        write_gltf(tmp_path / "far.glb", mesh)
    assert not list(tmp_path.iterdir())


def test_images_in_other_formats_are_written_as_png(tmp_path):
    import cv2

    pixels = np.random.default_rng(0).integers(0, 256, (3, 5, 3)).astype(np.uint8)
    stored = cv2.imencode(".bmp", pixels[..., ::-1])[1].tobytes()
    materials = (Material("a", Image("a.bmp", stored)), Material("b", Image("b.png", RED[:60])))
    mesh = make_two_tetrahedra()
    texture = Texture(mesh.texture.uvs, np.repeat([0, 1], 4).astype(np.int32), materials)
    write_gltf(tmp_path / "a.glb", mesh.with_(texture=texture))
    back = read_gltf(tmp_path / "a.glb").texture
    np.testing.assert_array_equal(back.materials[0].image.pixels, pixels)
    assert back.materials[1].image.encoded == RED[:60]


@pytest.mark.parametrize("name", ["KHR_draco_mesh_compression"])
def test_unsupported_compression_is_refused_with_a_remedy(tmp_path, name):
    make = GltfBuilder()
    make.mesh({"attributes": {"POSITION": make.array(TRIANGLE, "f4")}})
    with pytest.raises(InputError, match=f"{name}.*write it again without compression"):
        make.read(tmp_path, extensionsRequired=[name])
    # The decompressed data would be in a buffer without content.
    with pytest.raises(InputError, match=f"{name}.*write it again without compression"):
        make.read(tmp_path, extensionsRequired=[name], buffers=[{"byteLength": 1 << 20}])


@pytest.mark.parametrize(
    "change",
    [
        {"count": 4},
        {"byteOffset": 1},
        {"bufferView": 7},
        {"bufferView": -1},
        {"componentType": 5124},
        {"type": "MAT2"},
        {"sparse": {"count": 10**9}},
    ],
)
def test_accessors_beyond_their_buffer_are_refused(tmp_path, change):
    make = GltfBuilder()
    make.mesh({"attributes": {"POSITION": make.array(TRIANGLE, "f4", **change)}})
    with pytest.raises(InputError, match=r"made\.gltf"):
        make.read(tmp_path)


def test_dropped_points_and_lines_are_reported(tmp_path):
    make = GltfBuilder()
    positions = make.array(SQUARE, "f4")
    make.mesh(
        {"attributes": {"POSITION": positions}, "mode": 1}, {"attributes": {"POSITION": positions}, "mode": 5}
    )
    mesh = make.read(tmp_path)
    assert len(mesh.triangles) == 2
    assert [one.message for one in mesh.diagnostics] == ["points and lines are left out"]


def test_dropped_content_besides_meshes_is_reported(tmp_path):
    make = GltfBuilder()
    numbers = make.array(np.zeros(4), "f4")
    make.mesh({"attributes": {"POSITION": make.array(SQUARE, "f4"), "_FEATURE_ID_0": numbers}, "mode": 5})
    lights = {"KHR_lights_punctual": {"lights": []}}
    camera = {"type": "perspective", "perspective": {"yfov": 1, "znear": 1}}
    mesh = make.read(tmp_path, extensions=lights, cameras=[camera])
    assert tuple(one.message for one in mesh.diagnostics) == (
        "cameras are left out",
        "data of the extensions KHR_lights_punctual is left out",
        "attributes _FEATURE_ID_0 are left out",
    )
