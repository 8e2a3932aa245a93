import numpy as np
import pytest

from scanloom.stages.comparing.compare import compare
from scanloom.stages.surface.mesh import Image, Material, Mesh, Texture
from scanloom.stages.surface.surface_color import compute_surface_colors, has_color, sample_bilinear

# Four texels in a row: 0, 80, 160, 240 of each channel.
ROW = np.repeat(np.uint8([[0, 80, 160, 240]])[..., None], 3, axis=2)
CENTERS = (np.arange(4) + 0.5) / 4


def at(u: np.ndarray) -> np.ndarray:
    return np.stack([u, np.full_like(u, 0.5)], axis=1)


def triangle(**changes) -> Mesh:
    return Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32)).with_(**changes)


def textured(material: Material, **changes) -> Mesh:
    uvs = np.array([[[0.125, 0.5], [0.875, 0.5], [0.125, 0.5]]])
    return triangle(texture=Texture(uvs, np.zeros(1, np.int32), (material,)), **changes)


def test_texels_are_met_at_their_centres_and_blended_between():
    assert sample_bilinear(ROW, at(CENTERS))[:, 0] == pytest.approx([0, 80, 160, 240])
    assert sample_bilinear(ROW, at(CENTERS[:-1] + 1 / 8))[:, 1] == pytest.approx([40, 120, 200])


def test_rows_go_down_as_v_goes_up():
    column = ROW.transpose(1, 0, 2)
    assert sample_bilinear(column, np.array([[0.5, 0.125], [0.5, 0.875]]))[:, 0] == pytest.approx([240, 0])


@pytest.mark.parametrize(
    ("wrap", "beyond"), [("repeat", [0, 80, 240]), ("clamp", [240, 240, 0]), ("mirror", [240, 160, 0])]
)
def test_beyond_its_edges_an_image_goes_on_as_its_material_says(wrap, beyond):
    u = np.array([1 + CENTERS[0], 1 + CENTERS[1], -CENTERS[0]])
    assert sample_bilinear(ROW, at(u), (wrap, "repeat"))[:, 0] == pytest.approx(beyond)


def test_far_coordinates_are_sampled_as_near_ones():
    assert sample_bilinear(ROW, at(CENTERS + 1e6))[:, 0] == pytest.approx([0, 80, 160, 240], abs=1e-3)


def test_a_texture_counts_before_vertex_colours():
    mesh = textured(Material(image=Image(given=ROW)), colors=np.full((3, 3), 7, np.uint8))
    assert compute_surface_colors(mesh, np.zeros(2, int), np.array([[1, 0, 0], [0.5, 0.5, 0]]))[
        :, 0
    ] == pytest.approx([0, 120])


def test_a_base_colour_stands_alone_or_tints_the_image():
    alone = textured(Material(base_color=(1, 0.5, 0, 1)))
    assert has_color(alone)
    assert compute_surface_colors(alone, np.zeros(1, int), np.eye(3)[:1])[0] == pytest.approx([255, 127.5, 0])
    tinted = textured(Material(image=Image(given=ROW), base_color=(1, 0, 1, 1)))
    assert compute_surface_colors(tinted, np.zeros(1, int), np.eye(3)[1:2])[0] == pytest.approx(
        [240, 0, 240], abs=1e-3
    )


def test_what_nothing_colours_is_grey():
    damaged = textured(Material(image=Image(encoded=b"no image")))
    assert not has_color(triangle())
    for mesh in (triangle(), damaged):
        assert (compute_surface_colors(mesh, np.zeros(1, int), np.eye(3)[:1]) == 128).all()


def test_compare_reads_textures():
    seen = textured(Material(image=Image(given=ROW)))
    same = compare(seen, seen, samples=2000)
    assert same.color.psnr == np.inf
    black = triangle(colors=np.zeros((3, 3), np.uint8))
    # The texture's ramp is 240 at one corner and 0 at two: the mean square over a triangle is a sixth.
    assert compare(seen, black, samples=100_000).color.rmse == pytest.approx(240 / np.sqrt(6), rel=5e-3)
