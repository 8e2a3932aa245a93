import json
import math

import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st

from scanloom.stages.comparing.compare import CompareParams, compare
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface


def make_grid(n: int = 9, width: float = 1.0, height: float = 0.0, color=None) -> Mesh:
    """Make a flat square [0, width] × [0, 1] at z = height with n × n vertices."""
    x, y = np.meshgrid(np.linspace(0, width, n), np.linspace(0, 1, n))
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    triangles = np.concatenate([np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + n + 1, i + n], 1)])
    colors = None if color is None else np.tile(np.uint8(color), (n * n, 1))
    vertices = np.stack([x.ravel(), y.ravel(), np.full(n * n, height)], axis=1)
    return Mesh(vertices, triangles.astype(np.int32), colors)


def make_sphere(radius: float, subdivisions: int = 5) -> Mesh:
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return Mesh(np.asarray(ball.vertices), np.asarray(ball.faces, np.int32))


def test_distances_of_parallel_planes_equal_their_gap():
    result = compare(make_grid(), make_grid(n=4, height=0.03), samples=20_000)
    for side in (result.a_to_b, result.b_to_a, result.symmetric):
        assert [side.maximum, side.mean, side.rms] == pytest.approx([0.03] * 3, rel=1e-6)
    assert result.diagonal == pytest.approx(math.sqrt(2))
    relative = result.to_dict()["distance"]["symmetric"]["rms_relative"]
    assert relative == pytest.approx(0.03 / math.sqrt(2))


def test_distances_of_concentric_spheres_equal_the_difference_of_radii():
    result = compare(make_sphere(1.0), make_sphere(1.01), samples=50_000)
    # Chords of the triangulation are up to 2e-4 below either sphere.
    for side in (result.a_to_b, result.b_to_a):
        assert [side.maximum, side.mean, side.rms] == pytest.approx([0.01] * 3, abs=3e-4)


def test_a_missing_half_affects_one_direction_only():
    # From [0, 1]² to its left half: the distance is x - 1/2 on the right half.
    result = compare(make_grid(), make_grid(width=0.5), samples=200_000)
    assert result.a_to_b.maximum == pytest.approx(0.5)
    assert result.a_to_b.mean == pytest.approx(1 / 8, rel=1e-3)
    assert result.a_to_b.rms == pytest.approx(math.sqrt(1 / 24), rel=1e-3)
    assert result.b_to_a.maximum == pytest.approx(0, abs=1e-6)
    assert result.symmetric.maximum == pytest.approx(0.5)
    assert result.symmetric.mean == pytest.approx(1 / 16, rel=1e-3)


def test_the_maximum_includes_a_spike_too_thin_for_sampling():
    flat = make_grid()
    spike = np.array([[0.5, 0.5, 0], [0.5 + 1e-9, 0.5, 0], [0.5, 0.5, 0.7]])
    spiked = Mesh(np.vstack([flat.vertices, spike]), np.vstack([flat.triangles, [[81, 82, 83]]]))
    result = compare(flat, spiked, samples=1000)
    assert result.b_to_a.maximum == pytest.approx(0.7)
    assert result.b_to_a.mean < 1e-3


def test_a_vertex_without_triangle_is_ignored():
    flat = make_grid()
    result = compare(flat, flat.with_(vertices=np.vstack([flat.vertices, [[0, 0, 9.0]]])), samples=1000)
    assert result.symmetric.maximum < 1e-12


@settings(max_examples=40, deadline=None)
@example(8417886, 23, 0.0)  # A sliver whose single-precision closest point hid a nearer triangle.
@given(st.integers(0, 2**32 - 1), st.integers(1, 30), st.sampled_from([0.0, 1e-9, 1.0]))
def test_closest_points_agree_with_brute_force(seed, count, flatness):
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(count, 3, 3))
    # Slivers and triangles without area: the third corner moves to the middle of an edge.
    thin = rng.random(count) < 0.3
    corners[thin, 2] = corners[thin, :2].mean(axis=1) + flatness * rng.normal(size=(thin.sum(), 3))
    mesh = Mesh(corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3))
    points = rng.normal(size=(50, 3)) * 1.5
    found = RaycastingSurface(mesh, np.array([[-8.0] * 3, [8.0] * 3])).find_closest_points(points)
    assert (found.weights >= 0).all()
    np.testing.assert_allclose(found.weights.sum(axis=1), 1, atol=1e-12)
    nearest = np.min(
        [
            np.linalg.norm(_compute_closest_candidates(points, t) - points[None], axis=2).min(axis=0)
            for t in corners
        ],
        axis=0,
    )
    np.testing.assert_allclose(found.distances, nearest, atol=3e-5)


def _compute_closest_candidates(points, triangle):
    """Compute candidates for the closest point: on three edges, and on the plane if inside."""
    candidates = []
    for i in range(3):
        start, edge = triangle[i], triangle[(i + 1) % 3] - triangle[i]
        along = np.clip((points - start) @ edge / max(edge @ edge, 1e-300), 0, 1)
        candidates.append(start + along[:, None] * edge)
    normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
    if np.linalg.norm(normal) > 1e-7:
        unit = normal / np.linalg.norm(normal)
        foot = points - ((points - triangle[0]) @ unit)[:, None] * unit
        turns = [
            np.cross(triangle[(i + 1) % 3] - triangle[i], foot - triangle[i]) @ unit >= 0 for i in range(3)
        ]
        candidates.append(np.where(np.all(turns, axis=0)[:, None], foot, candidates[0]))
    return np.array(candidates)


def test_metrics_agree_with_trimesh_on_its_own_samples():
    a = make_sphere(0.3, subdivisions=2)
    rng = np.random.default_rng(3)
    b = a.with_(vertices=a.vertices * (1 + 0.05 * rng.normal(size=(len(a.vertices), 1))))
    points, _ = trimesh.sample.sample_surface(
        trimesh.Trimesh(a.vertices, a.triangles, process=False), 2000, seed=5
    )
    points = np.vstack([points, a.vertices])
    every = np.repeat(points, len(b.triangles), axis=0)
    corners = np.tile(b.vertices[b.triangles], (len(points), 1, 1))
    gaps = np.linalg.norm(trimesh.triangles.closest_point(corners, every) - every, axis=1)
    distances = gaps.reshape(len(points), -1).min(axis=1)
    result = compare(a, b, samples=100_000)
    assert result.a_to_b.mean == pytest.approx(distances[:2000].mean(), rel=0.05)
    assert result.a_to_b.rms == pytest.approx(np.sqrt((distances[:2000] ** 2).mean()), rel=0.05)
    assert distances.max() - 1e-6 <= result.a_to_b.maximum <= 1.05 * distances.max()


def test_a_constant_colour_offset_is_the_rmse():
    result = compare(
        make_grid(color=(100, 120, 140)), make_grid(n=5, height=0.01, color=(110, 110, 150)), samples=5000
    )
    for color in (result.color_a_to_b, result.color_b_to_a, result.color):
        assert color.rmse == pytest.approx(10)
        assert color.maximum == pytest.approx(10)
        assert color.psnr == pytest.approx(20 * math.log10(25.5))


def test_colours_are_interpolated_over_triangles():
    ramp = make_grid(n=2)
    ramp = ramp.with_(colors=np.uint8([[0, 0, 0], [240, 0, 0], [0, 0, 0], [240, 0, 0]]))
    result = compare(ramp, make_grid(n=7, color=(0, 0, 0)), samples=200_000)
    # One channel of three differs by 240 x, whose mean square is 240² / 3.
    assert result.color.rmse == pytest.approx(240 / 3, rel=1e-3)
    assert result.color.maximum == pytest.approx(240)


def test_equal_colours_have_no_psnr_in_json():
    result = compare(make_grid(color=(9, 9, 9)), make_grid(color=(9, 9, 9)), samples=100)
    assert result.color.psnr == math.inf
    color = json.loads(json.dumps(result.to_dict(), allow_nan=False))["color"]["symmetric"]
    assert color["psnr_db"] is None
    assert color["rmse_levels"] == pytest.approx(0, abs=1e-9)


def test_colour_metrics_need_two_coloured_meshes():
    result = compare(make_grid(color=(1, 2, 3)), make_grid(), samples=100)
    assert result.color is None
    assert result.to_dict()["color"] is None


@pytest.mark.slow
def test_the_same_seed_gives_the_same_metrics_and_another_does_not():
    a, b = make_sphere(1.0), make_sphere(1.02)
    first = compare(a, b, samples=50_000, seed=4).to_dict()
    assert compare(a, b, samples=50_000, seed=4).to_dict() == first
    assert compare(a, b, samples=50_000, seed=5).to_dict() != first


def test_swapping_the_meshes_swaps_the_directions():
    a, b = make_grid(), make_grid(width=0.5, height=0.1)
    forth, back = compare(a, b, samples=100_000), compare(b, a, samples=100_000)
    assert forth.a_to_b.mean == pytest.approx(back.b_to_a.mean, rel=1e-3)
    assert forth.b_to_a.maximum == pytest.approx(back.a_to_b.maximum)


def test_map_coordinates_lose_no_precision():
    a, b = make_sphere(1.0), make_sphere(1.001)
    near = compare(a, b, samples=10_000)
    shift = np.array((5e5, 5.4e6, 300.0))
    far = compare(a.with_(vertices=a.vertices + shift), b.with_(vertices=b.vertices + shift), samples=10_000)
    assert far.symmetric.rms == pytest.approx(near.symmetric.rms, rel=1e-4)
    assert far.symmetric.maximum == pytest.approx(near.symmetric.maximum, rel=1e-3)


def test_other_libraries_meshes_are_accepted():
    ball = trimesh.creation.icosphere(radius=2.0)
    result = compare(ball, (np.asarray(ball.vertices), np.asarray(ball.faces)), samples=1000)
    assert result.symmetric.maximum < 1e-5


EMPTY = Mesh(np.zeros((3, 3)), np.zeros((0, 3), np.int32))
LINE = Mesh(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]]), np.array([[0, 1, 2]], np.int32))
HUGE = make_grid().with_(vertices=make_grid().vertices * 1e200)


@pytest.mark.parametrize(
    ("mesh", "words"), [(EMPTY, "no triangles"), (LINE, "zero area"), (HUGE, "too large")]
)
def test_meshes_without_surface_are_refused(mesh, words):
    with pytest.raises(InputError, match=f"first mesh: .*{words}"):
        compare(mesh, make_grid())
    with pytest.raises(InputError, match=f"second mesh: .*{words}"):
        compare(make_grid(), mesh)


def test_parameters_are_checked():
    with pytest.raises(UsageError, match="samples is 0"):
        CompareParams(samples=0)
    with pytest.raises(UsageError, match="unknown parameter 'sample'"):
        compare(make_grid(), make_grid(), sample=5)
