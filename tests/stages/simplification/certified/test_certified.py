"""Proven bounds of simplify: used by default, never exceeded, and reported if they cannot be proven."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scanloom.stages.cleaning.clean import clean
from scanloom.stages.comparing.certify import certify
from scanloom.stages.comparing.compare import compare
from scanloom.stages.diagnostics.diagnostic import Severity
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import resolve
from scanloom.stages.simplification.method_selection import select_method
from scanloom.stages.simplification.regions import Box, Sphere
from scanloom.stages.simplification.simplify import SimplificationResult, SimplifyParams, simplify
from scanloom.stages.surface.mesh import Mesh, Texture
from scanloom.stages.surface.mesh_files import read_mesh, write_mesh
from scanloom.stages.surface.raycasting import RaycastingSurface, interpolate_values
from scanloom.stages.surface.topology import topology

pytestmark = pytest.mark.slow


def make_hills(n: int = 40) -> Mesh:
    """Make a smoothly coloured height field over the unit square with 2 n² triangles."""
    y, x = np.mgrid[0 : n + 1, 0 : n + 1] / n
    z = 0.1 * np.sin(7 * x) * np.cos(5 * y)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    b, c, d = a + 1, a + n + 2, a + n + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    colors = np.stack([255 * x, 255 * y, 128 + 100 * np.sin(9 * x)], -1).reshape(-1, 3)
    vertices = np.stack([x, y, z], -1).reshape(-1, 3)
    return Mesh(vertices, triangles.astype(np.int32), colors=np.rint(colors).astype(np.uint8))


def make_coincident_sheets() -> Mesh:
    """Make a black and a white sheet at the same position; the colour of the nearest point is ambiguous."""
    mesh = make_hills(6)
    both = np.concatenate([mesh.triangles, mesh.triangles + len(mesh.vertices)])
    black, white = (np.full((len(mesh.vertices), 3), level, np.uint8) for level in (0, 255))
    return Mesh(np.tile(mesh.vertices, (2, 1)), both, colors=np.concatenate([black, white]))


def assert_bounds_hold(result: SimplificationResult, mesh: Mesh, samples: int = 100_000) -> None:
    """Check that vertices and samples of both surfaces are within the proven bounds."""
    assert result.details.shape_bound_m is not None
    measured = compare(mesh, result.mesh, samples=samples)
    assert measured.symmetric.maximum <= result.details.shape_bound_m
    if result.details.color_bound_levels is not None:
        assert measured.color is not None
        # compare uses the largest difference of a channel, the bound is on the Euclidean difference.
        assert measured.color.maximum <= result.details.color_bound_levels


@pytest.mark.parametrize(
    ("given", "method"),
    [
        ({"max_shape": 0.01}, "certified"),
        ({"max_color": 9.0}, "certified"),
        ({"max_shape": 0.01, "max_color": 9.0}, "certified"),
        ({"max_shape": 0.01, "ratio": 0.5}, "certified"),
        ({"max_color": 9.0, "triangles": 50}, "certified"),
        ({"max_shape": 0.01, "jia01": {"resolution": 1.0}}, "jia01"),
        ({"max_color": 9.0, "jia01": {"paper_rule": True}}, "jia01"),
        ({"method": "jia01", "max_shape": 0.01, "ratio": 0.5}, "jia01"),
        ({"ratio": 0.5}, "quadric"),
        ({}, "jia01"),
    ],
)
def test_bounds_select_certified_unless_options_of_jia01_are_given(
    given: dict[str, Any], method: str
) -> None:
    assert select_method(resolve(SimplifyParams, None, given)).name == method
    assert simplify(make_hills(8), **given).method == method


@pytest.mark.parametrize(("shape", "color"), [(0.003, 12.0), (0.003, None), (None, 12.0), (0.02, 60.0)])
def test_no_point_exceeds_the_proven_bounds(shape: float | None, color: float | None) -> None:
    mesh = make_hills()
    result = simplify(mesh, max_shape=shape, max_color=color)
    assert (result.details.proven, result.stopped_by) == (True, "bounds")
    assert len(result.mesh.triangles) < 0.5 * len(mesh.triangles)
    assert topology(result.mesh).boundary_loops == 1
    # A bound on colour gets a default bound on shape, because colours alone do not limit the shape.
    diagonal = np.linalg.norm(np.ptp(mesh.vertices, axis=0))
    assert result.details.max_shape_m == pytest.approx(0.005 * diagonal if shape is None else shape)
    assert (result.details.shape_bound_m or np.inf) <= (result.details.max_shape_m or 0)
    assert color is None or (result.details.color_bound_levels or 0) <= color
    assert result.diagnostics == ()
    assert_bounds_hold(result, mesh)


def test_each_triangle_has_its_own_bounds() -> None:
    mesh = make_hills()
    result = simplify(mesh, max_shape=0.01, max_color=30)
    shape, color = result.details.shape_bound, result.details.color_bound
    assert shape is not None
    assert color is not None
    assert shape.shape == color.shape == (len(result.mesh.triangles),)
    assert (shape.max(), color.max()) <= (result.details.shape_bound_m, result.details.color_bound_levels)

    random = np.random.default_rng(0)
    of = np.repeat(np.arange(len(shape)), 50)
    weights = random.dirichlet([0.5, 0.5, 0.5], size=len(of))
    corners = result.mesh.triangles[of]
    places = np.einsum("kc,kcx->kx", weights, result.mesh.vertices[corners])
    assert result.mesh.colors is not None
    assert mesh.colors is not None
    levels = np.einsum("kc,kcx->kx", weights, result.mesh.colors[corners].astype(float))
    nearest = RaycastingSurface(mesh).find_closest_points(places)
    assert (nearest.distances <= shape[of]).all()
    there = interpolate_values(mesh.colors, mesh, nearest)
    assert (np.linalg.norm(levels - there, axis=1) <= color[of]).all()


def test_a_triangle_count_never_exceeds_the_bounds() -> None:
    mesh = make_hills()
    bounds = {"max_shape": 0.003, "max_color": 12.0}
    alone = simplify(mesh, **bounds)
    left = len(alone.mesh.triangles)
    few = simplify(mesh, triangles=left // 2, **bounds)
    assert (few.method, few.stopped_by, few.details.proven) == ("certified", "bounds", True)
    assert left // 2 < len(few.mesh.triangles) < 1.1 * left

    for many in (
        simplify(mesh, triangles=2 * left, **bounds),
        simplify(mesh, ratio=2 * left / 3200, **bounds),
    ):
        assert (many.method, many.stopped_by, many.details.proven) == ("certified", "triangles", True)
        assert 2 * left - 2 < len(many.mesh.triangles) <= 2 * left
        assert_bounds_hold(many, mesh)
    nothing = simplify(mesh, ratio=1.0, **bounds)
    assert (nothing.stopped_by, nothing.collapses, len(nothing.mesh.triangles)) == ("triangles", 0, 3200)


def test_a_count_within_bounds_does_not_depend_on_the_thread_count() -> None:
    mesh = make_hills(120)
    one, two = (simplify(mesh, ratio=0.3, max_shape=0.01, threads=threads) for threads in (1, 2))
    assert one.stopped_by == "triangles"
    assert one.mesh.vertices.tobytes() == two.mesh.vertices.tobytes()
    assert one.mesh.triangles.tobytes() == two.mesh.triangles.tobytes()


def test_tight_bounds_of_triangles_are_tight() -> None:
    mesh = make_hills()
    bounds = {"max_shape": 0.01, "max_color": 30.0}
    loose, close = (simplify(mesh, certified={"tight_bounds": close}, **bounds) for close in (False, True))
    assert close.mesh.vertices.tobytes() == loose.mesh.vertices.tobytes()
    assert loose.details.shape_bound is not None
    assert close.details.shape_bound is not None
    assert close.details.color_bound is not None
    # They equal the bounds of a separate certification, limited by the requested bounds.
    own = certify(close.mesh, mesh)
    np.testing.assert_allclose(close.details.shape_bound, np.minimum(own.shape_bound, 0.01), rtol=1e-6)
    np.testing.assert_allclose(close.details.color_bound, np.minimum(own.color_bound, 30.0), rtol=1e-6)
    assert close.details.shape_bound.mean() < 0.95 * loose.details.shape_bound.mean()
    assert (close.details.shape_bound.max(), close.details.color_bound.max()) <= (
        close.details.shape_bound_m,
        close.details.color_bound_levels,
    )
    assert (close.details.shape_bound_m or 1) <= 1.06 * (close.details.shape_attained_m or 0)
    assert_bounds_hold(close, mesh)


def test_a_flat_sheet_of_one_colour_keeps_little_more_than_its_corners() -> None:
    mesh = make_hills(20)
    plain = Mesh(mesh.vertices * (1, 1, 0), mesh.triangles, colors=np.full_like(mesh.vertices, 77, np.uint8))
    result = simplify(plain, max_shape=1e-4, max_color=0)
    assert result.details.proven
    assert len(result.mesh.triangles) <= 12
    assert result.mesh.colors is not None
    assert (result.mesh.colors == 77).all()
    assert_bounds_hold(result, plain)


def test_a_mesh_without_colours_has_only_shape_bounds() -> None:
    mesh = make_hills().with_(colors=None)
    result = simplify(mesh, max_shape=0.01)
    assert result.details.proven
    assert result.mesh.colors is None
    assert result.details.color_bound is None
    assert result.to_dict()["details"]["color_bound_levels"] is None
    assert_bounds_hold(result, mesh)
    with pytest.raises(UsageError, match="max_color is given, but the mesh has no vertex colours"):
        simplify(mesh, max_shape=0.01, max_color=9)


def test_bounds_hold_after_writing_single_precision(tmp_path: Path) -> None:
    mesh = make_hills()
    result = simplify(mesh, max_shape=0.004, max_color=15)
    single = result.mesh.with_(vertices=result.mesh.vertices.astype(np.float32).astype(np.float64))
    write_mesh(tmp_path / "light.ply", single)
    stored = read_mesh(tmp_path / "light.ply")
    assert certify(stored, mesh, slack=0.0, max_shape=0.004, max_color=15).within_limits


def test_importance_divides_the_bounds_and_locked_vertices_are_kept() -> None:
    mesh = make_hills()
    left = Box((0, 0, -1), (0.5, 1, 1), importance=8)
    ball = Sphere((0.8, 0.8, 0), 0.15, lock=True)
    result = simplify(mesh, max_shape=0.02, regions=(left, ball))
    assert result.details.proven
    far = RaycastingSurface(result.mesh).find_closest_points(mesh.vertices).distances
    assert far[left.contains(mesh.vertices)].max() <= 0.02 / 8
    assert far.max() > 0.02 / 8
    locked = np.flatnonzero(ball.contains(mesh.vertices))
    assert len(locked) > 20
    at = np.searchsorted(result.vertex_source, locked)
    assert result.mesh.vertices[at].tobytes() == mesh.vertices[locked].tobytes()
    assert mesh.colors is not None
    assert result.mesh.colors is not None
    np.testing.assert_array_equal(result.mesh.colors[at], mesh.colors[locked])


def test_a_fan_of_needles_that_cannot_be_simplified_is_proven_to_equal_itself() -> None:
    angles = 0.002 * np.arange(12)
    heights = 1e-3 * np.random.default_rng(5).standard_normal(12)
    rim = np.stack([np.cos(angles), np.sin(angles), heights], axis=1)
    after = np.arange(1, len(rim))
    fan = np.stack([0 * after, after, after + 1], axis=1).astype(np.int32)
    light = simplify(Mesh(np.vstack([np.zeros(3), rim]), fan), method="certified", max_shape=1e-4)
    assert light.details.proven
    assert light.stopped_by == "bounds"
    assert light.details.shape_bound_m <= 1e-4


def test_unproven_bounds_are_reported() -> None:
    mesh = make_coincident_sheets()
    result = simplify(mesh, max_shape=0.01, max_color=20)
    assert (result.details.proven, result.stopped_by) == (False, "unproven")
    assert min(result.details.unproven_triangles or ()) > 0
    assert result.details.color_bound_levels is not None
    assert result.details.color_bound_levels > 20
    warning, unmet = result.diagnostics
    assert "could not prove" in str(warning)
    assert "the requested bounds are not proven" in str(unmet)
    assert (warning.severity, unmet.severity) == (Severity.WARNING, Severity.UNMET)
    assert_bounds_hold(result, mesh, 10_000)


def test_an_early_stop_proves_bounds_for_the_current_mesh() -> None:
    mesh = make_hills(200)
    result = simplify(mesh, max_shape=0.01, max_color=40, progress=lambda *_: False)
    assert result.stopped_by == "request"
    assert len(result.mesh.triangles) < len(mesh.triangles)
    assert bool(result.diagnostics) != result.details.proven
    assert result.details.color_bound is not None
    assert len(result.details.color_bound) == len(result.mesh.triangles)
    assert_bounds_hold(result, mesh)


def test_the_texture_is_dropped_with_a_diagnostic() -> None:
    mesh = make_hills(8)
    uvs = np.zeros((len(mesh.triangles), 3, 2))
    result = simplify(mesh.with_(texture=Texture(uvs, np.full(len(uvs), -1, np.int32))), max_shape=0.01)
    assert result.mesh.texture is None
    assert "discards the texture" in str(result.diagnostics[0])


def test_an_empty_mesh_is_simplified() -> None:
    empty = simplify((np.zeros((0, 3)), np.zeros((0, 3), np.int32)), max_shape=0.1)
    assert empty.mesh.triangles.shape == (0, 3)
    assert (empty.details.proven, empty.stopped_by) == (True, "bounds")
    json.dumps(empty.to_dict())


def test_metrics_are_plain_numbers_with_units() -> None:
    metrics = simplify(make_hills(20), max_shape=0.01, max_color=30).to_dict()
    assert json.loads(json.dumps(metrics)) == metrics
    assert metrics["method"] == "certified"
    proven = metrics["details"]
    assert 0 < proven["shape_attained_m"] <= proven["shape_bound_m"] <= proven["max_shape_m"] == 0.01
    assert 0 < proven["color_attained_levels"] <= proven["color_bound_levels"] <= 30
    assert proven["unproven_triangles"] == [0, 0]
    assert proven["attribute_scale_m_per_level"] > 0


@pytest.mark.parametrize("name", ["sceaux_mvs_scene_mesh.ply", "stanford-bunny.obj", "colored_airplane.ply"])
def test_bounds_of_real_meshes_hold(shared_data: Path, name: str) -> None:
    mesh = clean(read_mesh(shared_data / "meshes" / name)).mesh
    bound = 1e-3 * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    result = simplify(mesh, max_shape=bound, max_color=None if mesh.colors is None else 20.0)
    assert result.details.shape_bound_m is not None
    assert result.details.shape_bound_m <= bound
    assert_bounds_hold(result, mesh, 200_000)
    assert topology(result.mesh).euler == topology(mesh).euler


@pytest.mark.parametrize("mesh", [make_hills(), make_coincident_sheets()], ids=["hills", "sheets"])
def test_without_a_colour_bound_the_maximum_difference_is_proven(mesh: Mesh) -> None:
    light = simplify(mesh, max_shape=0.003)
    found = light.details
    assert found.proven
    assert found.color_bound_levels is not None
    assert found.color_bound is not None
    assert (found.color_bound == found.color_bound_levels).all()
    attained = found.color_attained_levels
    assert attained <= found.color_bound_levels <= 1.05 * attained + 1.5
    apart = certify(light.mesh, mesh)
    assert apart.color_attained_levels <= found.color_bound_levels
    close = simplify(mesh, max_shape=0.003, certified={"tight_bounds": True})
    assert (close.mesh.vertices == light.mesh.vertices).all()
    assert (close.details.color_bound <= 1.05 * found.color_bound).all()


def test_colour_bounds_never_exceed_the_largest_difference_of_two_colours() -> None:
    mesh = make_hills()
    grey = mesh.with_(colors=np.full_like(mesh.colors, 90))
    assert simplify(grey, max_shape=0.003).details.color_bound_levels == 0
    sheets = simplify(make_coincident_sheets(), max_shape=0.003).details
    assert sheets.color_attained_levels <= sheets.color_bound_levels < 441.673


@pytest.mark.parametrize("with_colors", [False, True])
def test_looser_bounds_leave_fewer_triangles(with_colors: bool) -> None:
    """Walls are exactly planar, so that few triangles cover them; the bump is noisy."""
    mesh = make_room(with_colors)
    counts = []
    for bound in (0.001, 0.002, 0.004, 0.008, 0.016):
        found = simplify(mesh, method="certified", max_shape=bound)
        assert found.details.proven
        assert not found.refused.get("locked")
        counts.append(len(found.mesh.triangles))
    assert all(after <= 1.03 * before for before, after in pairwise(counts)), counts
    assert counts[-1] < len(mesh.triangles) / 100


def make_room(with_colors: bool) -> Mesh:
    """Make two walls and a floor with a noisy bump, as one surface of 3 × 120² squares."""
    side = 120
    rng = np.random.default_rng(0)
    u, v = (axis.ravel() / side for axis in np.meshgrid(np.arange(2 * side + 1), np.arange(side + 1)))
    bump = 0.1 * np.exp(-((u - 0.5) ** 2 + (v - 0.5) ** 2) / 0.005)
    noise = np.where(bump > 1e-4, 0.002 * rng.standard_normal(len(u)), 0.0)
    # The surface is bent along a line, into floor and wall.
    points = np.stack([np.minimum(u, 1), v, np.maximum(u - 1, 0) + bump + noise], axis=1)
    row = 2 * side + 1
    corner = (np.arange(side)[:, None] * row + np.arange(2 * side)).ravel()
    triangles = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + row + 1], axis=1),
            np.stack([corner, corner + row + 1, corner + row], axis=1),
        ]
    ).astype(np.int32)
    # A hole with a noisy boundary, where the result may be off the input surface.
    radius = np.hypot(u - 0.3, v - 0.7) + 0.02 * rng.standard_normal(len(u))
    kept = (radius[triangles] > 0.1).all(axis=1)
    colors = np.repeat((127 + 100 * np.sin(40 * u) * np.cos(37 * v))[:, None], 3, axis=1).astype(np.uint8)
    mesh = Mesh(points, triangles[kept], colors if with_colors else None)
    return clean(mesh, min_island_area=0).mesh
