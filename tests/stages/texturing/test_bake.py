import cv2
import numpy as np
import pytest
import trimesh
from coloured_meshes import ball, color_trimesh, join_meshes, make_square, sample_inside, sheet

import scanloom.stages.texturing.atlas_painting as pages_module
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Image, Material, Mesh, Texture
from scanloom.stages.surface.surface_color import compute_surface_colors
from scanloom.stages.texturing.bake import bake
from scanloom.stages.texturing.codes import TEXTURE_BAKE_LEFT_OUT
from scanloom.stages.texturing.gap_filling import fill_gaps_smoothly


@pytest.mark.slow
def test_a_simplified_mesh_shows_the_colours_of_its_original():
    original = sheet(height=0.0, noise=0.0)
    baked = bake(make_square(), original, texel_size=0.004)
    triangles, weights, places = sample_inside(baked.mesh)
    seen = compute_surface_colors(baked.mesh, triangles, weights)
    assert seen[:, 0] == pytest.approx(255 * places[:, 0], abs=2.5)
    assert seen[:, 1] == pytest.approx(255 * places[:, 1], abs=2.5)
    # Six vertex colours of two triangles could not represent the stripes.
    in_stripe = ((places[:, 0] % 0.5) > 0.3) & ((places[:, 0] % 0.5) < 0.45)
    assert (seen[in_stripe, 2] > 80).all()
    assert baked.color.rmse < 2
    assert baked.vertex_color is None
    assert baked.mesh.colors is None


def test_texture_beats_vertex_colours_on_a_curved_surface():
    original = sheet()
    light = simplify(original, ratio=0.05).mesh
    baked = bake(light, original)
    assert baked.vertex_color is not None
    assert baked.color.psnr > baked.vertex_color.psnr + 6
    np.testing.assert_array_equal(baked.mesh.triangles, light.triangles)
    np.testing.assert_array_equal(baked.mesh.vertices, light.vertices)


def test_a_texture_is_baked_into_a_texture():
    checks = np.kron(np.indices((4, 4)).sum(axis=0) % 2, np.ones((16, 16)))[..., None] * np.uint8(
        [250, 60, 10]
    )
    mesh = make_square()
    # Texture coordinates cover the image twice, so it repeats.
    uvs = 2 * mesh.vertices[mesh.triangles][:, :, :2]
    materials = (Material(image=Image(given=checks.astype(np.uint8))),)
    original = mesh.with_(texture=Texture(uvs, np.zeros(2, np.int32), materials))
    baked = bake(make_square(), original)
    assert baked.texel_size <= 0.5 / 64
    triangles, weights, places = sample_inside(mesh)
    in_check = (np.abs((places[:, :2] * 8) % 1 - 0.5) < 0.3).all(axis=1)
    expected = compute_surface_colors(original, triangles, weights)
    seen = compute_surface_colors(baked.mesh, triangles, weights)
    assert np.abs(seen - expected)[in_check].max() < 3


def test_each_side_of_a_thin_sheet_keeps_its_colour():
    red, blue = np.uint8([[230, 20, 20]] * 4), np.uint8([[20, 20, 230]] * 4)
    original = join_meshes(
        make_square(0.01).with_(colors=red), make_square(0.0, turned=True).with_(colors=blue)
    )
    # The simplified sheets are in the wrong order: the upper side is closest to the lower side of the
    # original.
    light = join_meshes(make_square(0.003), make_square(0.007, turned=True))
    # A second part with a larger offset increases the search distance.
    aside = np.array([5, 0, 0.01])
    beside = make_square().with_(vertices=make_square().vertices + aside, colors=red)
    baked = bake(
        join_meshes(light, beside.with_(vertices=beside.vertices - (0, 0, 0.01), colors=None)),
        join_meshes(original, beside),
        texel_size=0.02,
    )
    triangles, weights, _ = sample_inside(baked.mesh)
    seen = compute_surface_colors(baked.mesh, triangles, weights)
    assert (seen[triangles < 2, 0] > 220).all()
    assert (seen[(triangles >= 2) & (triangles < 4), 2] > 220).all()
    assert baked.turned_ratio > 0.5


def test_halved_images_keep_the_colour_of_each_chart():
    # Squares without common vertices are in separate, adjacent charts.
    light = join_meshes(*(make_square(5.0 * number) for number in range(6)))
    palette = np.uint8([[250, 0, 0], [0, 250, 0], [0, 0, 250], [250, 250, 0], [0, 250, 250], [250, 0, 250]])
    original = light.with_(colors=np.repeat(palette, 4, axis=0))
    baked = bake(light, original, padding=8, texel_size=0.05)
    assert baked.sizes == ((128, 128),)
    assert baked.charts == 6
    assert baked.mip_levels == 2
    pixels = baked.mesh.texture.materials[0].image.pixels
    triangles, weights, _ = sample_inside(baked.mesh)
    texture = baked.mesh.texture
    for _ in range(baked.mip_levels + 1):
        halved = Material(image=Image(given=pixels), wrap=("clamp", "clamp"))
        shown = baked.mesh.with_(texture=Texture(texture.uvs, texture.material_ids, (halved,)))
        assert np.abs(compute_surface_colors(shown, triangles, weights) - palette[triangles // 2]).max() < 4
        pixels = cv2.resize(pixels, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)


def test_gaps_are_filled_from_their_surroundings():
    image, filled = np.zeros((32, 32, 3), np.float32), np.zeros((32, 32), bool)
    filled[4:10, 4:10], filled[20:26, 20:26] = True, True
    image[4:10, 4:10], image[20:26, 20:26] = (200, 100, 0), (0, 100, 200)
    full = fill_gaps_smoothly(image, filled, 3)
    assert (full[1:13, 5:9] == (200, 100, 0)).all()
    assert (full[..., 1] == 100).all()
    assert (full.astype(int).sum(axis=2) == 300).all()


@pytest.mark.slow
def test_the_same_meshes_give_the_same_image():
    original = sheet(n=12)
    light = simplify(original, ratio=0.2).mesh
    first, second = (bake(light, original).mesh.texture for _ in range(2))
    np.testing.assert_array_equal(first.uvs, second.uvs)
    np.testing.assert_array_equal(first.images[0].pixels, second.images[0].pixels)


@pytest.mark.parametrize("threads", [1, 3])
def test_threads_change_nothing(monkeypatch, threads):
    original = sheet(n=12)
    light = simplify(original, ratio=0.2).mesh
    expected = bake(light, original, samples=2).mesh.texture
    monkeypatch.setattr(pages_module, "get_worker_count", lambda: threads)
    monkeypatch.setattr(pages_module, "_BATCH_SAMPLES", 500)
    found = bake(light, original, samples=2).mesh.texture
    np.testing.assert_array_equal(found.images[0].pixels, expected.images[0].pixels)


def test_several_images_are_used_if_one_is_too_small():
    original = sheet()
    light = simplify(original, ratio=0.1).mesh
    whole, parts = (bake(light, original, texel_size=0.006, max_size=size) for size in (512, 64))
    assert len(whole.sizes) == 1
    assert len(parts.sizes) > 4
    texture = parts.mesh.texture
    assert [image.pixels.shape[:2] for image in texture.images] == [size[::-1] for size in parts.sizes]
    names = [f"baked-{number}" for number in range(1, len(parts.sizes) + 1)]
    assert [material.name for material in texture.materials] == names
    assert parts.texel_size <= 0.0065
    assert parts.color.psnr > whole.color.psnr - 2


def test_the_texel_size_grows_above_the_texel_limit():
    baked = bake(make_square(), sheet(n=40), texel_size=1e-5, max_texels=0.02)
    assert sum(width * height for width, height in baked.sizes) <= 4e4
    assert baked.texel_size > 0.005


def test_loose_triangles_fit_with_their_padding():
    """Each triangle needs padding; 2,000 triangles once did not fit into one image."""
    rng = np.random.default_rng(0)
    corners = rng.uniform(-1, 1, (2000, 1, 3)) + rng.uniform(-0.05, 0.05, (2000, 3, 3))
    triangles = np.arange(6000, dtype=np.int32).reshape(-1, 3)
    soup = Mesh(corners.reshape(-1, 3), triangles, np.full((6000, 3), 90, np.uint8))
    baked = bake(soup, soup, max_size=64, padding=8)
    assert baked.charts == 2000
    assert len(baked.sizes) > 100
    assert baked.color.rmse < 0.5


@pytest.mark.parametrize("size", [1e-45, 1e-6, 1.0, 1e6, 1e50])
def test_a_triangle_of_any_size_is_baked(size):
    colors = np.uint8([[255, 0, 0], [0, 255, 0], [0, 0, 255]])
    mesh = Mesh(size * np.eye(3), np.array([[0, 1, 2]], np.int32), colors)
    baked = bake(mesh, mesh)
    assert baked.color.psnr > 40
    assert baked.sizes == ((64, 64),)


def test_texels_beyond_a_border_show_the_border():
    """Colours that continue over the edges of a box are right up to each edge, in every chart."""
    box = color_trimesh(trimesh.creation.box()).with_(colors=None)
    fine = color_trimesh(trimesh.creation.box().subdivide().subdivide().subdivide())
    original = fine.with_(colors=np.uint8(127 + 120 * np.sin(3 * fine.vertices)))
    baked = bake(box, original, texel_size=0.05)
    share = np.linspace(0, 1, 50)
    triangles, weights = (
        np.repeat(np.arange(12), 50),
        np.tile(np.stack([share, 1 - share, 0 * share], 1), (12, 1)),
    )
    places = np.einsum("kc,kcx->kx", weights, box.vertices[box.triangles[triangles]])
    seen = compute_surface_colors(baked.mesh, triangles, weights)
    assert np.abs(seen - (127 + 120 * np.sin(3 * places))).mean() < 3


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1e-2, 1e-4])
def test_a_much_smaller_original_needs_no_large_image(scale):
    """Earlier, a triangle of 1 m got 16 million texels for the few colours of a tiny sphere."""
    original = ball()
    small = original.with_(vertices=original.vertices * scale)
    baked = bake((np.eye(3), np.array([[0, 1, 2]])), small)
    assert max(max(baked.sizes)) <= 512
    assert baked.samples <= 2


@pytest.mark.slow
def test_tiny_triangles_next_to_large_ones_need_no_large_image():
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(60, 3)) * np.repeat(10.0 ** rng.uniform(-6, 0, 20), 3)[:, None]
    triangles = np.arange(60, dtype=np.int32).reshape(-1, 3)
    soup = Mesh(corners, triangles, np.full((60, 3), 128, np.uint8))
    assert max(max(bake(soup, soup).sizes)) <= 512


def add_texture(mesh: Mesh, image: np.ndarray, repeats: float) -> Mesh:
    """Texture a mesh over the unit square with an image that repeats `repeats` times in each direction."""
    uvs = repeats * mesh.vertices[mesh.triangles][..., :2]
    material_ids = np.zeros(len(mesh.triangles), np.int32)
    return mesh.with_(colors=None, texture=Texture(uvs, material_ids, (Material(image=Image(given=image)),)))


@pytest.mark.slow
@pytest.mark.parametrize("repeats", [5e3, 1e15])
def test_an_image_with_many_repeats_becomes_its_mean(repeats):
    """Such an image once got 16 million texels of 16 samples that showed noise."""
    image = np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)
    original = add_texture(make_square(), image, repeats)
    baked = bake(make_square(), original)
    assert max(max(baked.sizes)) < 512
    triangles, weights, _ = sample_inside(baked.mesh)
    assert np.abs(compute_surface_colors(baked.mesh, triangles, weights) - image.mean(axis=(0, 1))).max() < 1
    (diagnostic,) = baked.diagnostics
    ((width, height),) = baked.sizes
    assert f"images of {width} × {height} texels cannot show all detail" in str(diagnostic)


def test_details_that_are_too_fine_are_averaged():
    """Three stripes of one texel are within one baked texel; formerly only some of them were sampled."""
    image = np.zeros((512, 512, 3), np.uint8)
    image[:, ::2] = 200
    baked = bake(make_square(), add_texture(make_square(), image, 1.0), max_texels=0.01)
    triangles, weights, _ = sample_inside(baked.mesh)
    assert compute_surface_colors(baked.mesh, triangles, weights) == pytest.approx(100, abs=20)
    assert [one.code for one in baked.diagnostics] == [TEXTURE_BAKE_LEFT_OUT.name]


def test_progress_can_stop_baking():
    def stop(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bake(make_square(), sheet(n=4), progress=stop)


def test_invalid_input_is_reported():
    with pytest.raises(MeshError, match=r"original: .*neither vertex colours nor a texture"):
        bake(make_square(), make_square(0.1), normal_map=False, occlusion_map=False)
    with pytest.raises(MeshError, match="simplified mesh"):
        bake((np.zeros((3, 3)), np.array([[0, 1, 2]])), sheet(n=4))
    needle = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-12, 0]])
    with pytest.raises(MeshError, match="needles"):
        bake((needle, np.array([[0, 1, 2]])), sheet(n=4))
    with pytest.raises(UsageError, match="power of two"):
        bake(make_square(), sheet(n=4), max_size=1000)
    with pytest.raises(UsageError, match="at most a quarter of max_size"):
        bake(make_square(), sheet(n=4), max_size=64, padding=64)
