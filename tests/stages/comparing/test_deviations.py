"""Signed deviations, tolerances and colour differences of shapes with known distances; and alignment."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from coloured_sheet import make_bumpy_body
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom import Mesh, align, deviations
from scanloom.stages._open3d import import_open3d
from scanloom.stages.comparing.deviation_palette import PALETTES, colorize_distances
from scanloom.stages.comparing.needle_search import NeedleSafeSurface
from scanloom.stages.comparing.signed_distance import Pseudonormals
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.surface.raycasting import RaycastingSurface, compute_bounding_box


def to_mesh(made: trimesh.Trimesh, color: tuple[int, int, int] | None = None) -> Mesh:
    vertices = np.array(made.vertices)
    colors = None if color is None else np.tile(np.array(color, np.uint8), (len(vertices), 1))
    return Mesh(vertices, np.array(made.faces, np.int32), colors)


def ball(radius: float, color: tuple[int, int, int] | None = None) -> Mesh:
    return to_mesh(trimesh.creation.icosphere(subdivisions=4, radius=radius), color)


def test_a_larger_sphere_is_outside_and_a_smaller_one_inside():
    for radius, offset in ((1.02, 0.02), (0.97, -0.03)):
        found = deviations(ball(1), ball(radius), tolerance=0.025)
        told = found.to_dict()
        assert told["is_signed"]
        # The facets of both are slightly inside the spheres.
        assert told["mean_m"] == pytest.approx(offset, abs=2e-3)
        assert told["absolute_percentiles_m"]["50"] == pytest.approx(abs(offset), abs=2e-3)
        assert (np.sign(found.vertex_distances) == np.sign(offset)).all()
        shares = told["within_ratio"], told["over_ratio"], told["under_ratio"]
        assert shares == pytest.approx((1, 0, 0) if offset > 0 else (0, 0, 1))


def test_without_an_orientation_there_are_no_signs():
    flipped = ball(1)
    triangles = flipped.triangles.copy()
    triangles[::7] = triangles[::7, ::-1]
    told = deviations(flipped.with_(triangles=triangles), ball(0.97), tolerance=0.01).to_dict()
    assert not told["is_signed"]
    assert told["mean_m"] is told["over_ratio"] is None
    assert told["absolute_percentiles_m"]["50"] == pytest.approx(0.03, abs=2e-3)


def test_two_parallel_squares():
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    square = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    above = square.with_(vertices=square.vertices * (0.5, 0.5, 1) + np.array((0.2, 0.2, 0.3)))
    told = deviations(square, above).to_dict()
    assert (told["lowest_m"], told["highest_m"]) == pytest.approx((0.3, 0.3))
    assert told["standard_deviation_m"] == pytest.approx(0, abs=1e-9)
    assert told["within_ratio"] is None
    below = above.with_(vertices=above.vertices - np.array((0, 0, 0.6)))
    assert deviations(square, below).to_dict()["mean_m"] == pytest.approx(-0.3)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_signs_agree_with_an_independent_inside_test(seed):
    box, cone = trimesh.creation.box(extents=(1, 2, 0.3)), trimesh.creation.cone(0.5, 1.5, sections=7)
    made = box if seed % 2 else cone
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.2, 1.7, (300, 3))
    mesh = to_mesh(made)
    low, high = compute_bounding_box(mesh)
    box = np.array([np.minimum(points.min(axis=0), low), np.maximum(points.max(axis=0), high)])
    nearest = NeedleSafeSurface(RaycastingSurface(mesh, box), box).find_closest_points(points)
    clear = nearest.distances > 1e-4
    signs = Pseudonormals(mesh).compute_signs(points, nearest)
    scene = import_open3d().t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
    inside = scene.compute_occupancy(points.astype(np.float32), nsamples=5).numpy() > 0
    np.testing.assert_array_equal(signs[clear] < 0, inside[clear])


def test_colour_differences_are_ciede2000():
    found = deviations(ball(1, (200, 30, 30)), ball(1, (200, 30, 30))).to_dict()["delta_e_2000"]
    assert found["maximum"] == pytest.approx(0, abs=1e-6)
    # CIEDE2000 of white and a grey of 119 levels: their lightness difference weighted by 1 + 0.015 · 25² /
    # √(20 + 25²).
    grey = deviations(ball(1, (255, 255, 255)), ball(1, (119, 119, 119))).to_dict()["delta_e_2000"]
    assert grey["mean"] == pytest.approx(36.49, abs=0.02)
    assert deviations(ball(1), ball(1, (1, 2, 3))).to_dict()["delta_e_2000"] is None


def test_the_worst_positions_are_separate_and_sorted():
    mesh = ball(1)
    vertices = mesh.vertices.copy()
    for k, height in ((10, 0.12), (900, 0.1), (2000, 0.08)):
        vertices[k] *= 1 + height
    worst = deviations(mesh, mesh.with_(vertices=vertices)).to_dict()["worst"]
    assert len(worst) == 10
    for place, k in zip(worst, (10, 900, 2000), strict=False):
        assert np.linalg.norm(np.array(place["point_m"]) - vertices[k]) < 0.15
    sizes = [place["distance_m"] for place in worst]
    assert sizes == sorted(sizes, reverse=True)


@pytest.mark.parametrize("palette", PALETTES)
def test_colours_show_sign_and_tolerance(palette):
    values = np.array((-2, -1, -0.5, -0.1, 0, 0.1, 0.5, 1, 2.0))
    colors = colorize_distances(values, 0.2, 1, palette).astype(int)
    assert len({tuple(c) for c in colors[3:6]}) == 1
    assert (colors[0] == colors[1]).all()
    assert (colors[7] == colors[8]).all()
    assert colors[0, 2] > colors[0, 0]
    assert colors[8, 0] > colors[8, 2]


@pytest.mark.slow
@settings(max_examples=8, deadline=None)
@given(st.integers(0, 1000))
def test_a_moved_copy_is_aligned(seed):
    rng = np.random.default_rng(seed)
    body = make_bumpy_body()
    axis = rng.normal(size=3)
    turn = trimesh.transformations.rotation_matrix(np.radians(rng.uniform(1, 8)), axis)[:3, :3]
    shift = rng.uniform(-0.05, 0.05, 3)
    moved = body.with_(vertices=body.vertices @ turn.T + shift, up=(0.0, 0.0, 1.0))
    back, how = align(moved, body)
    np.testing.assert_allclose(back.vertices, body.vertices, atol=2e-3)
    np.testing.assert_allclose(how.reference_from_mesh[:3, :3] @ turn, np.eye(3), atol=3e-3)
    assert how.overlap_ratio > 0.99
    np.testing.assert_allclose(back.up, turn.T[:, 2], atol=3e-3)
    again, still = align(back, body)
    assert still.displacement_rms_m < 1e-3
    assert len(again.vertices) == len(body.vertices)


def test_alignment_works_far_from_the_origin():
    body = make_bumpy_body()
    away = np.array((4e5, -2e5, 30.0))
    far = body.with_(vertices=body.vertices + away)
    back, how = align(far.with_(vertices=far.vertices + np.array((0.02, 0, 0))), far)
    np.testing.assert_allclose(back.vertices, far.vertices, atol=2e-3)
    assert how.displacement_rms_m == pytest.approx(0.02, abs=2e-3)


def test_meshes_without_overlap_are_not_aligned():
    with pytest.raises(InputError, match="cannot be aligned"):
        align(ball(1).with_(vertices=ball(1).vertices + 9), ball(1))


WRONG = ({"tolerance": -1}, {"color_range": 0}, {"palette": "grey"}, {"signed_samples": 0})


@pytest.mark.parametrize("changes", WRONG)
def test_invalid_parameters_are_refused(changes):
    with pytest.raises(UsageError):
        deviations(ball(1), ball(1), **changes)
