"""Normal, occlusion and displacement maps of a detailed surface on a coarse mesh."""

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from browsers import PAGE, run_node
from coloured_meshes import ball, join_meshes, make_square, sample_inside, sheet

from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.rendering.render import render, viewpoints
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Material, Mesh, Texture
from scanloom.stages.surface.mesh_files import read_mesh, write_mesh
from scanloom.stages.texturing.atlas_layout import AtlasLayout, lay_out_smallest
from scanloom.stages.texturing.bake import bake
from scanloom.stages.texturing.detail_maps import DetailBaker
from scanloom.stages.texturing.normal_map import attach_maps, bake_normal_map, make_images
from scanloom.stages.texturing.shading_normals import (
    NormalMaps,
    ShadingNormals,
    add_shading_normals,
    has_normal_map,
)

VALIDATE = Path(__file__).resolve().parents[2] / "made" / "validate_glb.cjs"

WAVES, HEIGHT = 3, 0.02
SLOPE = 2 * math.pi * WAVES * HEIGHT


def make_waves(n: int = 240) -> Mesh:
    """Make a sine relief over the unit square."""
    flat = sheet(n=n, noise=0.0, height=0.0)
    z = HEIGHT * np.sin(2 * math.pi * WAVES * flat.vertices[:, 0])
    return flat.with_(vertices=np.column_stack([flat.vertices[:, :2], z]))


def compute_wave_normals(x: np.ndarray) -> np.ndarray:
    slope = SLOPE * np.cos(2 * math.pi * WAVES * x)
    normals = np.column_stack([-slope, np.zeros_like(x), np.ones_like(x)])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def read_normals(mesh: Mesh, triangles: np.ndarray, weights: np.ndarray) -> np.ndarray:
    normals = np.zeros((len(triangles), 3), np.float32)
    NormalMaps(mesh).apply(normals, triangles, weights)
    return normals


def measure_angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.einsum("kx,kx->k", a, b).clip(-1, 1)))


def lay_out(mesh: Mesh, texel_size: float) -> AtlasLayout:
    return lay_out_smallest(
        mesh, texel_size, max_side=4096, max_texels=4e6, padding=None, progress=lambda *_: None
    )


def attach_normal_map(mesh: Mesh, original: Mesh, pages: AtlasLayout) -> Mesh:
    """Attach a normal map as PNG to a mesh with a bare material per image."""
    mesh = mesh.with_(texture=Texture(pages.uvs, pages.images, tuple(Material() for _ in pages.sizes)))
    shaded = add_shading_normals(mesh, pages.uvs)
    images = DetailBaker(shaded, original, pages).bake_normals()
    files = [cv2.imencode(".png", one[:, :, ::-1])[1].tobytes() for one in images]
    return attach_maps(shaded, {"normalTexture": make_images(files, "normal", "png")})


def test_the_map_of_a_mesh_for_itself_is_flat():
    mesh = sheet(n=20, noise=0.0)
    pages = lay_out(mesh, 0.01)
    shaded = add_shading_normals(mesh, pages.uvs)
    (image,) = DetailBaker(shaded, mesh, pages).bake_normals()
    deviations = np.abs(image.astype(int) - (128, 128, 255)).max(axis=2)
    assert (deviations > 1).mean() < 0.02  # texels beyond the border of the chart
    triangles, weights, _ = sample_inside(mesh)
    mapped = read_normals(attach_normal_map(mesh, mesh, pages), triangles, weights)
    angles = measure_angles(mapped, ShadingNormals(shaded)(triangles, weights))
    # 8 bits cannot represent 0 exactly. The border of the chart mixes in texels beyond it.
    assert np.percentile(angles, 99) < 0.5
    assert angles.max() < 1.5


def test_a_relief_is_recovered_on_a_plane():
    baked = bake(make_square(), make_waves(), texel_size=0.004).mesh
    triangles, weights, places = sample_inside(baked)
    angles = measure_angles(read_normals(baked, triangles, weights), compute_wave_normals(places[:, 0]))
    # 8 bits resolve 0.45°.
    assert np.median(angles) < 0.3
    assert angles[(np.abs(places[:, :2] - 0.5) < 0.49).all(axis=1)].max() < 0.5


def test_a_relief_is_recovered_in_mirrored_charts():
    square, waves = make_square(), make_waves()
    pages = lay_out(square, 0.004)
    width = pages.sizes[0][0]
    mirrored = replace(pages, corners=np.ascontiguousarray(pages.corners * (-1, 1) + (width, 0)))
    triangles, weights, places = sample_inside(square)
    inside = (np.abs(places[:, :2] - 0.5) < 0.49).all(axis=1)
    for layout in (pages, mirrored):
        mapped = attach_normal_map(square, waves, layout)
        angles = measure_angles(read_normals(mapped, triangles, weights), compute_wave_normals(places[:, 0]))
        assert angles[inside].max() < 0.5


def test_normals_are_continuous_across_charts():
    original = ball()
    light = simplify(original, ratio=0.1).mesh
    pages = lay_out(light, 0.01)
    mapped = attach_normal_map(light, original, pages)
    # Both triangles of each side, at the middle of the side.
    sides = np.sort(light.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    order = np.lexsort(sides.T)
    one, other = order[::2], order[1::2]
    assert (sides[one] == sides[other]).all()
    is_border = pages.charts[one // 3] != pages.charts[other // 3]
    assert is_border.sum() > 20
    middles = np.array([[0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]])
    first, second = (
        read_normals(mapped, side[is_border] // 3, middles[side[is_border] % 3]) for side in (one, other)
    )
    angles = measure_angles(first, second)
    assert np.median(angles) < 0.5
    assert angles.max() < 2


def test_normals_are_hard_only_at_borders_of_charts():
    # Two squares that meet at a right angle.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1]], float)
    mesh = Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3], [0, 4, 5], [0, 5, 1]], np.int32))
    flat = np.array([[0, 0, 1], [0, 0, 1], [0, 1, 0], [0, 1, 0]], float)
    shared = vertices[:, [0, 2]] - vertices[:, [2, 1]]
    separate = shared[mesh.triangles].copy()
    separate[2:] += 5
    hard, soft = (add_shading_normals(mesh, uvs).corner_normals for uvs in (separate, shared[mesh.triangles]))
    assert np.abs(hard - flat[:, None]).max() < 1e-12
    assert np.abs(soft[:, 0] - np.array([0, 1, 1]) / math.sqrt(2)).max() < 1e-12


def test_a_normal_map_lowers_the_shading_error():
    original = sheet(n=120, noise=0.0)
    baked = bake(simplify(original, ratio=0.02).mesh, original)
    assert baked.shading_after.median_deg < 0.5
    assert baked.shading_after.p90_deg < baked.shading_before.p90_deg / 4
    assert baked.to_dict()["shading_error_after"]["mean_deg"] == baked.shading_after.mean_deg


def test_occlusion_in_a_corner_follows_the_form_factor():
    height, length = 0.5, 20.0
    floor = np.array([[0, -length, 0], [4, -length, 0], [4, length, 0], [0, length, 0]], float)
    wall = np.array([[0, -length, 0], [0, length, 0], [0, length, height], [0, -length, height]], float)
    quad = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    corner = join_meshes(Mesh(floor, quad), Mesh(wall, quad))
    pages = lay_out(corner, 0.05)
    baker = DetailBaker(add_shading_normals(corner, pages.uvs), corner, pages)
    (image,) = baker.bake_occlusion(100.0)
    for distance in (0.25, 0.5, 1.0, 2.0):
        # The point on the floor in the middle of the wall's length.
        weights = np.linalg.solve(np.column_stack([floor[[0, 1, 2], :2], np.ones(3)]).T, [distance, 0.0, 1.0])
        triangle = 0
        if weights.min() < 0:
            triangle = 1
            weights = np.linalg.solve(
                np.column_stack([floor[[0, 2, 3], :2], np.ones(3)]).T, [distance, 0.0, 1.0]
            )
        x, y = (weights @ pages.corners[triangle]).astype(int)
        factor = image.shape[0] / pages.sizes[0][1]
        found = image[int(y * factor), int(x * factor), 0] / 255
        # View factor of an infinite perpendicular strip.
        expected = 1 - 0.5 * (1 - math.cos(math.atan(height / distance)))
        assert found == pytest.approx(expected, abs=0.02)


def test_surface_beyond_the_distance_does_not_occlude():
    two = join_meshes(make_square(), make_square(0.5))
    near, far = (
        bake(two, two, texel_size=0.05, occlusion_distance=distance, normal_map=False)
        for distance in (1.0, 0.4)
    )
    shades = [
        cv2.imdecode(np.frombuffer(one.maps["occlusion"][0], np.uint8), cv2.IMREAD_UNCHANGED)
        for one in (near, far)
    ]
    assert shades[0].min() < 200
    assert (shades[1] == 255).all()


def test_displacements_are_heights_over_the_mesh():
    baked = bake(make_square(), make_waves(), texel_size=0.004, displacement_map=True)
    assert baked.displacement_range == pytest.approx(HEIGHT, rel=0.02)
    steps = cv2.imdecode(np.frombuffer(baked.maps["displacement"][0], np.uint8), cv2.IMREAD_UNCHANGED)
    assert steps.dtype == np.uint16
    heights = (steps.astype(float) - 32768) / 32767 * baked.displacement_range
    triangles, weights, places = sample_inside(baked.mesh)
    uvs = np.einsum("kc,kcx->kx", weights, baked.mesh.texture.uvs[triangles])
    rows, columns = ((1 - uvs[:, 1]) * steps.shape[0]).astype(int), (uvs[:, 0] * steps.shape[1]).astype(int)
    expected = HEIGHT * np.sin(2 * math.pi * WAVES * places[:, 0])
    # Half a texel on the steepest slope.
    assert np.abs(heights[rows, columns] - expected).max() < SLOPE * 0.004
    assert set(baked.list_map_files("a", ".glb")) == {"a-displacement.png"}
    assert set(baked.list_map_files("a", ".obj")) == {"a-displacement.png", "a-normal.png", "a-occlusion.png"}


def test_a_mesh_without_colours_gets_maps():
    original = make_waves().with_(colors=None)
    baked = bake(make_square(), original, texel_size=0.01)
    assert baked.color is None
    assert has_normal_map(baked.mesh)
    assert baked.mesh.texture.materials[0].image is None
    with pytest.raises(MeshError, match="no map is requested"):
        bake(make_square(), original, normal_map=False, occlusion_map=False)


def test_maps_are_the_same_each_time():
    original = sheet(n=40)
    light = simplify(original, ratio=0.1).mesh
    first, second = (bake(light, original, displacement_map=True).maps for _ in range(2))
    assert first == second


@pytest.mark.parametrize("max_bytes", [0, 20_000, 200_000])
def test_a_normal_map_stays_within_its_bytes(max_bytes):
    original = sheet(n=80, noise=0.002)
    light = simplify(original, ratio=0.05).mesh
    pages = lay_out(light, 0.004)
    bare = light.with_(
        colors=None, texture=Texture(pages.uvs, pages.images, tuple(Material() for _ in pages.sizes))
    )
    found = bake_normal_map(bare, original, pages, max_bytes)
    assert found.image_bytes <= max_bytes
    assert (found.mesh is None) == (max_bytes == 0)
    if found.mesh is not None:
        assert found.error_after.mean_deg < found.error_before.mean_deg
        assert found.format == ("png" if max_bytes == 200_000 else "jpeg")


def test_pictures_show_normal_maps():
    waves = make_waves(120)
    baked = bake(make_square(), waves, texel_size=0.005).mesh
    (view,) = viewpoints(waves, 1)
    bare = make_square()
    seen, plain, expected = (render(one, view, shading="plain").astype(float) for one in (baked, bare, waves))
    assert np.abs(seen - expected).mean() < np.abs(plain - expected).mean() / 2


def test_files_with_maps_are_valid(tmp_path):
    original = sheet(n=40)
    baked = bake(simplify(original, ratio=0.1).mesh, original)
    write_mesh(tmp_path / "a.glb", baked.mesh)
    back = read_mesh(tmp_path / "a.glb")
    tree = back.texture.materials[0].kept.tree
    assert {"normalTexture", "occlusionTexture"} <= set(tree)
    triangles, weights, _ = sample_inside(back, 500)
    expected = read_normals(baked.mesh, triangles, weights)
    assert measure_angles(read_normals(back, triangles, weights), expected).max() < 0.1
    found = run_node(VALIDATE, PAGE, tmp_path)
    # Viewers compute MikkTSpace tangents; stored tangents would take 16 bytes per vertex.
    tolerated = {"MESH_PRIMITIVE_GENERATED_TANGENT_SPACE"}
    assert {one["code"] for one in found["a.glb"] if one["severity"] < 2} <= tolerated


def test_given_normals_of_the_original_count():
    square = make_square()
    tilted = square.with_(normals=np.tile([0.6, 0.0, 0.8], (4, 1)), colors=None)
    triangles, weights, _ = sample_inside(square, 100)
    assert np.abs(ShadingNormals(tilted)(triangles, weights) - [0.6, 0, 0.8]).max() < 1e-6
    baked = bake(square, tilted, texel_size=0.05).mesh
    assert (
        measure_angles(read_normals(baked, triangles, weights), np.tile([0.6, 0, 0.8], (100, 1))).max() < 0.5
    )
