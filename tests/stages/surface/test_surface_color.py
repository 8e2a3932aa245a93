import numpy as np
import pytest

from scanloom.stages.comparing.compare import compare
from scanloom.stages.surface.mesh import Image, Material, Mesh, Texture
from scanloom.stages.surface.surface_color import compute_surface_colors, has_color, sample_bilinear

# Four texels in a row: 0, 80, 160, 240 of each channel.
ROW = np.repeat(np.uint8([[0, 80, 160, 240]])[..., None], 3, axis=2)
CENTERS = (np.arange(4) + 0.5) / 4


def make_uvs(u: np.ndarray) -> np.ndarray:
    return np.stack([u, np.full_like(u, 0.5)], axis=1)


def make_triangle(**changes) -> Mesh:
    return Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32)).with_(**changes)


def make_textured_triangle(material: Material, **changes) -> Mesh:
    uvs = np.array([[[0.125, 0.5], [0.875, 0.5], [0.125, 0.5]]])
    return make_triangle(texture=Texture(uvs, np.zeros(1, np.int32), (material,)), **changes)


def test_texels_are_exact_at_centres_and_interpolated_between():
    assert sample_bilinear(ROW, make_uvs(CENTERS))[:, 0] == pytest.approx([0, 80, 160, 240])
    assert sample_bilinear(ROW, make_uvs(CENTERS[:-1] + 1 / 8))[:, 1] == pytest.approx([40, 120, 200])


def test_image_rows_run_opposite_to_v():
    column = ROW.transpose(1, 0, 2)
    assert sample_bilinear(column, np.array([[0.5, 0.125], [0.5, 0.875]]))[:, 0] == pytest.approx([240, 0])


@pytest.mark.parametrize(
    ("wrap", "beyond"), [("repeat", [0, 80, 240]), ("clamp", [240, 240, 0]), ("mirror", [240, 160, 0])]
)
def test_wrap_modes_apply_beyond_the_edges(wrap, beyond):
    u = np.array([1 + CENTERS[0], 1 + CENTERS[1], -CENTERS[0]])
    assert sample_bilinear(ROW, make_uvs(u), (wrap, "repeat"))[:, 0] == pytest.approx(beyond)


def test_distant_coordinates_are_sampled_exactly():
    assert sample_bilinear(ROW, make_uvs(CENTERS + 1e6))[:, 0] == pytest.approx([0, 80, 160, 240], abs=1e-3)


def test_a_texture_has_priority_over_vertex_colours():
    mesh = make_textured_triangle(Material(image=Image(given=ROW)), colors=np.full((3, 3), 7, np.uint8))
    assert compute_surface_colors(mesh, np.zeros(2, int), np.array([[1, 0, 0], [0.5, 0.5, 0]]))[
        :, 0
    ] == pytest.approx([0, 120])


def test_a_base_colour_is_used_alone_or_tints_the_image():
    alone = make_textured_triangle(Material(base_color=(1, 0.5, 0, 1)))
    assert has_color(alone)
    assert compute_surface_colors(alone, np.zeros(1, int), np.eye(3)[:1])[0] == pytest.approx([255, 127.5, 0])
    tinted = make_textured_triangle(Material(image=Image(given=ROW), base_color=(1, 0, 1, 1)))
    assert compute_surface_colors(tinted, np.zeros(1, int), np.eye(3)[1:2])[0] == pytest.approx(
        [240, 0, 240], abs=1e-3
    )


def test_surface_without_colour_is_grey():
    damaged = make_textured_triangle(Material(image=Image(encoded=b"no image")))
    assert not has_color(make_triangle())
    for mesh in (make_triangle(), damaged):
        assert (compute_surface_colors(mesh, np.zeros(1, int), np.eye(3)[:1]) == 128).all()


def test_compare_reads_textures():
    seen = make_textured_triangle(Material(image=Image(given=ROW)))
    same = compare(seen, seen, samples=2000)
    assert same.color.psnr == np.inf
    black = make_triangle(colors=np.zeros((3, 3), np.uint8))
    # The texture ramp is 240 at one corner and 0 at two: the mean square over a triangle is a sixth.
    assert compare(seen, black, samples=100_000).color.rmse == pytest.approx(240 / np.sqrt(6), rel=5e-3)
