"""OBJ files with materials, groups and polygons, and their round trips."""

from dataclasses import astuple

import numpy as np
import pytest

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.diagnostic import Severity
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.image_bytes import encode_png
from scanloom.stages.surface.formats import obj_statements
from scanloom.stages.surface.formats.obj import read_obj, write_obj
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import bake_vertex_colors
from scanloom.stages.surface.texture import Image, Material, Texture

RED = encode_png(np.full((2, 2, 3), (200, 10, 20), np.uint8))
BLUE = encode_png(np.full((2, 2, 4), (10, 20, 200, 255), np.uint8))

LIBRARY = """# made by hand
newmtl red wall
Kd 0.8 0.8 0.8
Ns 12.5
map_Kd -s 1 1 1 -clamp on my wall.png
map_Bump -bm 0.3 textures\\bump map.png

newmtl glass
Kd 0.25 0.5 1
d 0.5
"""
MODEL = """mtllib made by hand.mtl
mtllib none.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0.5 0.5 1
vt 0 0
vt 2.5 0
vt 2.5 -1
vt 0 -1
vn 0 0 1
vn 0 0 -1
o body
g front side
usemtl red wall
f 1/1/1 2/2/1 3/3/1 4/4/1
g
usemtl glass
f -5//2 -4//2 -1//2
usemtl unknown
f 2 3 5
o lid
usemtl red wall
f 3/1 4/2 5/3
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "textures").mkdir()
    (tmp_path / "textures" / "bump map.png").write_bytes(BLUE)
    (tmp_path / "my wall.png").write_bytes(RED)
    (tmp_path / "made by hand.mtl").write_text(LIBRARY)
    (tmp_path / "made.obj").write_text(MODEL)
    return tmp_path


def test_materials_groups_and_polygons_are_read(folder):
    mesh = read_obj(folder / "made.obj")
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 4], [1, 2, 4], [2, 3, 4]]
    assert [material.name for material in mesh.texture.materials] == ["red wall", "glass", "unknown"]
    assert mesh.texture.material_ids.tolist() == [0, 0, 1, 2, 0]
    wall, glass, unknown = mesh.texture.materials
    assert (wall.image.name, wall.image.encoded, wall.image.mime) == ("my wall.png", RED, "image/png")
    assert (wall.wrap, wall.base_color) == (("clamp", "clamp"), None)
    assert (glass.base_color, glass.image) == ((0.25, 0.5, 1.0, 0.5), None)
    assert unknown.base_color is None
    # Coordinates beyond 0..1 are kept.
    assert mesh.texture.uvs[1].tolist() == [[0, 0], [2.5, -1], [0, -1]]
    assert mesh.texture.has_uvs().tolist() == [True, True, False, False, True]
    assert mesh.part_names == ("body/front side", "body", "lid")
    assert mesh.part_ids.tolist() == [0, 0, 1, 1, 2]
    assert mesh.normals is None
    assert mesh.corner_normals[:, 0, 2].tolist() == [1, 1, -1, 0, 0]
    assert tuple(one.message for one in mesh.diagnostics) == (
        "1 polygons were split into triangles",
        "the material library none.mtl is missing or cannot be read",
        "options -o, -s and -t of the image my wall.png are kept for writing, but ignored for colours",
    )


def assert_same_mesh(back: Mesh, mesh: Mesh) -> None:
    for name in ("vertices", "triangles", "colors", "normals", "corner_normals", "part_ids"):
        np.testing.assert_array_equal(getattr(back, name), getattr(mesh, name), err_msg=name)
    assert back.part_names == mesh.part_names
    np.testing.assert_array_equal(back.texture.uvs, mesh.texture.uvs)
    np.testing.assert_array_equal(back.texture.material_ids, mesh.texture.material_ids)
    for a, b in zip(back.texture.materials, mesh.texture.materials, strict=True):
        assert (a.name, a.base_color, a.wrap) == (b.name, b.base_color, b.wrap)
        assert (a.image is None) == (b.image is None)
        if b.image is not None:
            assert a.image.file_bytes == b.image.file_bytes


def test_a_mesh_is_written_as_it_was_read(folder):
    mesh = read_obj(folder / "made.obj")
    (folder / "out").mkdir()
    write_obj(folder / "out" / "b c.obj", mesh)
    back = read_obj(folder / "out" / "b c.obj")
    assert_same_mesh(back, mesh)
    # Images have the same bytes, and known lines of materials are kept.
    assert (folder / "out" / "my wall.png").read_bytes() == RED
    assert (folder / "out" / "bump map.png").read_bytes() == BLUE
    lines = (folder / "out" / "b c.mtl").read_text().splitlines()
    assert lines == [
        "newmtl red wall",
        "Kd 0.8 0.8 0.8",
        "Ns 12.5",
        "map_Kd -s 1 1 1 -clamp on my wall.png",
        "map_Bump -bm 0.3 bump map.png",
        "newmtl glass",
        "Kd 0.25 0.5 1",
        "d 0.5",
        "newmtl unknown",
    ]


def test_images_of_other_files_are_not_overwritten(folder):
    mesh = read_obj(folder / "made.obj")
    out = folder / "out"
    out.mkdir()
    (out / "my wall.png").write_bytes(BLUE)
    write_obj(out / "a.obj", mesh)
    assert (out / "my wall.png").read_bytes() == BLUE
    assert (out / "a_my wall.png").read_bytes() == RED
    assert_same_mesh(read_obj(out / "a.obj"), mesh)


def test_computed_images_and_repeated_names_get_file_names(tmp_path):
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    images = (Image(given=pixels), Image("../a\nb?.png", RED), Image("../a\nb?.png", BLUE))
    materials = tuple(Material("same", image) for image in images)
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]] * 4, np.int32))
    uvs = np.random.default_rng(0).random((4, 3, 2))
    mesh = mesh.with_(texture=Texture(uvs, np.array([2, -1, 0, 1], np.int32), materials))
    write_obj(tmp_path / "m.obj", mesh)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "a_b_.png", "m.mtl", "m.obj", "m_0.png", "m_a_b_.png",
    ]  # fmt: skip
    back = read_obj(tmp_path / "m.obj")
    # Materials are in order of their first use.
    assert [m.name for m in back.texture.materials] == ["same_3", "same", "same_2"]
    assert back.texture.material_ids.tolist() == [0, -1, 1, 2]
    assert [m.image.encoded for m in back.texture.materials][::2] == [BLUE, RED]
    np.testing.assert_array_equal(back.texture.materials[1].image.pixels, pixels)


def test_a_replaced_image_is_written(folder):
    mesh = read_obj(folder / "made.obj")
    wall, glass, _ = mesh.texture.materials
    new = Material(wall.name, Image("new.png", BLUE), wall.base_color, wall.wrap, wall.kept)
    painted = Material(glass.name, None, (1.0, 0.0, 0.0, 1.0), glass.wrap, glass.kept)
    texture = Texture(mesh.texture.uvs, mesh.texture.material_ids, (new, painted, Material("unknown")))
    write_obj(folder / "again.obj", mesh.with_(texture=texture))
    back = read_obj(folder / "again.obj").texture.materials
    assert back[0].image.encoded == BLUE
    assert back[1].base_color == (1, 0, 0, 1)
    assert "Ns 12.5" in (folder / "again.mtl").read_text()


@pytest.mark.parametrize("kind", ["missing", "junk", "folder"])
def test_an_unreadable_image_does_not_affect_the_mesh(folder, kind):
    (folder / "my wall.png").unlink()
    if kind == "junk":
        (folder / "my wall.png").write_bytes(b"<html>not found</html>")
    if kind == "folder":
        (folder / "my wall.png").mkdir()
    mesh = read_obj(folder / "made.obj")
    assert len(mesh.triangles) == 5
    wall = mesh.texture.materials[0]
    assert wall.image is None
    assert wall.base_color == (0.8, 0.8, 0.8, 1)
    assert any("my wall.png" in one.message for one in mesh.diagnostics)
    write_obj(folder / "out.obj", mesh)
    assert "map_Kd -s 1 1 1 -clamp on my wall.png" in (folder / "out.mtl").read_text()


def test_an_undecodable_image_is_copied(folder):
    damaged = RED[:40] + bytes(60)
    (folder / "my wall.png").write_bytes(damaged)
    mesh = read_obj(folder / "made.obj")
    with collecting() as found:
        bake_vertex_colors(mesh)
    assert any("my wall.png cannot be decoded" in str(one) for one in found)
    assert [one.severity for one in found] == [Severity.WARNING]
    (folder / "out").mkdir()
    write_obj(folder / "out" / "made.obj", mesh)
    assert (folder / "out" / "my wall.png").read_bytes() == damaged


def test_invalid_texture_coordinates_are_dropped(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt nan 0\nvt 0 1\nvt 1 1\nf 1/1 2/2 3/3\nf 1/2 2/2 3/3\n")
    mesh = read_obj(path)
    assert mesh.texture.has_uvs().tolist() == [False, True]
    assert mesh.texture.uvs[1].tolist() == [[0, 1], [0, 1], [1, 1]]  # no area, but kept
    assert "1 triangles lose their texture" in mesh.diagnostics[0].message


def test_several_libraries_in_one_statement_are_read(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl one\nKd 1 0 0\n")
    (tmp_path / "b c.mtl").write_text("newmtl two\nKd 0 1 0\nnewmtl one\nKd 0 0 1\n")
    start = "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl one\nf 1 2 3\nusemtl two\nf 1 2 3\n"
    for statement in (
        "mtllib a.mtl b c.mtl",
        "mtllib a.mtl\nmtllib ./b c.mtl",
        "mtllib a.mtl\nmtllib C:\\x\\b c.mtl",
    ):
        (tmp_path / "m.obj").write_text(f"{statement}\n{start}")
        mesh = read_obj(tmp_path / "m.obj")
        assert mesh.diagnostics == ()
        assert [m.base_color for m in mesh.texture.materials] == [(1, 0, 0, 1), (0, 1, 0, 1)]


def test_colors_come_from_materials_without_images(folder):
    colored = bake_vertex_colors(read_obj(folder / "made.obj"))
    # Vertex 4 has corners with glass and with the wall.
    assert colored.colors[2].tolist() == [200, 10, 20]
    assert colored.colors[1].tolist() == [(200 + 63.75) // 2 + 1, (10 + 127.5) // 2 + 1, (20 + 255) // 2 + 1]


def test_latin_1_names_are_read(tmp_path):
    (tmp_path / "größe.png").write_bytes(RED)
    (tmp_path / "m.mtl").write_bytes("newmtl blau\nmap_Kd größe.png\n".encode("latin-1"))
    (tmp_path / "m.obj").write_bytes(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 1\ng süß\nusemtl blau\nf 1/1 2/1 3/1\n".encode(
            "latin-1"
        )
    )
    mesh = read_obj(tmp_path / "m.obj")
    assert mesh.part_names == ("süß",)
    assert mesh.texture.images[0].name == "größe.png"


UNUSUAL = {
    "comment": ("v 0 0 0\n", "v 0 0 0 # the first\n"),
    "indent": ("v 0 0 0\n", "  v 0 0 0\n"),
    "empty row": ("vt 0 0\n", "v \nvt\nf \t\nvt 0 0\n"),
}
USUAL = {
    "as it is": ("", ""),
    "tabs": ("v 0 0 0\n", "v\t0 \t0  0 \n"),
    "carriage returns": ("\n", "\r\n"),
    "carriage returns alone": ("\n", "\r"),
    "continued": ("v 0 0 0\n", "v 0 \\\n0 0\n"),
    "comments": ("vt 0 0\n", "# v 1 2 3\n\n#\ng body # of it\nvt 0 0\n"),
    "other words": ("vt 0 0\n", "vp 1\nfo 1 2 3\nl 1 2\ns off\nvt 0 0\n"),
    "no end": (MODEL, MODEL.rstrip()),
}


@pytest.mark.parametrize("name", [*UNUSUAL, *USUAL])
def test_both_statement_parsers_agree(monkeypatch, name):
    before, after = (UNUSUAL | USUAL)[name]
    data = (MODEL.replace(before, after) if before else MODEL).encode()
    in_bulk = obj_statements._sort_in_bulk(data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") + b"\n")
    if "\\" not in after:
        assert (in_bulk is None) == (name in UNUSUAL)
    found = obj_statements.sort_statements(data)
    monkeypatch.setattr(obj_statements, "_sort_in_bulk", lambda data: None)  # noqa: ARG005
    expected = obj_statements.sort_statements(data)
    for ours, theirs in zip(astuple(found), astuple(expected), strict=True):
        if isinstance(ours, bytes):
            assert [line.split() for line in ours.splitlines()] == [
                line.split() for line in theirs.splitlines()
            ]
        else:
            np.testing.assert_equal(ours, theirs)


@pytest.mark.parametrize("forms", ["{0}", "{0}/{0}", "{0}//{0}", "{0}/{0}/{0}", "mixed"])
def test_corners_of_each_form_are_read(tmp_path, forms):
    choices = ["{0}", "{0}/{0}", "{0}//{0}", "{0}/{0}/{0}", "{0}/", "{0}/{0}/"]
    written = [choices[i % 6] if forms == "mixed" else forms for i in range(3 * 40)]
    corners = [form.format(1 + i % 3 - 4 * (i % 2)) for i, form in enumerate(written)]
    faces = "".join(f"f {' '.join(corners[i : i + 3])}\n" for i in range(0, len(corners), 3))
    rows = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\nvn 0 1 0\nvn 1 0 0\n"
    (tmp_path / "a.obj").write_text(rows + faces)
    mesh = read_obj(tmp_path / "a.obj")
    assert mesh.triangles.ravel().tolist() == [i % 3 for i in range(120)]


@pytest.mark.parametrize("face", ["f 1 2 - 3", "f 1 2 3-", "f 1 -- 2 3", "f 1-2 3 1", "f - 1 2 3"])
def test_a_minus_sign_without_digits_is_refused(tmp_path, face):
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\n{face}\n")
    with pytest.raises(InputError, match=r"a\.obj: cannot be parsed: '[^']*-[^']*' is not a number"):
        read_obj(tmp_path / "a.obj")


def test_attributes_of_corners_stay_with_their_triangles(tmp_path):
    rng = np.random.default_rng(3)
    vertices, triangles = rng.normal(size=(9, 3)), rng.integers(0, 9, (60, 3)).astype(np.int32)
    uvs, normals = rng.random((60, 3, 2)) + 1, rng.normal(size=(60, 3, 3))
    uvs[rng.random(60) < 0.4] = 0
    normals[rng.random((60, 3)) < 0.4] = 0
    texture = Texture(uvs, rng.integers(-1, 2, 60).astype(np.int32), (Material("a"), Material("b")))
    parts = rng.integers(0, 2, 60).astype(np.int32)
    mesh = Mesh(
        vertices, triangles, texture=texture, corner_normals=normals, part_ids=parts, part_names=("x", "y")
    )
    write_obj(tmp_path / "a.obj", mesh)
    back = read_obj(tmp_path / "a.obj")
    np.testing.assert_array_equal(back.vertices, vertices)
    np.testing.assert_array_equal(back.triangles, triangles)
    np.testing.assert_array_equal(back.corner_normals, normals)
    np.testing.assert_array_equal(back.texture.uvs, uvs)
    assert [back.part_names[i] for i in back.part_ids] == [("x", "y")[i] for i in parts]
    named = [material.name for material in back.texture.materials]
    assert [named[i] if i >= 0 else None for i in back.texture.material_ids] == [
        "ab"[i] if i >= 0 else None for i in texture.material_ids
    ]


@pytest.mark.parametrize(("low", "is_plain"), [(0.125, True), (0.1, False)])
def test_clamping_is_only_written_where_it_has_an_effect(tmp_path, low, is_plain):
    """Half of one of four texels is 1/8. Many programs do not find an image name after an option."""
    uvs = np.array([[[low, 0.125], [0.875, 0.125], [0.875, 0.875]]])
    image = Image("paint.png", given=np.full((4, 4, 3), 90, np.uint8))
    texture = Texture(uvs, np.zeros(1, np.int32), (Material("paint", image, wrap=("clamp", "clamp")),))
    write_obj(tmp_path / "a.obj", Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32), texture=texture))
    assert ("map_Kd paint.png" in (tmp_path / "a.mtl").read_text()) == is_plain
    assert ("map_Kd -clamp on paint.png" in (tmp_path / "a.mtl").read_text()) != is_plain
