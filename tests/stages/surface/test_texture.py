"""Invariants of textures: one material and three coordinates per triangle, unchanged images."""

import numpy as np
import pytest

from scanloom.stages.cleaning.clean import clean
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import as_mesh, bake_vertex_colors
from scanloom.stages.surface.spatial_order import permute_rows
from scanloom.stages.surface.texture import Image, Material, Texture

TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
SQUARE = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], float)
TEXTURE = Texture(SQUARE[TRIANGLES][..., :2] + 1, np.array([0, 1], np.int32), (Material("a"), Material("b")))


def make_square(**changes) -> Mesh:
    return Mesh(SQUARE, TRIANGLES, texture=TEXTURE).with_(**changes)


@pytest.mark.parametrize(
    ("mesh", "sentence"),
    [
        (make_square(triangles=TRIANGLES[:1]), "2 × 3 texture coordinates .* for 1 triangles"),
        (
            make_square(texture=Texture(TEXTURE.uvs, np.array([0, 2]), TEXTURE.materials)),
            "beyond the 2 texture",
        ),
        (
            make_square(texture=Texture(TEXTURE.uvs * np.nan, TEXTURE.material_ids)),
            "of triangle 0 are .* not finite",
        ),
        (make_square(texture=Texture(TEXTURE.uvs[..., :1], TEXTURE.material_ids)), "m × 3 × 2"),
        (make_square(corner_normals=np.zeros((1, 3, 3))), "1 corner normals for 2 triangles"),
        (make_square(corner_normals=np.zeros((2, 3))), "corner normals have shape"),
        (make_square(part_ids=np.array([0, 1]), part_names=("one",)), "beyond the 1 part names"),
        (make_square(part_ids=np.array([0]), part_names=("one",)), "1 part indices for 2 triangles"),
    ],
)
def test_inconsistent_textures_are_refused(mesh, sentence):
    with pytest.raises(MeshError, match=sentence):
        as_mesh(mesh)


def test_selected_triangles_keep_their_attributes():
    normals = np.arange(18.0).reshape(2, 3, 3)
    mesh = make_square(corner_normals=normals, part_ids=np.array([0, 1], np.int32), part_names=("p", "q"))
    other = mesh.with_triangles(np.array([[2, 3, 0], [0, 1, 3], [0, 1, 2]], np.int32), np.array([1, -1, 0]))
    assert as_mesh(other).texture.material_ids.tolist() == [1, -1, 0]
    assert other.part_ids.tolist() == [1, -1, 0]
    np.testing.assert_array_equal(other.texture.uvs[[0, 2]], TEXTURE.uvs[::-1])
    np.testing.assert_array_equal(other.corner_normals[[0, 2]], normals[::-1])
    assert not other.texture.uvs[1].any()
    assert not other.corner_normals[1].any()
    masked = mesh.with_triangles(TRIANGLES[1:], np.array([False, True]))
    assert (masked.texture.material_ids.tolist(), masked.part_ids.tolist()) == ([1], [1])
    turned = permute_rows(mesh, np.array([3, 1, 2, 0], np.uint32), np.array([1, 0], np.uint32))
    assert as_mesh(turned).part_ids.tolist() == [1, 0]


def test_cleaning_keeps_parts_and_normals_of_corners():
    # The second triangle is flipped, the third is degenerate.
    triangles = np.array([[0, 1, 2], [0, 3, 2], [1, 1, 2]], np.int32)
    normals = np.arange(27.0).reshape(3, 3, 3)
    mesh = Mesh(
        SQUARE,
        triangles,
        corner_normals=normals,
        part_ids=np.array([0, 1, 0], np.int32),
        part_names=("p", "q"),
    )
    result = clean(mesh, min_island_area=0.0)
    assert result.mesh.part_ids.tolist() == [0, 1]
    assert result.changes.flipped_triangles == 1
    for row, source in enumerate(result.triangle_source):
        for corner, vertex in enumerate(result.vertex_source[result.mesh.triangles[row]]):
            old = triangles[source].tolist().index(vertex)
            np.testing.assert_array_equal(result.mesh.corner_normals[row, corner], normals[source, old])


def sample_color(uv, image, **material) -> list[int]:
    uvs = np.broadcast_to(np.array(uv, float), (1, 3, 2))
    texture = Texture(uvs, np.zeros(1, np.int32), (Material(image=Image(given=image), **material),))
    return bake_vertex_colors(Mesh(np.eye(3), np.array([[0, 1, 2]]), texture=texture)).colors[0].tolist()


@pytest.mark.parametrize(
    ("way", "reds"),
    [
        # At u = -0.125, 0.125, 0.375, 1.0, 1.125 and 2.125 of texels 0, 80, 160, 240.
        ("repeat", [240, 0, 80, 120, 0, 0]),
        ("clamp", [0, 0, 80, 240, 240, 240]),
        ("mirror", [0, 0, 80, 240, 240, 0]),
    ],
)
def test_wrap_modes_extend_images(way, reds):
    image = np.zeros((1, 4, 3), np.uint8)
    image[0, :, 0] = [0, 80, 160, 240]
    found = [
        sample_color((u, 0.3), image, wrap=(way, "repeat"))[0]
        for u in (-0.125, 0.125, 0.375, 1.0, 1.125, 2.125)
    ]
    assert found == reds
    turned = image.transpose(1, 0, 2)[::-1]
    assert [
        sample_color((0.3, v), turned, wrap=("repeat", way))[0]
        for v in (-0.125, 0.125, 0.375, 1.0, 1.125, 2.125)
    ] == reds
    assert len(sample_color((1e300, -1e300), image, wrap=(way, way))) == 3


def test_the_base_color_multiplies_light():
    image = np.full((1, 1, 3), 188, np.uint8)  # half the light of white
    color = (1.0, 0.7353569, 0.0, 1.0)  # the second channel is half the light, too
    assert sample_color((0.5, 0.5), image, base_color=color) == pytest.approx([188, 137, 0], abs=1)


def test_images_are_decoded_on_access():
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 4)).astype(np.uint8)
    image = Image("a.png", Image(given=pixels).file_bytes)
    assert (image.extension, image.mime) == (".png", "image/png")
    np.testing.assert_array_equal(image.pixels, pixels)
    assert image.file_bytes is image.encoded
    with pytest.raises(MeshError, match=r"b\.png cannot be decoded"):
        _ = Image("b.png", b"\x89PNG\r\n\x1a\n").pixels


def test_grey_deep_and_unusual_images():
    import io

    import cv2
    import PIL.Image

    grey = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
    deep = cv2.imencode(".png", grey.astype(np.uint16) * 257)[1].tobytes()
    np.testing.assert_array_equal(Image("deep.png", deep).pixels[..., 0], grey)
    stored = io.BytesIO()
    PIL.Image.fromarray(np.dstack([grey, grey, grey])).save(stored, "TGA")
    image = Image("a.tga", stored.getvalue())
    assert image.extension == ".tga"
    np.testing.assert_array_equal(image.pixels[..., 2], grey)
