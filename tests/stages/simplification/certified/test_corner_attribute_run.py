"""Simplification of a textured model within a proven bound, with its texture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seamed_meshes import count_edges, count_outside_charts, weld_corners, wrapped_ball

from scanloom import stages
from scanloom.stages.comparing.certify import certify
from scanloom.stages.comparing.compare import compare
from scanloom.stages.simplification.certified.color_samples import sample_color_differences
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Image, Material, Mesh, Texture
from scanloom.stages.surface.mesh_files import read_mesh

DATA = Path(__file__).parents[5] / "shared" / "data" / "meshes"


def add_checkered_image(mesh: Mesh, squares: int = 8) -> Mesh:
    """Add a smooth image with some contrast to a mesh with texture coordinates."""
    x, y = np.meshgrid(np.linspace(0, 2 * np.pi * squares, 256), np.linspace(0, 2 * np.pi * squares, 256))
    grey = 128 + 60 * np.sin(x) * np.sin(y)
    pixels = np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)
    assert mesh.texture is not None
    material = Material("checkered", image=Image(given=pixels))
    return mesh.with_(texture=Texture(mesh.texture.uvs, mesh.texture.material_ids, (material,)))


def compute_diagonal(mesh: Mesh) -> float:
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))


def assert_bound_and_texture_hold(light: Any, mesh: Mesh, bound: float) -> None:
    """Check the bound by a separate proof, that no edge opened, and the chart of each texture coordinate."""
    assert light.method == "certified"
    assert light.details.proven
    assert light.details.shape_bound_m <= max(bound, 2 * light.details.slack_m)
    assert certify(light.mesh, mesh, max_shape=light.details.shape_bound_m).within_limits
    assert count_edges(weld_corners(light.mesh))[0] <= count_edges(weld_corners(mesh))[0]
    assert light.mesh.texture is not None
    assert mesh.texture is not None
    assert light.mesh.texture.materials == mesh.texture.materials
    assert count_outside_charts(light.mesh, light.triangle_source, mesh) == 0


@pytest.mark.parametrize("share", [0.02, 0.005, 0.002])
def test_a_ball_with_seams_stays_closed_and_within_its_bound(share: float) -> None:
    mesh = add_checkered_image(wrapped_ball(24, 48, bumps=0.1))
    bound = share * compute_diagonal(mesh)
    light = simplify(mesh, keep_uv=True, max_shape=bound)
    assert_bound_and_texture_hold(light, mesh, bound)
    assert len(light.mesh.triangles) < 0.9 * len(mesh.triangles)
    assert light.stopped_by == "bounds"


def test_a_looser_bound_leaves_fewer_triangles() -> None:
    mesh = add_checkered_image(wrapped_ball(24, 48, bumps=0.1))
    counts = [
        len(simplify(mesh, keep_uv=True, max_shape=share * compute_diagonal(mesh)).mesh.triangles)
        for share in (0.001, 0.01)
    ]
    assert counts[1] < counts[0] / 3


@pytest.mark.parametrize("max_color", [20.0, 10.0])
def test_a_colour_bound_holds_and_is_called_measured(max_color: float) -> None:
    mesh = add_checkered_image(wrapped_ball(24, 48, bumps=0.1), squares=2)
    bound = 0.02 * compute_diagonal(mesh)
    light = simplify(mesh, keep_uv=True, max_shape=bound, max_color=max_color)
    assert_bound_and_texture_hold(light, mesh, bound)
    samples = sample_color_differences(light.mesh, mesh)
    assert samples is not None
    assert samples.max_difference <= max_color
    assert light.details.color_bound_levels is None
    assert light.details.color_measured_levels == pytest.approx(samples.max_difference)
    assert "Measured, not proven" in light.details.describe()
    free = simplify(mesh, keep_uv=True, max_shape=bound)
    assert free.details.color_measured_levels > max_color
    assert len(free.mesh.triangles) < len(light.mesh.triangles)


def test_simplification_stops_at_a_count_or_at_a_bound() -> None:
    mesh = add_checkered_image(wrapped_ball(24, 48, bumps=0.1))
    bound = 0.01 * compute_diagonal(mesh)
    few = simplify(mesh, keep_uv=True, max_shape=bound, triangles=10)
    assert few.stopped_by == "bounds"
    many = simplify(mesh, keep_uv=True, max_shape=bound, triangles=1500)
    assert many.stopped_by == "triangles"
    assert len(many.mesh.triangles) <= 1500
    for light in (few, many):
        assert_bound_and_texture_hold(light, mesh, bound)


def test_locked_vertices_are_kept_and_importance_keeps_more_vertices() -> None:
    mesh = add_checkered_image(wrapped_ball(24, 48, bumps=0.1))
    lock = mesh.vertices[:, 0] > 0.5
    light = simplify(mesh, keep_uv=True, max_shape=0.02 * compute_diagonal(mesh), lock=lock)
    kept = {tuple(p) for p in light.mesh.vertices.tolist()}
    assert {tuple(p) for p in mesh.vertices[lock].tolist()} <= kept
    cared = simplify(
        mesh, keep_uv=True, max_shape=0.02 * compute_diagonal(mesh), importance=np.where(lock, 10.0, 1.0)
    )
    plain = simplify(mesh, keep_uv=True, max_shape=0.02 * compute_diagonal(mesh))
    there = [int((one.mesh.vertices[:, 0] > 0.5).sum()) for one in (cared, plain)]
    assert there[0] > there[1]


def test_the_bytes_do_not_depend_on_the_thread_count() -> None:
    mesh = add_checkered_image(wrapped_ball(24, 48, bumps=0.1))
    one, two = (
        simplify(mesh, keep_uv=True, max_shape=0.004 * compute_diagonal(mesh), threads=n) for n in (1, 2)
    )
    assert one.mesh.vertices.tobytes() == two.mesh.vertices.tobytes()
    assert one.mesh.triangles.tobytes() == two.mesh.triangles.tobytes()
    assert one.mesh.texture is not None
    assert two.mesh.texture is not None
    assert one.mesh.texture.uvs.tobytes() == two.mesh.texture.uvs.tobytes()


def test_a_record_replays_to_the_same_mesh() -> None:
    mesh = add_checkered_image(wrapped_ball(12, 24, bumps=0.1))
    light = simplify(mesh, keep_uv=True, max_shape=0.01 * compute_diagonal(mesh), record=True)
    assert light.record is not None
    again = light.record.replay()
    assert len(again.mesh.triangles) == len(light.mesh.triangles)
    assert np.array_equal(np.unique(again.mesh.vertices, axis=0), np.unique(light.mesh.vertices, axis=0))


def test_coincident_surfaces_of_different_colours_are_reported() -> None:
    ball = add_checkered_image(wrapped_ball(12, 24, bumps=0.1), squares=2)
    assert ball.texture is not None
    # A copy of the surface with another part of the image.
    uvs = np.concatenate([ball.texture.uvs, ball.texture.uvs * 0.5 + 0.25])
    material_ids = np.zeros(len(uvs), np.int32)
    both = Mesh(
        np.concatenate([ball.vertices, ball.vertices]),
        np.concatenate([ball.triangles, ball.triangles + np.int32(len(ball.vertices))]),
        texture=Texture(uvs, material_ids, ball.texture.materials),
    )
    light = simplify(both, keep_uv=True, max_shape=0.05 * compute_diagonal(both), max_color=5.0)
    assert any("surfaces of different colours coincide" in str(one) for one in light.diagnostics)


def simplify_two_parts(max_color: float | None = None) -> tuple[Mesh, Any]:
    """Make a ball of two parts with vertex colours, and simplify it."""
    ball = wrapped_ball(24, 48, bumps=0.1).with_(texture=None)
    x, y, z = ball.vertices.T
    levels = np.stack([128 + 100 * np.sin(4 * x), 128 + 60 * y, 128 + 60 * z], axis=1)
    ids = (ball.vertices[ball.triangles].mean(axis=1)[:, 0] > 0).astype(np.int32)
    mesh = ball.with_(colors=levels.clip(0, 255).astype(np.uint8), part_ids=ids, part_names=("a", "b"))
    return mesh, simplify(mesh, keep_uv=True, max_shape=0.02 * compute_diagonal(mesh), max_color=max_color)


def test_vertex_colours_of_parts_have_proven_bounds() -> None:
    mesh, light = simplify_two_parts(max_color=20.0)
    assert light.method == "certified"
    assert light.details.proven
    assert light.details.color_measured_levels is None
    assert light.details.color_bound_levels <= 20.0
    assert certify(light.mesh, mesh, max_color=20.0).within_limits
    assert set(light.mesh.part_ids) == {0, 1}
    free_mesh, free = simplify_two_parts()
    # Without a colour bound, the proven value is reported.
    assert free.details.color_bound_levels > 20.0
    assert certify(free.mesh, free_mesh).color_attained_levels <= free.details.color_bound_levels
    assert len(free.mesh.triangles) < len(light.mesh.triangles) < len(mesh.triangles)


def make_ball_and_blade() -> tuple[Mesh, float]:
    """Return a textured ball next to a thin triangle, and the height of the triangle."""
    ball = add_checkered_image(wrapped_ball(24, 48, bumps=0.05))
    assert ball.texture is not None
    height = 0.02
    blade = np.array([[3, 0, 0], [11, 0, 0], [7, height, 0]], float)
    triangles = np.concatenate([ball.triangles, [np.arange(3) + len(ball.vertices)]]).astype(np.int32)
    uvs = np.concatenate([ball.texture.uvs, ball.texture.uvs[:1]])
    texture = Texture(uvs, np.zeros(len(uvs), np.int32), ball.texture.materials)
    return Mesh(np.concatenate([ball.vertices, blade]), triangles, texture=texture), height


def test_triangles_too_thin_for_a_proof_are_reported_with_a_position() -> None:
    """Single-precision searches miss such a triangle, so the proof only uses its longest side."""
    mesh, height = make_ball_and_blade()
    light = simplify(mesh, keep_uv=True, max_shape=0.015)
    assert not light.details.proven
    assert light.stopped_by == "unproven"
    assert height / 2 < light.details.shape_bound_m <= 1.01 * height
    (text,) = [str(one) for one in light.diagnostics if "could not prove" in one.message]
    assert "1 triangle, 1 of them too thin for a tighter proof;" in text
    assert "near (7, 0.006667, 0) m." in text
    # The other triangles are simplified all the same.
    assert len(light.mesh.triangles) < 0.9 * len(mesh.triangles)


def test_an_unchanged_thin_triangle_without_colours_needs_no_proof() -> None:
    mesh, _ = make_ball_and_blade()
    light = simplify(mesh.with_(texture=None), max_shape=0.015)
    assert light.details.proven
    assert light.details.shape_bound_m <= 0.015
    assert len(light.mesh.triangles) < 0.9 * len(mesh.triangles)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_bounds_of_any_ball_with_holes_hold(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = wrapped_ball(int(rng.integers(4, 12)), int(rng.integers(5, 20)), bumps=float(rng.uniform(0, 0.3)))
    kept = np.flatnonzero(rng.random(len(mesh.triangles)) < rng.choice([0.85, 1.0]))
    mesh = mesh.with_triangles(mesh.triangles[kept], kept)
    bound = float(10 ** rng.uniform(-4, -1)) * compute_diagonal(mesh)
    light = simplify(mesh, keep_uv=True, max_shape=bound)
    if light.details.proven:
        farthest = compare(light.mesh, mesh, samples=3000).to_dict()["distance"]
        assert max(farthest[way]["maximum_m"] for way in ("a_to_b", "b_to_a")) <= light.details.shape_bound_m
    else:
        assert any("could not prove" in str(one) for one in light.diagnostics)
    assert count_edges(weld_corners(light.mesh))[0] <= count_edges(weld_corners(mesh))[0]
    assert count_outside_charts(light.mesh, light.triangle_source, mesh) == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["spot/spot_triangulated.obj", "Duck.glb", "fuze/fuze.obj", "bunny10k_textured/bunny10k_textured.obj"],
)
def test_bounds_of_shared_models_hold(name: str) -> None:
    if not (DATA / name).exists():
        pytest.skip(f"{name} is not here")
    mesh = read_mesh(DATA / name)
    bound = 0.005 * compute_diagonal(mesh)
    assert_bound_and_texture_hold(stages.simplify(mesh, keep_uv=True, max_shape=bound), mesh, bound)


def test_degenerate_triangles_are_excluded_from_the_proof() -> None:
    ball = add_checkered_image(wrapped_ball(24, 48, bumps=0.1))
    assert ball.texture is not None
    # A triangle with one distinct vertex and one with two, far from the ball.
    far = np.array([[9.0, 9, 9], [7, 7, 7]])
    n = len(ball.vertices)
    texture = Texture(
        np.concatenate([ball.texture.uvs, ball.texture.uvs[:2]]),
        np.concatenate([ball.texture.material_ids, ball.texture.material_ids[:2]]),
        ball.texture.materials,
    )
    mesh = Mesh(
        np.concatenate([ball.vertices, far]),
        np.concatenate([ball.triangles, [[n, n, n], [n, n + 1, n]]]).astype(np.int32),
        texture=texture,
    )
    bound = 0.005 * compute_diagonal(ball)
    light = simplify(mesh, keep_uv=True, max_shape=bound)
    assert light.details.proven
    assert light.stopped_by == "bounds"
    assert light.details.shape_bound_m <= bound
    assert certify(light.mesh, ball, max_shape=bound).within_limits
    (text,) = [str(one) for one in light.diagnostics if "no bound covers them" in one.message]
    assert text.endswith(f"2 of {len(mesh.triangles):,}.")
